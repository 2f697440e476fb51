"""Logs from and to files, in any format of the registry `FORMATS`."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.files.drafts import draft_of
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import resolve_model
from cpid_drake.logs.column_map import ColumnMap, load_column_map
from cpid_drake.logs.conversion import LogFile, read_columns
from cpid_drake.logs.csv_format import read_csv, write_csv
from cpid_drake.logs.joined import joined, log_parts
from cpid_drake.logs.log import THRUST, THRUST_COLUMNS, Log
from cpid_drake.logs.parquet_format import read_parquet, write_parquet
from cpid_drake.logs.table import LogTable, common_rows
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.thrusters import VALVE

Read = Callable[[Path, str], LogTable]
"""Reads a file, given its path and its name in messages."""

Write = Callable[[Path, list[str], Array], None]
"""Writes columns, names and values (N, C) with NaN where a cell is absent."""

FORMATS: dict[str, tuple[Read, Write | None]] = {
    ".csv": (read_csv, write_csv),
    ".parquet": (read_parquet, write_parquet),
}
"""All formats of one file with one time, by the ending in lower case."""

BAG_ENDINGS = (".mcap", ".db3", ".bag")
"""Endings of bags of ROS 2, which can be folders too, and of ROS 1."""


def inspect_log(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    columns: ColumnMap | str | Path | None = None,
    joints: Collection[str] | None = None,
) -> LogFile:
    """Read a log file and list all problems in it.

    `logs.column_choice` explains the columns. A sample that is absent is an empty cell in CSV
    files, null or NaN in Parquet files.

    Args:
        path: the file, or a bag's folder. Of several files that make one log, the names with "+"
            between them.
        topics: topics of a bag; see `rosbag.read_rosbag`.
        columns: a map of the file's columns, or the map's YAML file; None for the package's own
            columns.
        joints: the spacecraft's joints, if they are known; see `read_columns`.

    Raises:
        InputError: no such file or folder, a file of another kind, or one in which nothing can be
            read: see also `read_columns`.

    """
    given, map_name = columns or ColumnMap(), "the map"
    if not isinstance(given, ColumnMap):
        given, map_name = load_column_map(given), str(given)
    try:
        clock = [name for name in (given.time.column, given.time.nanoseconds) if name]
        table = read_table(path, topics, clock)
        return read_columns(given, table, str(path), map_name=map_name, joints=joints)
    except MemoryError as error:
        raise InputError(f"{path}: the file does not fit into memory") from error


def read_table(
    path: str | Path, topics: Mapping[str, str] | None = None, time: Sequence[str] = ()
) -> LogTable:
    """Return the columns of a log file as they are in the file, or of several files together.

    Args:
        path, topics: see `inspect_log`.
        time: the columns of the time, if there are several files; see `joined`.

    Raises:
        InputError: no such file or folder, a file of another kind, or one that cannot be read; see
            also `joined`.

    """
    parts = log_parts(path)
    if len(parts) == 1:
        return _read_file(path, topics)
    if not all(parts) or len({*parts}) < len(parts):
        raise InputError(f"{path}: name each file of the log once, with + between them")
    names = [Path(part).name for part in parts]
    names = names if len({*names}) == len(names) else [*parts]
    tables = (_read_file(part, topics if _is_bag(Path(part)) else None) for part in parts)
    return joined(dict(zip(names, tables, strict=True)), time)


def _is_bag(file: Path) -> bool:
    return file.is_dir() or file.suffix.lower() in BAG_ENDINGS


def _read_file(path: str | Path, topics: Mapping[str, str] | None) -> LogTable:
    file = Path(path)
    if _is_bag(file):
        from cpid_drake.logs.rosbag import read_rosbag

        return read_rosbag(file, topics or {})
    file = resolve_model(path)
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            f"{path}: logs are read from {', '.join([*FORMATS, *BAG_ENDINGS])} files and bag "
            f"folders, not from '{file.suffix or file.name}'; `from_columns` has arrays in memory"
        )
    if topics:
        raise InputError(f"{path}: topics are for ROS bags")
    return FORMATS[file.suffix.lower()][0](file, str(path))


def read_log(
    path: str | Path,
    *,
    leave_out_bad: bool = False,
    topics: Mapping[str, str] | None = None,
    columns: ColumnMap | str | Path | None = None,
) -> Log:
    """Return the samples in a log file of any format in `FORMATS`, or in a ROS bag.

    Args:
        path, topics, columns: see `inspect_log`.
        leave_out_bad: leave out rows that have a problem, instead of refusing the file.

    Raises:
        InputError: as `inspect_log`; also for the first bad row, unless bad rows are left out.

    """
    file = inspect_log(path, topics=topics, columns=columns)
    if not leave_out_bad:
        refuse_problems(file.problems, str(path))
    return file.log


def refuse_problems(problems: Sequence[str], where: str) -> None:
    """Refuse a file that has problems.

    Raises:
        InputError: the first of them.

    """
    if problems:
        others = len(problems) - 1
        more = f" (and {others} more: `cpid log check` lists them)" if others else ""
        remedy = "; --leave-out-bad reads the other rows"
        raise InputError(f"{where}: {problems[0]}{more}{remedy}")


def write_log(path: str | Path, motion: Motion | Log) -> None:
    """Write a motion or a log to a file; the ending chooses the format.

    All digits are kept.

    Raises:
        InputError: no format with this ending is written, or the file cannot be written.

    """
    path = Path(path)
    write = FORMATS.get(path.suffix.lower(), (None, None))[1]
    if write is None:
        endings = ", ".join(ending for ending, (_, writer) in FORMATS.items() if writer)
        raise InputError(f"{path}: logs are written as {endings}")
    columns, values = table_of(motion)
    with draft_of(path) as draft:
        write(draft, columns, values)


def table_of(motion: Motion | Log) -> tuple[list[str], Array]:
    """Return the package's columns and values (N, C) of a motion or a log; NaN for absent cells.

    The angular velocity of a motion is in W, that of a log in B, as gyros measure it.
    """
    joints = motion.joint_names
    if isinstance(motion, Motion):
        groups = {
            SENSORS["attitude"].columns: motion.quaternion_WB,
            SENSORS["position"].columns: motion.p_WB,
            SENSORS["gyro"].columns_in_W: motion.w_WB,
            SENSORS["velocity"].columns: motion.v_WB,
            SENSORS["encoders"].columns_of(joints): motion.q,
            SENSORS["joint_rates"].columns_of(joints): motion.qdot,
        }
        values = np.hstack([motion.time[:, None], *groups.values()])
        return ["time", *(name for group in groups for name in group)], values
    valves = {VALVE + name: samples for name, samples in motion.valves.items()}
    everything = {**dict(motion.items()), THRUST: motion.thrust, **valves}
    time, rows = common_rows([samples.time for samples in everything.values()])
    names, blocks = ["time"], [time[:, None]]
    for (name, samples), own in zip(everything.items(), rows, strict=True):
        if not len(samples):
            continue
        if name == THRUST:
            names += THRUST_COLUMNS
        else:
            names += SENSORS[name].columns_of(joints) if name in SENSORS else (name,)
        block = np.full((time.size, samples.value.shape[1]), np.nan)
        block[own] = samples.value
        blocks.append(block)
    return names, np.hstack(blocks)
