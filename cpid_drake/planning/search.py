"""Search for the motion of a family that determines the target best.

Low-discrepancy candidates within the limits are scored. A gradient method then improves the best of
them: sequential quadratic programming of SciPy (Kraft 1988), which minimizes t with all components
of the criterion below t.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm, qmc

from cpid_drake.array import Array
from cpid_drake.planning.motion_family import MotionFamily
from cpid_drake.planning.objective import Objective
from cpid_drake.spacecraft.clearance import Clearance

Excess = Callable[[Array], tuple[Array, Array]]
"""Values of a motion (F, K) that must not be positive, and their derivatives."""

DISTANCE_MARGIN = 0.01
"""Distance that is imposed beyond the smallest one, for the motion between the poses [m]."""


def candidates(family: MotionFamily, count: int, seed: int) -> Array:
    """Return parameters (count, F, K) of motions within the limits, from a Sobol sequence.

    The directions in parameter space are normally distributed. Every joint uses between a fifth and
    all of the room that its limits leave.
    """
    F, K = family.shape
    # Powers of two keep the sequence balanced.
    points = qmc.Sobol(F * K + K, rng=np.random.default_rng(seed)).random_base2(
        max(int(np.ceil(np.log2(count))), 1)
    )[:count]
    directions = norm.ppf(np.clip(points[:, : F * K], 1e-9, 1 - 1e-9)).reshape(-1, F, K)
    share = 0.2 + 0.8 * points[:, F * K :]
    return np.asarray(directions * (share / family.usage(directions))[:, None])


def distance_excess(
    parameters: Array, clearance: Clearance, family: MotionFamily, least: float
) -> tuple[Array, Array]:
    """Return how much a motion (F, K) exceeds limits of distance, and the derivatives.

    The values (Q,) are at most zero where bodies that are not neighbours keep the smallest distance
    [m] with a margin; their derivatives are (Q, F K).
    """
    times = family.times[2:-1:2]  # arms move centimetres between them
    positions = family.make(parameters).evaluate(times)[:, 0]
    values, by_position = clearance.penalties(positions, least + DISTANCE_MARGIN)
    phi = family.functions(times)[:, 0]
    slopes = phi[:, :, None] * by_position[:, None, family.moving]
    return values - 1, slopes.reshape(len(values), -1)


def improved(
    objective: Objective,
    distances: Excess | None,
    start: Array,
    iterations: int,
    record: Callable[[Array, float], None] = lambda parameters, score: None,
) -> Array:
    """Return the parameters (F, K) of a motion that the gradient method makes of another one.

    It may exceed limits a little.

    Args:
        objective: the criterion, with limits of efforts and of the base's motion.
        distances: see `distance_excess`; None for any.
        start: (F, K) the motion to improve.
        iterations: their largest number.
        record: called with the parameters and the criterion after each iteration.

    """
    A, b = objective.family.inequalities()
    sigmas = len(objective.targets) * len(objective.model.tree.unknowns)
    scores: dict[bytes, Array] = {}

    def parameters(z: Array) -> Array:
        return z[:-1].reshape(start.shape).copy()

    def excess(z: Array) -> Array:
        """Return what must not be positive, without its dependence on t = z[-1]."""
        x = parameters(z)
        key = x.tobytes()
        if key not in scores:
            scores.clear()
            far = np.empty(0) if distances is None else distances(x)[0]
            scores[key] = np.concatenate([objective.values(x[None])[0], far])
        return scores[key]

    def slopes(z: Array) -> Array:
        x = parameters(z)
        far = np.empty((0, x.size)) if distances is None else distances(x)[1]
        rows = np.concatenate([objective.evaluate(x)[1], far])
        by_t = np.repeat([1.0, 0.0], [sigmas, len(rows) - sigmas])
        return np.column_stack([-rows, by_t])

    def room(z: Array) -> Array:
        values = -excess(z)
        values[:sigmas] += z[-1]
        return values

    linear = np.column_stack([-A, np.zeros(len(A))])
    unit = np.append(np.zeros(start.size), 1.0)
    z = np.append(start.ravel(), 0.0)
    z[-1] = excess(z)[:sigmas].max()
    result = minimize(
        lambda z: z[-1],
        z,
        jac=lambda z: unit,
        method="SLSQP",
        constraints=[
            {"type": "ineq", "fun": lambda z: b - A @ z[:-1], "jac": lambda z: linear},
            {"type": "ineq", "fun": room, "jac": slopes},
        ],
        callback=lambda z: record(parameters(z), float(np.exp(excess(z)[:sigmas].max()))),
        options={"maxiter": iterations, "ftol": 1e-4},
    )
    return parameters(result.x)
