"""Telemetry from and to files, in any format of the registry `FORMATS`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.resources import resolve_model
from cpid_drake.sensing.files.columnar import NPZ, PARQUET
from cpid_drake.sensing.files.csv_format import CSV
from cpid_drake.sensing.files.formats import Format, Topics
from cpid_drake.sensing.files.table import Problems, measurements_of_table, table_of
from cpid_drake.sensing.measurements import Measurements


def _read_bag(file: Path, where: str, problems: Problems, topics: Topics) -> Measurements:
    from cpid_drake.sensing.files.rosbag import read_usable  # imports SciPy's rotations

    return read_usable(file, problems, topics)


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

    """

    measurements: Measurements
    row_count: int
    problems: Problems
    partial: dict[str, int]
    ignored: tuple[str, ...]


def inspect_telemetry(
    path: str | Path, *, topics: Mapping[str, str] | None = None
) -> TelemetryFile:
    """Read a telemetry file and list all problems in it.

    `sensing.files.table` explains the columns. A sample that is absent is an empty cell in CSV
    files, NaN in NPZ files (one array (N,) for each column), null or NaN in Parquet files.

    Args:
        path: the file, or a bag's folder.
        topics: topics of a bag; see `rosbag.read_rosbag`.

    Raises:
        InputError: no such file or folder, a file of another kind, or one in which nothing can be
            read: see also `table.check_columns`.

    """
    where, problems = str(path), Problems()
    file, kind = _format_of(path)
    if topics and not kind.is_bag:
        raise InputError(f"{where}: topics are for ROS 2 bags")
    try:
        found = kind.read(file, where, problems, topics)
    except MemoryError as error:
        raise InputError(f"{where}: the file does not fit into memory") from error
    if isinstance(found, Measurements):
        count = sum(len(samples) for _, samples in found.items()) + problems.count
        return TelemetryFile(found, count, problems, {}, ())
    measurements, partial = measurements_of_table(found, problems)
    if not problems.count and not any(len(samples) for _, samples in measurements.items()):
        raise InputError(f"{where}: the file has no samples")
    return TelemetryFile(measurements, len(found.values), problems, partial, found.ignored)


def check_telemetry(path: str | Path) -> None:
    """Refuse a file that cannot be telemetry, after a look at its name and beginning.

    Raises:
        InputError: no such file, a file of another kind, or a CSV file with a wrong first line.

    """
    file, kind = _format_of(path)
    if kind.check_head is not None:
        kind.check_head(file, str(path))


def _format_of(path: str | Path) -> tuple[Path, Format]:
    """Return a file and its format."""
    ending, is_folder = Path(path).suffix.lower(), Path(path).is_dir()
    for kind in FORMATS:
        if kind.is_bag and (is_folder or ending in kind.endings):
            return Path(path), kind
    file = resolve_model(path)
    for kind in FORMATS:
        if file.suffix.lower() in kind.endings:
            return file, kind
    raise InputError(
        f"{path}: telemetry is read from {', '.join(telemetry_endings())} files and bag folders, "
        f"not from '{file.suffix or file.name}'"
    )


def read_telemetry(
    path: str | Path, *, leave_out_bad: bool = False, topics: Mapping[str, str] | None = None
) -> Measurements:
    """Return the samples in a telemetry file: CSV, NPZ, Parquet or a ROS 2 bag.

    Args:
        path: the file, or a bag's folder.
        leave_out_bad: leave out rows that have a problem, instead of refusing the file.
        topics: topics of a bag; see `rosbag.read_rosbag`.

    Raises:
        InputError: for the same reasons as `inspect_telemetry`; also for the first bad row, unless
            bad rows are left out.

    """
    found = inspect_telemetry(path, topics=topics)
    if not leave_out_bad:
        refuse_problems(found, str(path))
    return found.measurements


def refuse_problems(found: TelemetryFile, where: str) -> None:
    """Refuse a file that has problems.

    Raises:
        InputError: the first of them.

    """
    if found.problems.count:
        others = found.problems.count - 1
        more = f" (and {others} more: `cpid telemetry check` lists them)" if others else ""
        raise InputError(f"{where}: {found.problems.first[0]}{more}")


def write_telemetry(path: str | Path, motion: Telemetry | Measurements) -> None:
    """Write telemetry or measurements to a file; the ending chooses the format.

    All digits are kept.

    Raises:
        InputError: no format with this ending is written, or a sensor has a time twice.

    """
    path = Path(path)
    for kind in FORMATS:
        if path.suffix.lower() in kind.endings and kind.write is not None:
            columns, values = table_of(motion)
            kind.write(path, columns, values)
            return
    endings = ", ".join(telemetry_endings(written=True))
    raise InputError(f"{path}: telemetry is written as {endings}")
