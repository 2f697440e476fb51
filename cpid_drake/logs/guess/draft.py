"""A map of columns in the making, and the samples as read with it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.guess.names import unit_of
from cpid_drake.logs.guess.raw_log import RawLog
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(eq=False)
class MapDraft:
    """A map in the making.

    Attributes:
        raw: the log.
        spacecraft: the known spacecraft.
        base: name of the base body.
        map: the map so far.
        reasons: by key of the map, the reasons for its entries.
        open: units that nothing in the log confirms, in words.
        has_free_order: whether the columns' names leave the order of the quaternion open.

    """

    raw: RawLog
    spacecraft: Spacecraft
    base: str
    map: ColumnMap = field(default_factory=ColumnMap)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    open: list[str] = field(default_factory=list)
    has_free_order: bool = False

    def say(self, key: str, text: str) -> None:
        """Add a reason for an entry."""
        self.reasons.setdefault(key, []).append(text)

    def measurements(self, **changes: Any) -> Measurements:
        """Return the samples as read with the map, or with changed parts of it."""
        table, given = Table(dict(self.raw.values)), replace(self.map, **changes)
        read = read_columns(given, table, "the log").measurements
        return _in_order(screen(read).measurements, self.spacecraft.joint_names)


def least(error: Callable[[Any], float], choices: Iterable[Any]) -> tuple[Any, float]:
    """Return the choice of least error, the first of equal ones, and its error."""
    errors = [(error(choice), choice) for choice in choices]
    least = min(e for e, _ in errors)
    # Differences of rounding do not count: the first choice is the usual one.
    return next((choice, e) for e, choice in errors if e <= least * 1.001 + 1e-9)


def stated_unit(columns: Iterable[str]) -> Any:
    """Return the unit that the names of columns state; None if they state none, or several."""
    units = {unit_of(column) for column in columns} - {None}
    return units.pop() if len(units) == 1 else None


def _in_order(measurements: Measurements, joints: Sequence[str]) -> Measurements:
    """Return measurements with these joints; those that are missing are at zero."""
    have = measurements.joint_names
    order = [have.index(joint) if joint in have else -1 for joint in joints]
    changed = {}
    for name in ("encoders", "joint_rates"):
        samples = measurements[name]
        value = np.nan_to_num(np.column_stack([samples.value, np.zeros(len(samples))]))
        changed[name] = Samples(samples.time, value[:, order])
    return Measurements(tuple(joints), {**measurements.samples, **changed})
