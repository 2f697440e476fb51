"""A map of columns in the making."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.logs.column_map import ColumnMap, TimeUnit
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(eq=False)
class MapDraft:
    """A map in the making.

    Attributes:
        columns: the columns of numbers (N,), NaN where a cell is absent.
        texts: by column of text, its first cell.
        spacecraft: the known spacecraft.
        base: name of the base body.
        map: the map so far.
        reasons: by key of the map, the reasons for its entries.
        free: keys of conventions about which names and values say nothing.
        time_units: units of the time that the steps allow besides that of the map.

    """

    columns: dict[str, NDArray[np.float64]]
    texts: dict[str, str]
    spacecraft: Spacecraft
    base: str
    map: ColumnMap = field(default_factory=ColumnMap)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    free: set[str] = field(default_factory=set)
    time_units: tuple[TimeUnit, ...] = ()

    def say(self, key: str, text: str) -> None:
        """Add a reason for an entry."""
        self.reasons.setdefault(key, []).append(text)

    def largest(self, columns: Iterable[str]) -> float:
        """Return the largest size of a number in columns."""
        return max((float(np.nanmax(np.abs(self.columns[c]))) for c in columns), default=0.0)

    def has_unit_norm(self, columns: Iterable[str]) -> bool:
        """Return whether columns together have the norm 1 in nearly all rows that have them."""
        norm = np.linalg.norm([self.columns[name] for name in columns], axis=0)
        there = norm[np.isfinite(norm)]
        return bool(there.size and np.mean(np.abs(there - 1) < 1e-2) > 0.95)
