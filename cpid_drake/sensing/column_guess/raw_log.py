"""All columns of a log as they are in the file, for a guess at their meaning."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.formats import ReadOptions, Topics
from cpid_drake.sensing.files.table import Problems, TelemetryTable, table_of
from cpid_drake.sensing.files.telemetry_files import format_of
from cpid_drake.sensing.measurements import Measurements

LONGEST_LOOK = 20_000
"""Number of rows that are read."""


@dataclass(frozen=True, eq=False)
class RawLog:
    """The first rows of a log.

    Attributes:
        values: by column of numbers, its cells (N,), NaN where a cell is absent.
        texts: by column of text, its first cell.

    """

    values: dict[str, NDArray[np.float64]]
    texts: dict[str, str]

    def has_unit_norm(self, columns: Iterable[str]) -> bool:
        """Return whether columns together have the norm 1 in nearly all rows that have them."""
        norm = np.linalg.norm([self.values[name] for name in columns], axis=0)
        there = norm[np.isfinite(norm)]
        return bool(there.size and np.mean(np.abs(there - 1) < 1e-2) > 0.95)


@dataclass
class _AllColumns:
    """Selects all columns of a file, and collects those of text."""

    texts: dict[str, str] | None = field(default_factory=dict)

    def select(self, names: Sequence[str], where: str) -> list[str]:
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{where}: the column '{name}' is there {names.count(name)} times")
        return list(names)


def read_raw(path: str | Path, topics: Topics = None) -> RawLog:
    """Read the first rows of a log with all its columns.

    Raises:
        InputError: no such file, a file of another kind, or one without rows.

    """
    file, kind = format_of(path)
    columns = _AllColumns()
    contents = kind.read(file, str(path), ReadOptions(Problems(), columns, topics))
    if isinstance(contents, Measurements):
        names, values = table_of(contents)
        contents = TelemetryTable(tuple(names), values, np.arange(len(values)))
    tables, count = [], 0
    for table in [contents] if isinstance(contents, TelemetryTable) else contents:
        tables.append(table)
        count += len(table.values)
        if count >= LONGEST_LOOK:
            break
    if not count:
        raise InputError(f"{path}: the file has no rows of numbers")
    values = np.concatenate([table.values for table in tables])[:LONGEST_LOOK]
    texts = columns.texts or {}
    columns_of_numbers = {
        name: column
        for name, column in zip(tables[0].columns, values.T)
        if np.isfinite(column).any() and name not in texts
    }
    return RawLog(columns_of_numbers, texts)
