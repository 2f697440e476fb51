"""Search for the motion of a family that determines the target best.

Low-discrepancy candidates within the limits are scored in batches. A gradient method then improves
the best of them: sequential quadratic programming of SciPy (Kraft 1988), which minimizes t with all
components of the criterion below t.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import norm, qmc

from cpid_drake.planning.constraints import Constraint, MotionFunction
from cpid_drake.planning.limits import LimitedFamily
from cpid_drake.planning.objective import Objective
from cpid_drake.processes import shared_work

BATCH = 64
"""Number of candidates that are scored at once."""

TOLERANCE = 1e-6
"""Largest excess over a limit of a joint [rad, rad/s or rad/s²] that is rounding."""

WIDEST = 10.0
"""Bounds of each parameter, as multiples of its largest value if all others are zero."""

SHARE = 0.01
"""Largest violation of another constraint, which has a margin of its own, as a share of it."""

_SMALLEST_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion and its score.

    Attributes:
        parameters: (F, K).
        score: the criterion.

    """

    parameters: NDArray[np.float64]
    score: float


def candidates(limited: LimitedFamily, count: int, seed: int) -> NDArray[np.float64]:
    """Return parameters (count, F, K) of motions within the limits, from a Sobol sequence.

    The directions in parameter space are normally distributed. Every joint uses between a fifth and
    all of the room that its limits leave.
    """
    F, K = limited.family.count, len(limited.family.moving)
    # Powers of two keep the sequence balanced.
    points = qmc.Sobol(F * K + K, rng=np.random.default_rng(seed)).random_base2(
        max(int(np.ceil(np.log2(count))), 1)
    )[:count]
    directions = norm.ppf(np.clip(points[:, : F * K], 1e-9, 1 - 1e-9)).reshape(-1, F, K)
    share = _SMALLEST_SHARE + (1 - _SMALLEST_SHARE) * points[:, F * K :]
    largest = limited.usage(directions).max(axis=0)
    return np.asarray(directions * (share / largest)[:, None])


def ranked(
    objective: Objective,
    parameters: NDArray[np.float64],
    jobs: int,
    progress: Callable[[int, float], None] = lambda done, best: None,
) -> list[Candidate]:
    """Return candidates (B, F, K) with their scores, the best first.

    Args:
        objective: the criterion.
        parameters: the candidates.
        jobs: number of processes.
        progress: called with the number of scored candidates and the best score.

    """
    batches = [parameters[k : k + BATCH] for k in range(0, len(parameters), BATCH)]
    scores: list[float] = []
    for part in shared_work(_scores_of, objective, batches, min(jobs, len(batches))):
        scores += part.tolist()
        progress(len(scores), min(scores))
    order = np.argsort(scores, kind="stable")
    return [Candidate(parameters[k], scores[k]) for k in order]


def _scores_of(objective: Objective) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    return objective.scores


def refined(
    objective: Objective,
    limited: LimitedFamily,
    constraints: Sequence[Constraint],
    start: Candidate,
    iterations: int,
    found: Callable[[Candidate], None] = lambda candidate: None,
) -> list[Candidate]:
    """Improve a candidate by its gradient.

    Args:
        objective: the criterion.
        limited: the family and its linear limits.
        constraints: further constraints.
        start: a candidate; its score is infinite if it does not keep all constraints.
        iterations: largest number.
        found: called with every motion that keeps all constraints and is the best so far.

    Returns:
        The motions that keep all constraints, the best first; `start` is the last.

    """
    shape = start.parameters.shape
    A, b = limited.inequalities()
    kept = [start]

    goal, others = _Remembered(objective, shape), [_Remembered(c, shape) for c in constraints]

    def keep(z: NDArray[np.float64]) -> None:
        is_within = (A @ z[:-1] - b).max() < TOLERANCE
        is_within = is_within and all(other.values(z).min() > -SHARE for other in others)
        score = float(np.exp(goal.values(z).max()))
        if is_within and score < kept[0].score:
            kept.insert(0, Candidate(z[:-1].reshape(shape).copy(), score))
            found(kept[0])

    def column(matrix: NDArray[np.float64], value: float) -> NDArray[np.float64]:
        return np.hstack([matrix, np.full((len(matrix), 1), value)])

    linear = column(-A, 0.0)
    conditions = [
        {"type": "ineq", "fun": lambda z: b - A @ z[:-1], "jac": lambda z: linear},
        {
            "type": "ineq",
            "fun": lambda z: z[-1] - goal.values(z),
            "jac": lambda z: column(-goal.gradients(z), 1.0),
        },
    ]
    for other in others:
        conditions.append(
            {
                "type": "ineq",
                "fun": lambda z, other=other: other.values(z),
                "jac": lambda z, other=other: column(other.gradients(z), 0.0),
            }
        )
    z = np.append(start.parameters.ravel(), 0.0)
    z[-1] = goal.values(z).max()
    unit = np.append(np.zeros(z.size - 1), 1.0)
    minimize(
        lambda z: z[-1],
        z,
        jac=lambda z: unit,
        method="SLSQP",
        constraints=conditions,
        callback=keep,
        bounds=[*((-x, x) for x in WIDEST * limited.largest_alone.ravel()), (None, None)],
        options={"maxiter": iterations, "ftol": 1e-4},
    )
    return kept


class _Remembered:
    """Values and gradients at the last z: the solver asks several times, and rarely for gradients.

    Args:
        function: the objective or a constraint.
        shape: F and K.

    """

    def __init__(self, function: MotionFunction, shape: tuple[int, ...]) -> None:
        self._function, self._shape = function, shape
        self._known: dict[bytes, NDArray[np.float64]] = {}
        self._slopes: dict[bytes, NDArray[np.float64]] = {}

    def values(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values at z, whose last entry is not a parameter."""
        key = z[:-1].tobytes()
        if key not in self._known:
            self._known = {key: self._function.values(z[:-1].reshape(self._shape))}
        return self._known[key]

    def gradients(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the gradients at z."""
        key = z[:-1].tobytes()
        if key not in self._slopes:
            values, slopes = self._function.evaluate(z[:-1].reshape(self._shape))
            self._known, self._slopes = {key: values}, {key: slopes}
        return self._slopes[key]
