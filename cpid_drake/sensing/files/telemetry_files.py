"""Telemetry from and to files, in any format of the registry `FORMATS`."""

from collections.abc import Collection, Mapping
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
from cpid_drake.sensing.files.formats import Format, ReadOptions
from cpid_drake.sensing.files.mapped_columns import MappedColumns, columns_of
from cpid_drake.sensing.files.table import (
    LARGEST_TABLE,
    Problems,
    TableConverter,
    TelemetryTable,
    table_of,
)
from cpid_drake.sensing.measurements import Measurements, Samples, concatenated


def _read_bag(file: Path, where: str, options: ReadOptions) -> Measurements:
    from cpid_drake.sensing.files.rosbag import read_usable

    return read_usable(file, options.problems, options.topics)


ROSBAG = Format("ROS 2 bag", (".mcap", ".db3"), _read_bag, is_bag=True)

FORMATS: list[Format] = [CSV, NPZ, PARQUET, ROSBAG]
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
        columns: a map of the file's columns, or the map's YAML file; None for the package's own
            columns.
        joints: the spacecraft's joints, if they are known; columns of other joints are then left
            out, unless one of the spacecraft's is missing.

    Raises:
        InputError: no such file or folder, a file of another kind, or one in which nothing can be
            read: see also `columns_of` and `table.check_columns`.

    """
    file, kind = format_of(path)
    if topics and not kind.is_bag:
        raise InputError(f"{path}: topics are for ROS 2 bags")
    selected, problems = columns_of(columns, joints), Problems()
    try:
        return _read(file, str(path), kind, ReadOptions(problems, selected, topics), selected)
    except MemoryError as error:
        raise InputError(f"{path}: the file does not fit into memory") from error


def _read(
    file: Path, where: str, kind: Format, options: ReadOptions, columns: MappedColumns
) -> TelemetryFile:
    problems = options.problems
    contents = kind.read(file, where, options)
    if isinstance(contents, Measurements) and not columns.is_house_format:
        contents = _raw_table(contents, columns, where)
    if isinstance(contents, Measurements):
        count = sum(len(s) for _, s in contents.items()) + problems.count
        return TelemetryFile(contents, count, problems, {}, ())
    converter, pieces, size = TableConverter(problems), list[Measurements](), 0
    ignored: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    for table in [contents] if isinstance(contents, TelemetryTable) else contents:
        pieces.append(converter.measurements(columns.house(table)))
        ignored, left_out = table.ignored, tuple(columns.left_out([*table.columns, *table.ignored]))
        size += table.values.size
        if size > LARGEST_TABLE:
            raise InputError(f"{where}: more than {LARGEST_TABLE} numbers; split the file")
    measurements = concatenated(pieces)
    if not np.isfinite(measurements.interval[0]) and not problems.count:
        raise InputError(f"{where}: the file has no samples")
    return TelemetryFile(
        measurements, converter.row_count, problems, dict(converter.partial), ignored, left_out
    )


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
