"""Numbers in a file that mark absent samples, such as -9999, which no sensor measured.

A mark repeats exactly, and is far from all other values. A position never moves so far from one
sample to the next; a rate may, so that all entries of its sensor must hold the same mark.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.errors import listed
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.noise_estimation import FEWEST
from cpid_drake.logs.table import LogTable
from cpid_drake.sensors.sensors import POSITIONS

_FAR = 3.0
"""Distance of a mark from all other values, in ranges of these."""

_MARKS = 3
"""Most different marks in a column."""


def marks_in(column: Array) -> list[float]:
    """Return the values of a column (N,) that mark absent samples; NaN is absent, too."""
    others, taken, marks = column[np.isfinite(column)], list[float](), list[float]()
    for _ in range(_MARKS if others.size else 0):
        ends = (float(others.min()), float(others.max()))
        left = [others[others != end] for end in ends]
        k = int(np.argmin([np.ptp(each) if each.size else np.inf for each in left]))
        if len(others) - len(left[k]) < 2 or len(left[k]) < FEWEST:
            break
        others = left[k]
        taken.append(ends[k])
        distance = min(float(np.abs(others - value).min()) for value in taken)
        if distance > _FAR * np.ptp(others) > 0:
            marks = [*taken]
    return marks


def without_marks(table: LogTable, used: ColumnMap) -> LogTable:
    """Return a table in which the marks of absent samples are absent, with a note for each sensor.

    Args:
        table: the columns.
        used: the map of all columns that are read.

    """
    columns: dict[str, Array] = {}
    notes: Mapping[str, tuple[str, ...]] = table.notes
    for sensor, names in used.of_sensors.items():
        marks = {name: marks_in(table.columns[name]) for name in names}
        if not any(marks.values()):
            continue
        block = table.block(names)
        marked = np.stack([np.isin(c, marks[n]) for n, c in zip(names, block.T)], axis=1)
        is_whole = (block == block[:, :1]).all(axis=1, keepdims=True) & (len(names) > 1)
        if sensor in POSITIONS:
            marked &= is_whole
        else:  # a joint may rest elsewhere after a pause of the log, and does not come back
            marked &= is_whole | ~(marked[:1] | marked[-1:])
        if marked.any():
            columns |= {n: np.where(m, np.nan, table.columns[n]) for n, m in zip(names, marked.T)}
            values = listed([f"{value:.10g}" for value in np.unique(block[marked])])
            rows = int(marked.any(axis=1).sum())
            text = f"{values} in {rows} rows, far from all other values, is read as absent"
            notes = {**notes, sensor: (*notes.get(sensor, ()), text)}
    return replace(table, columns={**table.columns, **columns}, notes=dict(notes))
