"""Telemetry from and to files, in any format of the registry `FORMATS`."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.output_files.drafts import draft_of
from cpid_drake.resources import NOT_A_FILE, resolve_model
from cpid_drake.sensing.files.column_map import ColumnMap
from cpid_drake.sensing.files.columnar import NPZ, PARQUET
from cpid_drake.sensing.files.csv_format import CSV
from cpid_drake.sensing.files.formats import Format, ReadOptions, Topics
from cpid_drake.sensing.files.json_lines import JSON_LINES
from cpid_drake.sensing.files.mapped_columns import MappedColumns, columns_of
from cpid_drake.sensing.files.matlab import MATLAB
from cpid_drake.sensing.files.table import (
    LARGEST_TABLE,
    Problems,
    TableConverter,
    TelemetryTable,
    table_of,
)
from cpid_drake.sensing.measurement_stream import (
    CHUNK_SECONDS,
    joined,
    rechunked,
    time_interval,
)
from cpid_drake.sensing.measurements import Measurements, Samples


def _read_bag(file: Path, where: str, options: ReadOptions) -> Measurements:
    from cpid_drake.sensing.files.rosbag import read_usable

    return read_usable(file, options.problems, options.topics)


ROSBAG = Format("ROS 2 bag", (".mcap", ".db3"), _read_bag, is_bag=True)

FORMATS: list[Format] = [CSV, NPZ, PARQUET, MATLAB, JSON_LINES, ROSBAG]
"""All formats of telemetry files; append one to add it."""


def telemetry_endings(*, written: bool = False) -> tuple[str, ...]:
    """Return the endings of telemetry files that can be read, or that can be written."""
    return tuple(
        ending
        for each in FORMATS
        for ending in each.endings
        if each.write is not None or not written
    )


@dataclass(frozen=True, eq=False)
class TelemetryFile:
    """The contents of a telemetry file, and its problems.

    Attributes:
        measurements: the samples of every sensor that have no problem.
        row_count: number of rows in the file.
        problems: the problems and their places.
        partial: by sensor, the number of incomplete samples, which are left out.
        ignored: columns of unknown names.
        left_out_joints: joints of the log that the spacecraft does not have.

    """

    measurements: Measurements
    row_count: int
    problems: Problems
    partial: dict[str, int]
    ignored: tuple[str, ...]
    left_out_joints: tuple[str, ...] = ()


def inspect_telemetry(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    columns: ColumnMap | str | Path | None = None,
    joints: Collection[str] | None = None,
) -> TelemetryFile:
    """Read a telemetry file and list all problems in it.

    `sensing.files.table` explains the columns. A sample that is absent is an empty cell in CSV
    files, NaN in NPZ files (one array (N,) for each column), null or NaN in Parquet files.

    Args:
        path: the file, or a bag's folder.
        topics: topics of a bag; see `rosbag.read_rosbag`.
        columns, joints: see `open_telemetry`.

    Raises:
        InputError: no such file or folder, a file of another kind, or one in which nothing can be
            read: see also `table.check_columns`.

    """
    stream = open_telemetry(path, topics=topics, leave_out_bad=True, columns=columns, joints=joints)
    pieces, size = [], 0
    try:
        for piece in stream.pieces(Problems()):
            pieces.append(piece)
            size += sum(samples.value.size for _, samples in piece.items())
            if size > LARGEST_TABLE:
                raise InputError(f"{path}: more than {LARGEST_TABLE} numbers; split the file")
        measurements = joined(pieces)
    except MemoryError as error:
        raise InputError(f"{path}: the file does not fit into memory") from error
    return TelemetryFile(
        measurements,
        stream.row_count,
        stream.problems,
        dict(stream.partial),
        stream.ignored,
        stream.left_out_joints,
    )


def open_telemetry(
    path: str | Path,
    *,
    leave_out_bad: bool = False,
    topics: Mapping[str, str] | None = None,
    columns: ColumnMap | str | Path | None = None,
    joints: Collection[str] | None = None,
    start: float = -np.inf,
    end: float = np.inf,
    seconds: float = CHUNK_SECONDS,
) -> "TelemetryStream":
    """Return the samples in a telemetry file of any length as a stream of chunks.

    CSV, NPZ and Parquet files are read piece by piece. ROS 2 bags are read into memory at once.

    Args:
        path: the file, or a bag's folder.
        leave_out_bad: leave out rows that have a problem, instead of refusing the file.
        topics: topics of a bag; see `rosbag.read_rosbag`.
        columns: a map of the file's columns, or the map's YAML file; None for the package's own
            columns.
        joints: the spacecraft's joints, if they are known; columns of other joints are then left
            out, unless one of the spacecraft's is missing.
        start, end: first and last time to return [s]. The whole file is checked in any case.
        seconds: length of a chunk [s].

    Raises:
        InputError: for the same reasons as `inspect_telemetry` and `columns_of`, here or when the
            stream is read; also for the first bad row, unless bad rows are left out.

    """
    file, kind = format_of(path)
    if topics and not kind.is_bag:
        raise InputError(f"{path}: topics are for ROS 2 bags")
    selected = columns_of(columns, joints)
    return TelemetryStream(
        file, str(path), kind, topics, selected, leave_out_bad, start, end, seconds
    )


class TelemetryStream:
    """The samples of a telemetry file as a `MeasurementStream`; see `open_telemetry`.

    Attributes:
        problems: the problems in the file and their places, when it has been read to its end.
        row_count: number of rows, when the file has been read to its end.
        partial: by sensor, the number of incomplete samples, which are left out, when the file has
            been read to its end.
        ignored: columns of unknown names.
        left_out_joints: joints of the file that the spacecraft does not have.

    """

    def __init__(
        self,
        file: Path,
        where: str,
        kind: Format,
        topics: Topics,
        columns: MappedColumns,
        leave_out_bad: bool,
        start: float,
        end: float,
        seconds: float,
    ) -> None:
        self._file, self._where, self._kind = file, where, kind
        self._topics, self._columns = topics, columns
        self._leave_out_bad = leave_out_bad
        self._start, self._end, self._seconds = start, end, seconds
        self._joint_names: tuple[str, ...] | None = None
        self._at_once: tuple[Measurements, Problems] | None = None
        self.problems = Problems()
        self.row_count = 0
        self.partial: Mapping[str, int] = {}
        self.ignored: tuple[str, ...] = ()
        self.left_out_joints: tuple[str, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints, in the order of columns of joint sensors."""
        if self._joint_names is None:
            self._joint_names = next(self.pieces(Problems())).joint_names
        return self._joint_names

    def __iter__(self) -> Iterator[Measurements]:
        return rechunked(self._checked(), self._seconds)

    def _checked(self) -> Iterator[Measurements]:
        problems = Problems()
        for piece in self.pieces(problems):
            if not self._leave_out_bad:
                refuse_problems(problems, self._where)
            yield piece.between(self._start, self._end)

    def pieces(self, problems: Problems) -> Iterator[Measurements]:
        """Yield the samples without problems, as the file's format cuts them; at least once.

        Args:
            problems: found problems are added to it.

        Raises:
            InputError: the file cannot be read, or has no samples.

        """
        if self._at_once is not None:
            measurements, found = self._at_once
            problems.add_all(found)
            yield measurements
            return
        converter = TableConverter(problems)
        columns = self._columns
        options = ReadOptions(problems, columns, self._topics)
        contents = self._kind.read(self._file, self._where, options)
        if isinstance(contents, Measurements) and not columns.is_house_format:
            contents = _raw_table(contents, columns, self._where)
        if isinstance(contents, Measurements):
            self._joint_names = contents.joint_names
            self.row_count = sum(len(s) for _, s in contents.items()) + problems.count
            self.problems = problems
            self._at_once = contents, problems  # to read it again would need the same memory
            yield contents
            return
        is_empty = True
        for table in [contents] if isinstance(contents, TelemetryTable) else contents:
            piece = converter.measurements(columns.house(table))
            self._joint_names, self.ignored = piece.joint_names, table.ignored
            self.left_out_joints = tuple(columns.left_out([*table.columns, *table.ignored]))
            is_empty = is_empty and time_interval(piece) is None
            yield piece
        if is_empty and not problems.count:
            raise InputError(f"{self._where}: the file has no samples")
        self.problems, self.partial = problems, converter.partial
        self.row_count = converter.row_count


def _raw_table(measurements: Measurements, columns: MappedColumns, where: str) -> TelemetryTable:
    """Return a bag's samples as a table, whose columns have the package's names, for a map."""
    quaternion = measurements.attitude.value
    unit = np.abs(np.linalg.norm(quaternion, axis=1, keepdims=True) - 1) < 1e-3
    attitude = Samples(measurements.attitude.time, np.where(unit, quaternion, np.nan))
    names, values = table_of(measurements.updated({"attitude": attitude}))
    keep = columns.select(names, where)
    ignored = tuple(name for name in names if name not in keep)
    chosen = values[:, [names.index(name) for name in keep]]
    return TelemetryTable(tuple(keep), chosen, np.arange(len(chosen)), ignored=ignored)


def check_telemetry(path: str | Path, columns: str | Path | None = None) -> None:
    """Refuse a file that cannot be telemetry, after a look at its name and beginning.

    Args:
        path: the file.
        columns: the YAML file of a map of its columns.

    Raises:
        InputError: no such file, a file of another kind, or a CSV file with a wrong first line; or
            for the same reasons as `columns_of`.

    """
    file, kind = format_of(path)
    wanted = columns_of(columns)
    if kind.check_head is not None:
        kind.check_head(file, str(path), wanted)


def format_of(path: str | Path) -> tuple[Path, Format]:
    """Return a file and its format.

    Raises:
        InputError: no such file, or no format with its ending.

    """
    ending, is_folder = Path(path).suffix.lower(), Path(path).is_dir()
    for kind in FORMATS:
        if kind.is_bag and (is_folder or ending in kind.endings):
            _refuse_pipes(Path(path))
            return Path(path), kind
    file = resolve_model(path)
    for kind in FORMATS:
        if file.suffix.lower() in kind.endings:
            return file, kind
    raise InputError(
        f"{path}: telemetry is read from {', '.join(telemetry_endings())} files and bag folders, "
        f"not from '{file.suffix or file.name}'"
    )


def _refuse_pipes(bag: Path) -> None:
    """Refuse pipes and devices in the place of a bag's files: to read them may never end.

    Raises:
        InputError: there is one.

    """
    for file in bag.iterdir() if bag.is_dir() else [bag]:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise InputError(f"{file}: {NOT_A_FILE}")


def read_telemetry(
    path: str | Path,
    *,
    leave_out_bad: bool = False,
    topics: Mapping[str, str] | None = None,
    columns: ColumnMap | str | Path | None = None,
) -> Measurements:
    """Return the samples in a telemetry file of any format in `FORMATS`.

    Args:
        path: the file, or a bag's folder.
        leave_out_bad: leave out rows that have a problem, instead of refusing the file.
        topics: topics of a bag; see `rosbag.read_rosbag`.
        columns: a map of the file's columns, or the map's YAML file.

    Raises:
        InputError: for the same reasons as `inspect_telemetry`; also for the first bad row, unless
            bad rows are left out.

    """
    found = inspect_telemetry(path, topics=topics, columns=columns)
    if not leave_out_bad:
        refuse_problems(found.problems, str(path))
    return found.measurements


def refuse_problems(problems: Problems, where: str) -> None:
    """Refuse a file that has problems.

    Raises:
        InputError: the first of them.

    """
    if problems.count:
        others = problems.count - 1
        more = f" (and {others} more: `cpid telemetry check` lists them)" if others else ""
        raise InputError(f"{where}: {problems.first[0]}{more}")


def write_telemetry(path: str | Path, motion: Telemetry | Measurements) -> None:
    """Write telemetry or measurements to a file; the ending chooses the format.

    All digits are kept.

    Raises:
        InputError: no format with this ending is written, a sensor has a time twice, or the file
            cannot be written.

    """
    path = Path(path)
    for kind in FORMATS:
        if path.suffix.lower() in kind.endings and kind.write is not None:
            columns, values = table_of(motion)
            with draft_of(path) as draft:
                kind.write(draft, columns, values)
            return
    endings = ", ".join(telemetry_endings(written=True))
    raise InputError(f"{path}: telemetry is written as {endings}")
