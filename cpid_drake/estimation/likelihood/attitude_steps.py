"""The attitude over a grid of equal steps, and its derivatives.

A step of length h turns the attitude R to R exp(θ). By the fourth-order Magnus formula, θ is the
integral of the angular velocity ω over the step plus h²/12 ω₀ × ω₁, with ω₀ and ω₁ at its ends.
"""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import cross, exponentials, skew
from cpid_drake.estimation.likelihood.uniform_spline import step_weights


def step_angles(integrals: Array, w: Array, h: float) -> Array:
    """Return the rotation vectors θ (N − 1, ..., 3) of all steps [rad].

    Args:
        integrals: (N − 1, ..., 3) of ω over the steps [rad].
        w: (N, ..., 3) ω at the nodes, in B [rad/s].
        h: length of a step [s].

    """
    return np.asarray(integrals + h**2 / 12 * cross(w[:-1], w[1:]))


def integrated_attitude(first: Array, theta: Array) -> Array:
    """Return the attitudes (N, 3, 3) from the first (3, 3) and rotation vectors θ (N − 1, 3)."""
    R, reach = np.concatenate([first[None], exponentials(theta)]), 1
    while reach < len(R):  # each is the product of so many steps up to it
        R[reach:] = R[:-reach] @ R[reach:]
        reach *= 2
    return R


def step_changes(R: Array, w: Array, theta: Array, change: Array, h: float, late: Array) -> Array:
    """Return the rotations (N − 1, 3, n) in W by which each step turns more.

    A change dθ turns a step by R Jl(θ) dθ more, with the left Jacobian Jl of the rotations, here to
    second order in θ. It is the derivative of `integrated_attitude` with ω from a `UniformSpline`.
    Source: Solà et al. 2018, "A micro Lie theory for state estimation in robotics", Eq. 145.

    Args:
        R: (N, 3, 3) attitudes R_WB at the nodes.
        w: (N, 3) ω at the nodes, in B [rad/s].
        theta: (N − 1, 3) rotation vectors of the steps [rad].
        change: (N, 3, n) change of ω at the nodes, in B.
        h: length of a step [s].
        late: (N − 1, 3, n) change of the integrals of ω over the steps at the same nodes.

    """
    N, turn, rate = len(w), skew(theta), skew(w)
    by_theta = R[:-1] @ (np.eye(3) + turn / 2 + turn @ turn / 6)
    changed = h * (step_weights(N) @ change.reshape(N, -1)).reshape(N - 1, *change.shape[1:])
    changed += h**2 / 12 * (rate[:-1] @ change[1:] - rate[1:] @ change[:-1])
    return np.asarray(by_theta @ (changed + late))


def carried(first: Array, last: Array, added: Array, start: Array, h: float) -> Array:
    """Return x (N, d, n) at the nodes of ẋ = A x + ẏ, by the trapezoidal rule.

    Args:
        first, last: (N − 1, d, d) A at the ends of the steps.
        added: (N − 1, d, n) changes of y.
        start: (d, n) x at the first node.
        h: length of a step [s].

    """
    one = np.eye(len(start))
    left = np.linalg.inv(one - h / 2 * last)
    forward, added = left @ (one + h / 2 * first), left @ added
    x = np.empty((len(added) + 1, *start.shape))
    x[0] = start
    for k in range(len(forward)):
        np.matmul(forward[k], x[k], out=x[k + 1])
        x[k + 1] += added[k]
    return x
