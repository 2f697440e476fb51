"""Finds the conventions that explain a log better than those in which it is read.

An alternative differs from the given map of columns in one convention: a unit, an order or a
direction of the attitude, axes, a sign, the clock, or which joint is which; if none of these
explains the log, in several. The more, the better it must explain. `logs.search` compares them. If
attitude and gyro turn differently, they decide first, without the momentum, about their readings;
joints, a turn of both, and the position then follow from the momentum. Errors of any size (delays,
scales, zeros, masses) are no conventions: a fit compares them by evidence.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import listed
from cpid_drake.logs.alternatives import Alternative, alternatives
from cpid_drake.logs.clock import clock_factor, with_delay
from cpid_drake.logs.column_map import ColumnMap, with_entries
from cpid_drake.logs.combined_alternatives import (
    as_read,
    attitude_alternatives,
    joint_alternatives,
    of_attitude,
    turned_attitudes,
)
from cpid_drake.logs.common_clock import gyro_delay
from cpid_drake.logs.common_turn import common_turns
from cpid_drake.logs.instants import Instants, SmoothedLog, instants_of
from cpid_drake.logs.log import Log
from cpid_drake.logs.score import MOMENTUM, Comparison, compare_momentum, compare_rates
from cpid_drake.logs.search import AGREES, EXPLAINS, Budget, Search, limit_of
from cpid_drake.sensors.sensors import POSITIONS, SENSORS

BUDGET = 2.0
"""Longest search for other conventions [s of a processor]."""

IS_SMALL = 0.02
"""Residual of the momentum of which noise and errors of some size are the likeliest cause."""

DIFFERS = 0.5
"""Residual of positions and rates that are of different motions."""

_PLACE = {"position.unit", "position.point_B"}
"""The conventions of a position that may be wrong beside others."""

_MOST_BASES = 4
"""Most readings of attitude and gyro of which other conventions are compared."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What the comparisons of a log say.

    Attributes:
        comparisons: all that are possible.
        clock: true time divided by logged time, if it is not one.
        better: alternatives that explain the log clearly better than the conventions it is read in.
        unchecked: what could not be compared, each with the reason.
        not_compared: positions and rates that the log has, but that show no motion to compare, or
            that are alone, and the momentum does not explain them.

    """

    comparisons: tuple[Comparison, ...] = ()
    clock: float | None = None
    better: tuple[Alternative, ...] = ()
    unchecked: tuple[str, ...] = ()
    not_compared: tuple[str, ...] = ()

    @property
    def has_momentum(self) -> bool:
        """Whether the momentum leaves too little of the motion to ask for another convention."""
        return all(c.residual <= IS_SMALL for c in self.comparisons if c.name == MOMENTUM)

    @property
    def sentence(self) -> str:
        """The convention that explains the log better, and the remedy; empty without one."""
        return ", or ".join(each.sentence for each in self.better)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a fit must judge: the point of the position, and rates that differ from positions.

        The spacecraft may differ from its model instead, or noise may be larger than the motion.
        """
        if self.better:
            return (self.sentence,) if self.better[0].is_point else ()
        return tuple(
            c.text
            if c.delay
            else f"{c.sides[0]} and {c.sides[1]} differ by {c.residual:.0%}, in any convention"
            for c in self.comparisons
            if c.name != MOMENTUM and (c.residual > DIFFERS or c.delay)
        )

    @property
    def failures(self) -> tuple[str, ...]:
        """Contradictions in the log, as sentences: the convention, or the clock."""
        if self.better:
            return () if self.better[0].is_point else (self.sentence,)
        if self.clock is None:
            return ()
        return (
            f"the clock is wrong: by positions and rates, a second of the log takes "
            f"{self.clock:.4g} s (do its rows count steps? time.from_rates: true in a map of "
            "columns takes the time from the rates)",
        )


def check_conventions(
    log: Log,
    tree: KinematicTree | None,
    *,
    by_momentum: bool = True,
) -> Findings:
    """Compare the quantities of a log with each other, and with what the momentum allows.

    Args:
        log: screened samples, joints in the spacecraft's order.
        tree: the spacecraft model; None to compare positions with rates only.
        by_momentum: whether to look for another convention in any case, of which the momentum may
            decide; else only if rates contradict positions. An estimate from the log says better
            whether the momentum is conserved, with noise, forces and errors.

    """
    smoothed = SmoothedLog.of(log)
    given = None if smoothed is None else smoothed.instants()
    if smoothed is None or given is None:
        return Findings(unchecked=("units, signs and frames (too few samples)",))
    comparisons = _comparisons(given, log, tree)
    failed = _failed(comparisons)
    better, is_decided = list[Alternative](), True
    if by_momentum or any(c.name != MOMENTUM for c in failed):
        column_map = log.column_map or ColumnMap()
        in_time = _with_gyro_in_time(given, smoothed, log, comparisons)
        better, is_decided = better_conventions(in_time, log.joint_names, tree, column_map)
    elif any(c.name == "attitude" and c.residual > EXPLAINS for c in comparisons):  # turns a little
        search = Search(given, log.joint_names, None)
        search.compare(of_attitude(given, log.column_map or ColumnMap()))
        better = search.named
    unchecked = []
    momentum = next((c for c in comparisons if c.name == MOMENTUM), None)
    if tree is None:
        unchecked.append("units of position, its point, signs of joints (needs --spacecraft)")
    elif momentum is None:
        unchecked.append("unit and point of the position, signs of joints (no motion to compare)")
    elif not better and not is_decided:
        unchecked.append(f"other units, signs and axes (not decided in {BUDGET:g} s of a search)")
    elif momentum in failed and not better:
        unchecked.append(
            "unit and point of the position, signs of joints (momentum leaves "
            f"{min(momentum.residual, 1.0):.0%} of the motion unexplained, as errors of a "
            "clock, of a joint, of the axes of the base or of the model's masses do)"
        )
    clock = None if better else clock_factor(comparisons)
    if not better and clock is None:
        comparisons = [with_delay(each, given.time) for each in comparisons]
    unmoved = _not_compared(log, {each.name for each in comparisons})
    if momentum is None or momentum in failed:
        unmoved = (*unmoved, *_alone(log))
    return Findings(tuple(comparisons), clock, tuple(better), tuple(unchecked), unmoved)


def _with_gyro_in_time(
    given: Instants, smoothed: SmoothedLog, log: Log, comparisons: Sequence[Comparison]
) -> Instants:
    """Return what a log says without the delay of its gyro, which would hide other conventions."""
    if not any(c.name == "attitude" and c.residual > EXPLAINS for c in comparisons):
        return given
    return smoothed.instants({"gyro": gyro_delay(log, smoothed)}) or given


def has_agreement(log: Log, tree: KinematicTree) -> bool:
    """Return whether nothing in a screened log contradicts the conventions in which it is read."""
    given = instants_of(log)
    return given is None or not _failed(_comparisons(given, log, tree))


def _comparisons(given: Instants, log: Log, tree: KinematicTree | None) -> list[Comparison]:
    return compare_rates(given, log.joint_names) + compare_momentum(given, tree)


def _failed(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons whose residuals a right convention does not leave."""
    return [c for c in comparisons if c.residual > limit_of(c.name)]


def _not_compared(log: Log, compared: Collection[str]) -> tuple[str, ...]:
    """Return the positions and rates that a log has, and that are not compared, in words."""
    pairs = {f"q:{joint}": ("encoders", "joint_rates") for joint in log.joint_names}
    pairs |= {"position": ("position", "velocity"), "attitude": ("attitude", "gyro")}
    absent = [
        name
        for name, (moved, rate) in pairs.items()
        if name not in compared and len(log[moved]) and len(log[rate])
    ]
    if not absent:
        return ()
    return (f"{listed(absent)} with measured rates (no motion, or one side does not show it)",)


def _alone(log: Log) -> Iterator[str]:
    """Yield the conventions that stay open because a log has no other side to compare with."""
    for rate, position in POSITIONS.items():
        open_of = "order and direction" if position == "attitude" else "unit"
        for name, other, what in ((rate, position, "unit"), (position, rate, open_of)):
            # The unit of a position is open in any case without the momentum.
            if len(log[name]) and not len(log[other]) and name != "position":
                label, wanted = SENSORS[name].quantity, SENSORS[other].quantity
                yield f"{what} of the {label} (no {wanted} to compare with)"


def better_conventions(
    given: Instants, names: tuple[str, ...], tree: KinematicTree | None, column_map: ColumnMap
) -> tuple[list[Alternative], bool]:
    """Return the alternatives that explain a log clearly better than the conventions it is read in.

    Several conventions at once are tried if no single one explains the log. The arguments are those
    of `alternatives`.

    Returns:
        The alternatives, of which the usual one is first, and others explain the log equally well;
        none if too many do. And whether all were compared, within `BUDGET`.

    """
    tree = None if tree is None else tree.lumped
    budget = Budget(BUDGET)
    search = Search(given, names, tree)
    search.compare(budget.spent_on(alternatives(given, names, tree, column_map)))
    if not search.explains_all:
        search.compare(budget.spent_on(turned_attitudes(given, tree, column_map)))
    if tree is None or search.explains_all:
        return search.named, budget.is_enough
    given, place = given.at_every(2), ("position", "velocity")  # many are compared
    part = given.without(*place)
    bases = [as_read(part, tree)]
    by_rates = Search(part, names, None)
    if by_rates.residual("attitude") > AGREES:  # rates decide; the momentum may not agree yet
        by_rates.compare(budget.spent_on(attitude_alternatives(part, tree, column_map)))
        bases = by_rates.better[:_MOST_BASES]
    elif search.named:
        return search.named, budget.is_enough
    single = search.named
    for apart, ways in (
        (place, (joint_alternatives, partial(common_turns, given))),  # takes least
        ((), (joint_alternatives, partial(alternatives, keys=_PLACE))),
    ):
        part = given.without(*apart)
        search = Search(part, names, tree)
        readings = [replace(each, log=each.log.over(part)) for each in bases]
        search.compare(budget.spent_on(each for each in readings if each.count))
        for way in () if search.explains_all else ways:
            for base in readings:
                changed = with_entries(column_map, base.entries)
                others = way(base.log, names, tree, changed)
                search.compare(budget.spent_on(base.then(each) for each in others if each.count))
            if search.explains_all:
                break
        best = [each for each in search.named if _has_place(each, given, names, tree, column_map)]
        if best:
            return best, budget.is_enough
    return by_rates.named or single, budget.is_enough


def _has_place(
    each: Alternative,
    given: Instants,
    names: tuple[str, ...],
    tree: KinematicTree,
    column_map: ColumnMap,
) -> bool:
    """Return whether a position that was left out has a unit or a point with which it fits.

    Else a force may explain the log, and joints that are read wrong would only look like it.
    """
    if "position" not in given.values or "position" in each.log.values:
        return True
    log = each.log.over(given)
    others = alternatives(log, names, tree, with_entries(column_map, each.entries), _PLACE)
    logs = [log, *(other.log for other in others)]
    return any(c.residual <= EXPLAINS for one in logs for c in compare_momentum(one, tree))
