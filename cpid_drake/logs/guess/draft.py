"""A map of columns in the making, and the choice of conventions that names leave open."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.alternatives import alternatives
from cpid_drake.logs.column_map import ColumnMap, with_entries
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.guess.names import unit_of
from cpid_drake.logs.guess.raw_log import RawLog
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.score import Instants, compare_momentum, compare_rates, instants_of
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft

CLEAR = 1.5
"""Ratio of residuals above which one of a few possible conventions is right."""

Residual = Callable[[Instants], float | None]


@dataclass(eq=False)
class MapDraft:
    """A map in the making.

    Attributes:
        raw: the log.
        spacecraft: the known spacecraft.
        base: name of the base body.
        map: the map so far.
        reasons: by key of the map, the reasons for its entries.
        open: what nothing in the log confirms, in words.
        has_free_order: whether the columns' names leave the order of the quaternion open.
        joint_unit_is_open: whether joint positions may be in rad or in deg.
        compared: residuals and maps of the conventions among which the last choice was made.

    """

    raw: RawLog
    spacecraft: Spacecraft
    base: str
    map: ColumnMap = field(default_factory=ColumnMap)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    open: list[str] = field(default_factory=list)
    has_free_order: bool = False
    joint_unit_is_open: bool = False
    compared: list[tuple[float, ColumnMap]] = field(default_factory=list)

    def say(self, key: str, text: str) -> None:
        """Add a reason for an entry."""
        self.reasons.setdefault(key, []).append(text)

    def measurements(self) -> Log:
        """Return the samples as read with the map."""
        read = read_columns(self.map, Table(dict(self.raw.values)), "the log").measurements
        return _in_order(screen(read).log, self.spacecraft.joint_names)

    # -- conventions -------------------------------------------------------------------------

    def choose(self, residual: Residual, *groups: Collection[str]) -> float | None:
        """Adopt a convention of small residual; return it, or None if nothing can be compared.

        Of conventions that are about as good, the first is chosen: what is usual comes first.

        Args:
            residual: the comparison.
            groups: keys of the map that are open; one alternative of each group, or none.

        """
        self.compared = []
        for order in self._orders("attitude.order" in {key for group in groups for key in group}):
            started = replace(self.map, attitude=replace(self.map.attitude, order=order))
            given = replace(self, map=started).instants()
            for column_map, log in () if given is None else self._options(started, given, *groups):
                value = residual(log)
                if value is not None:
                    self.compared.append((value, column_map))
        if not self.compared:
            return None
        least = min(value for value, _ in self.compared)
        value, self.map = next(e for e in self.compared if e[0] <= CLEAR * least + 1e-9)
        return value

    def _options(
        self, column_map: ColumnMap, given: Instants, *groups: Collection[str]
    ) -> Iterator[tuple[ColumnMap, Instants]]:
        """Yield maps with changed keys, of each group or of none, and what the log then says."""
        if not groups:
            yield column_map, given
            return
        first, *others = groups
        yield from self._options(column_map, given, *others)
        for each in alternatives(given, self.spacecraft.joint_names, self.tree, column_map):
            if each.entries and set(each.entries) <= set(first):
                changed = with_entries(column_map, each.entries)
                yield from self._options(changed, each.log, *others)

    def _orders(self, is_open: bool) -> Sequence[Any]:
        """Return orders of three angles, which no change of quaternions gives."""
        order = self.map.attitude.order
        is_rotation = is_open and order == "rotation_vector"
        return ("rotation_vector", "euler_xyz") if is_rotation else (order,)

    @property
    def tree(self) -> KinematicTree:
        """The known bodies."""
        return self.spacecraft.tree.lumped

    def instants(self) -> Instants | None:
        """Return what the log says if it is read with the map."""
        return instants_of(self.measurements())

    def momentum(self, log: Instants) -> float | None:
        """Return the comparison with the conservation of momentum."""
        found = compare_momentum(log, self.tree)
        return found[0].residual if found else None

    def attitude_keys(self) -> set[str]:
        """Return the keys of the attitude that the names of columns leave open."""
        return {"attitude.direction", *(["attitude.order"] if self.has_free_order else [])}

    def rates(self, name: str) -> Residual:
        """Return the comparison of positions and rates of a name, or all that begin with "q:"."""

        def residual(log: Instants) -> float | None:
            found = compare_rates(log, self.spacecraft.joint_names)
            values = [c.residual for c in found if c.name.startswith(name)]
            return float(np.mean(values)) if values else None

        return residual


def stated_unit(columns: Iterable[str]) -> Any:
    """Return the unit that the names of columns state; None if they state none, or several."""
    units = {unit_of(column) for column in columns} - {None}
    return units.pop() if len(units) == 1 else None


def _in_order(measurements: Log, joints: Sequence[str]) -> Log:
    """Return measurements with these joints; those that are missing are at zero."""
    have = measurements.joint_names
    order = [have.index(joint) if joint in have else -1 for joint in joints]
    changed = {}
    for name in ("encoders", "joint_rates"):
        samples = measurements[name]
        value = np.nan_to_num(np.column_stack([samples.value, np.zeros(len(samples))]))
        changed[name] = Samples(samples.time, value[:, order])
    return Log(tuple(joints), {**measurements.samples, **changed}, measurements.column_map)
