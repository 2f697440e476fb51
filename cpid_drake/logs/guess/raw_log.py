"""All columns of a log as they are in the file, for a guess at their meaning."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.files import read_table


@dataclass(frozen=True, eq=False)
class RawLog:
    """The rows of a log.

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


def read_raw(path: str | Path, topics: Mapping[str, str] | None = None) -> RawLog:
    """Read a log with all its columns.

    Raises:
        InputError: no such file, a file of another kind, or one without rows.

    """
    table = read_table(path, topics)
    for name, count in table.twice.items():
        raise InputError(f"{path}: the column '{name}' is there {count} times")
    if not len(table):
        raise InputError(f"{path}: the file has no rows of numbers")
    texts = {name: next(iter(cells.values())) for name, cells in table.texts.items()}
    values = {
        name: column
        for name, column in table.columns.items()
        if name not in texts and np.isfinite(column).any()
    }
    return RawLog(values, texts)
