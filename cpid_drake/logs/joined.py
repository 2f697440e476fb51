"""Several files that make one log: the rows of all tables together, each file with its own clock.

`common_clock` finds by how much the clocks differ.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError, listed
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.log import THRUST
from cpid_drake.logs.table import LogTable
from cpid_drake.sensors.thrusters import VALVE

TOGETHER = "+"
"""Joins the names of files that make one log."""


def log_parts(path: str | Path) -> tuple[str, ...]:
    """Return the files of a log: two of "mocap.csv+joints.csv", unless there is such a file."""
    text = str(path)
    if TOGETHER not in text or Path(text).exists():
        return (text,)
    return tuple(text.split(TOGETHER))


def log_name(path: str | Path) -> str:
    """Return the name of a log without its folders."""
    return TOGETHER.join(Path(part).name for part in log_parts(path))


def joined(tables: Mapping[str, LogTable], time: Sequence[str] = ()) -> LogTable:
    """Return the rows of several files, in the order of their stamps.

    Args:
        tables: at least one, by the names of their files.
        time: the columns of the time, which all files have. Default: `time`, or else the first
            column that all have. Other columns that two files have cannot be used.

    Raises:
        InputError: a file has no such column, or has no time in common with those before it.

    """
    first, *others = tables.values()
    if not others:
        return first
    common = [name for name in first.columns if all(name in each.columns for each in others)]
    if not common and not time:
        raise InputError(
            f"{listed([*tables])} have no column in common; files of one log name their time alike"
        )
    time = time or (["time"] if "time" in common else common[:1])
    for file, table in tables.items():
        for name in time:
            if name not in table.columns:
                raise InputError(
                    f"{file}: there is no column '{name}'; files of one log name their time alike"
                )
    _refuse_apart({file: table.columns[time[0]] for file, table in tables.items()})
    counts = [len(table) for table in tables.values()]
    names = dict.fromkeys(name for table in tables.values() for name in table.columns)
    columns = {
        name: np.concatenate(
            [t.columns.get(name, np.full(len(t), np.nan)) for t in tables.values()]
        )
        for name in names
    }
    # Rows that go back in time stay behind those that they follow in their file.
    latest = [np.fmax.accumulate(table.columns[time[0]]) for table in tables.values()]
    order = np.argsort(np.concatenate(latest), kind="stable")
    place, start = np.argsort(order), np.cumsum([0, *counts])
    whole = LogTable(
        {name: column[order] for name, column in columns.items()},
        lines=np.concatenate([table.numbers for table in tables.values()])[order],
        files=tuple(tables),
        file_of_row=np.repeat(np.arange(len(counts)), counts)[order],
    )
    of_column = dict[str, str]()
    for k, (file, table) in enumerate(tables.items()):
        for name in (*table.columns, *table.unreadable):
            if name in of_column and name not in time:
                whole.unreadable[name] = f"is in {of_column[name]} and in {file}; ignore it in one"
            of_column.setdefault(name, file)
        whole.unreadable.update(table.unreadable)
        for name, cells in table.texts.items():
            own = whole.texts.setdefault(name, {})
            own.update({int(place[start[k] + row]): text for row, text in cells.items()})
        whole.problems += [(number, f"{file}: {text}") for number, text in table.problems]
        whole.rejected += table.rejected
        for name, notes in table.notes.items():
            whole.notes[name] = (*whole.notes.get(name, ()), *(f"{file}: {n}" for n in notes))
    whole.columns = {n: c for n, c in whole.columns.items() if n not in whole.unreadable}
    whole.file_of_column = of_column
    return whole


def files_of_sensors(used: ColumnMap, table: LogTable) -> dict[str, str]:
    """Return the file of each sensor, if there are several.

    Args:
        used: the map of all columns that are read.
        table: of `joined`.

    Raises:
        InputError: the columns of a sensor are in several files.

    """
    columns: dict[str, Iterable[str]] = {
        **used.of_sensors,
        THRUST: (*used.thrust.force, *used.thrust.torque),
        **{VALVE + valve: (column,) for valve, column in used.valves.items()},
    }
    by_sensor = dict[str, str]()
    for sensor, names in columns.items() if table.files else ():
        files = dict.fromkeys(table.file_of_column[name] for name in names)
        if len(files) > 1:
            raise InputError(
                f"the columns {listed([*names])} of one sensor are in {' and '.join(files)}, whose "
                "clocks may differ: write them into one file"
            )
        by_sensor.update(dict.fromkeys([sensor], *files) if files else {})
    return by_sensor


def _refuse_apart(times: Mapping[str, Array]) -> None:
    """Refuse files of which one ends before another begins, by more than clocks may differ."""
    spans = {
        file: (np.nanmin(t), np.nanmax(t)) for file, t in times.items() if np.isfinite(t).any()
    }
    (first, (start, end)), *others = spans.items()
    for file, (begin, last) in others:
        if max(start, begin) > min(end, last):
            raise InputError(
                f"{first} ({start:.12g} to {end:.12g}) and {file} ({begin:.12g} to {last:.12g}) "
                "have no time in common: write the stamps of both from the same zero"
            )
