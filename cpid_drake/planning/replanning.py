"""Plans the next motion from what the motions before it have shown about the target."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.identification.prior import TargetPrior
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.scenario.joint_motions import HalfCosineMotion

TARGETS = 1
"""Number of plausible targets: the estimate itself."""

CANDIDATES = 128
"""Number of motions of the search."""

ITERATIONS = 6
"""Largest number of iterations of the gradient method."""


def next_problem(
    problem: PlanProblem, prior: TargetPrior | None, end: NDArray[np.float64] | None = None
) -> PlanProblem:
    """Return the problem of the motion that follows that of another one, solved within seconds.

    It has the same limits and the same duration, and a shorter search. The prior's information
    counts as if it came from a sensor, so that the motion shows what is least known.

    Args:
        problem: the problem of the motion before.
        prior: what is known about the target now; None for nothing.
        end: (J,) positions at the end [rad or m]; default: those at the start of the motion before.

    Raises:
        InputError: see `PlanProblem`.

    """
    last, names = problem.family, problem.spacecraft.joint_names
    end = last.start if end is None else end
    motion = HalfCosineMotion(
        last.duration,
        dict(zip(names, last.end.tolist(), strict=True)),
        dict(zip(names, end.tolist(), strict=True)),
    )
    options = replace(
        problem.options, targets=TARGETS, candidates=CANDIDATES, starts=1, iterations=ITERATIONS
    )
    scenario = replace(problem.scenario, joint_motion=motion)
    return PlanProblem(scenario, problem.suite, options, prior, clearance=problem.clearance)
