"""Motions that disturb the base less and less: the front of precision against disturbance.

Idea: motions without reaction of the base (Nguyen-Huynh and Sharf 2013, "Adaptive reactionless
motion and parameter identification in postcapture of space debris").
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cpid_drake.planning.base_limits import BaseAttitude
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.search import Candidate, refined
from cpid_drake.processes import one_thread

POINTS = 18
"""Number of limits of the base's turn."""

SHORTER = 3
"""Number of times that iterations are fewer than for a plan: each motion starts near its best."""

LEAST = 0.02
"""Smallest limit, as a share of the turn of the best motion."""


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """One motion of the front.

    Attributes:
        candidate: the motion and its criterion.
        angle: largest turn of the base with any plausible target [rad].

    """

    candidate: Candidate
    angle: float


@one_thread
def front(
    problem: PlanProblem,
    best: Candidate,
    count: int = POINTS,
    least: float = LEAST,
    progress: Callable[[str, float], None] = lambda what, best: None,
) -> list[FrontPoint]:
    """Return motions none of which is better than another in both turn and criterion.

    Limits of the turn are lowered step by step, and each motion is improved from the one before.
    The way back follows: a motion of a small turn also keeps the larger limits, and is improved
    for them. The largest turn is the first. Limits for which no motion is found are left out.

    Args:
        problem: the problem, whose solution is `best`.
        best: the best motion without regard to the base.
        count: number of limits of the turn, in equal ratios.
        least: smallest limit, as a share of the turn of `best`.
        progress: see `Planner.run`.

    """
    measure = BaseAttitude(problem.objective, np.pi)
    largest = measure.reached(best.parameters)
    limits = largest * np.geomspace(1.0, least, count + 1)
    found = [FrontPoint(best, largest)]
    for limit in limits[1:]:
        progress(f"turn of the base below {np.degrees(limit):.3g} deg", found[-1].candidate.score)
        start = Candidate(found[-1].candidate.parameters, np.inf)
        found += _improved(problem, start, limit)
    result = found[-1:]
    for point in found[-2::-1]:
        before = min((each.candidate for each in (*result, point)), key=lambda one: one.score)
        progress(f"turn of the base below {np.degrees(point.angle):.3g} deg again", before.score)
        result += [*_improved(problem, before, point.angle), point]
    return undominated(result)


def undominated(points: list[FrontPoint]) -> list[FrontPoint]:
    """Return the points that no other one beats in both turn and criterion, largest turn first."""
    kept: list[FrontPoint] = []
    for point in sorted(points, key=lambda one: (one.angle, one.candidate.score)):
        if not kept or point.candidate.score < kept[-1].candidate.score:
            kept.append(point)
    return kept[::-1]


def _improved(problem: PlanProblem, start: Candidate, limit: float) -> list[FrontPoint]:
    """Return the best motion below a limit of the turn [rad] as a list, which is empty without."""
    constraint = BaseAttitude(problem.objective, limit)
    found = refined(
        problem.objective,
        problem.limited,
        [*problem.constraints, constraint],
        start,
        max(problem.options.iterations // SHORTER, 1),
    )
    kept = (each for each in found if np.isfinite(each.score) and problem.is_kept(each))
    chosen = next(kept, None)
    if chosen is None or chosen is start:
        return []
    return [FrontPoint(chosen, BaseAttitude(problem.objective, np.pi).reached(chosen.parameters))]
