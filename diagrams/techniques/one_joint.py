"""One joint at a time: Murotsu's two bodies, and the same motion without the planar assumption.

All joints but one are locked, so that the craft is two rigid bodies that turn about the joint's
axis n, which is fixed in C. The *planar* relations take the motion as one across n: with E (2, 3)
an orthonormal basis across n and v_p = EᵀE v, a sample gives three rows in (m, E m c, nᵀ J n),

    E v m + ω_n E ñ Eᵀ (E m c) = −E P,     −nᵀ ṽ_p Eᵀ (E m c) + ω_n nᵀ J n = −n·L,

the standard rows with ω → ω_n n and v → v_p. The base tilts, so they have an error of the model.
Source: Murotsu et al. 1994, as Ning et al. 2016 describe it; its text was not available.
"""

import numpy as np
from numpy.typing import NDArray

from cpid_drake import InertialParameters, InputError, JointMotion, Motion, Spacecraft, Spline
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.joint_motion import SPLINE_DEGREE
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import (
    STANDARD,
    parameter_scale,
    relative_parameterization,
    standard_to_relative,
)
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.rows import inertia_operator

Array = NDArray[np.float64]

SECONDS = 10.0 / 3
"""Duration of one joint's move [s]: three in the ten seconds of the paper's motion."""

PIECES = 12
"""Pieces of a move's spline; the rate is constant over the middle four."""

POSTURES = 300
"""Postures among which the best is chosen: more gain less than the choice of another target."""

GUESS = InertialParameters(50.0, np.array([0.3, 0.0, 0.0]), np.diag([5.0, 6.0, 7.0]))
"""A target for which the posture is chosen; the true one is not known then."""


def moves(spacecraft: Spacecraft, q: Array, joints: list[int]) -> Spline:
    """Return moves of one joint after another from q (J,), just below its rate limit.

    A joint moves to the side on which it has more room. With splines of degree 5 the acceleration
    has no steps, which would cost a fit of noisy samples many knots.
    """
    limits, steps = spacecraft.limits, PIECES - SPLINE_DEGREE + 1
    coefficients = np.tile(q, (PIECES * len(joints) + SPLINE_DEGREE, 1))
    for k, joint in enumerate(joints):
        at = coefficients[-1, joint]
        room = limits.highest[joint] - at, at - limits.lowest[joint]
        largest = 0.95 * limits.rates[joint] * steps * SECONDS / PIECES
        size = min(largest, max(room)) * (1 if room[0] >= room[1] else -1)
        first = PIECES * k + SPLINE_DEGREE
        coefficients[first : first + steps, joint] += size * np.arange(1, steps + 1) / steps
        coefficients[first + steps :, joint] += size
    return Spline(coefficients, SECONDS * len(joints))


def best_moves(spacecraft: Spacecraft, order: tuple[int, ...] = (2, 1, 0)) -> Spline:
    """Return moves of joints of the arm from the best of random postures.

    Best is the smallest worst σ of the relative rows for the target `GUESS`. Distances between
    bodies are not looked at.

    Args:
        spacecraft: the spacecraft model.
        order: the joints that move, by their number from the target on.

    Raises:
        InputError: the arm has fewer than three joints, or a joint has no limits.

    """
    chain, limits = arm_joints(spacecraft), spacecraft.limits
    if len(chain) < 3 or not np.isfinite(limits.rates[chain]).all():
        raise InputError("one joint at a time needs three joints with rate limits in the arm")
    low, high = (np.clip(each, -np.pi, np.pi) for each in (limits.lowest, limits.highest))
    rng, scale, count = np.random.default_rng(1), parameter_scale(GUESS.to_vector()), len(order)
    psi = standard_to_relative(GUESS.to_standard_vector(), spacecraft.mass)
    jacobian = relative_parameterization(spacecraft.mass).jacobian(psi)

    def worst(motion: Spline) -> float:
        samples = motion.evaluate((np.arange(5 * count) + 0.5) * SECONDS / 5)
        known = BodyDynamics.at(spacecraft.tree.lumped, samples[:, 0], samples[:, 1])
        A = known.regressor(known.base_twist(psi)[0]).reshape(-1, 10) / scale
        s, Vt = np.linalg.svd(A, full_matrices=False)[1:]
        root = Vt.T / np.maximum(s, 1e-12) / scale[:, None]
        return float((np.linalg.norm(jacobian @ root, axis=1) / scale).max())

    tried = []
    for _ in range(POSTURES):
        q = np.zeros(len(spacecraft.joint_names))
        q[chain] = rng.uniform(low[chain], high[chain])
        tried.append(moves(spacecraft, q, [chain[k] for k in order]))
    return min(tried, key=worst)


def arm_joints(spacecraft: Spacecraft) -> list[int]:
    """Return the joints of the arm that turn the target, the outermost first."""
    chain, k, bodies = list[int](), spacecraft.tree.capture_body, spacecraft.tree.bodies
    while k >= 0:
        if bodies[k].joint >= 0 and not bodies[k].prismatic:
            chain.append(bodies[k].joint)
        k = bodies[k].parent
    return chain


def planar_runs(
    spacecraft: Spacecraft, target: InertialParameters, motion: JointMotion
) -> list[Motion]:
    """Return the exact motion of each move; the pose of the base does not matter."""
    psi, runs = standard_to_relative(target.to_standard_vector(), spacecraft.mass), []
    for start in np.arange(round(motion.duration / SECONDS)) * SECONDS:
        times = start + SECONDS * (np.arange(20) + 0.5) / 20
        q, qdot, _ = np.moveaxis(motion.evaluate(times), 1, 0)
        w, v = BodyDynamics.at(spacecraft.tree.lumped, q, qdot).base_twist(psi)
        attitude, names = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1)), spacecraft.joint_names
        runs.append(Motion(names, times, attitude, np.zeros_like(w), w, v, q, qdot))
    return runs


def planar_solution(spacecraft: Spacecraft, runs: list[Motion]) -> tuple[Array, int]:
    """Return the parameters (10,) by the planar relations of exact runs of one joint each.

    Entries that the runs do not determine are NaN: three axes determine m and c, but not all of I;
    six do. The second result is the number of combinations of the parameters that they determine.

    Raises:
        InputError: not exactly one joint moves in a run, or it turns no target.

    """
    masses, across, firsts, along, moments = [], [], [], [], []
    for run in runs:
        v, w, P, L = np.swapaxes(momentum_samples(spacecraft.tree, run).in_C, 0, 1)
        n = _axis(spacecraft, run)
        E = np.linalg.svd(n[None])[2][1:]
        A = np.zeros((len(v), 3, 4))
        A[:, :2, 0], A[:, :2, 1:3] = v @ E.T, (w @ n)[:, None, None] * (E @ skew(n) @ E.T)
        A[:, 2, 1:3], A[:, 2, 3] = -np.cross(n, v @ E.T @ E) @ E.T, w @ n
        b = -np.column_stack([P @ E.T, L @ n])
        x = np.linalg.lstsq(A.reshape(-1, 4), b.ravel(), rcond=None)[0]
        masses.append(x[0])
        across.append(E)
        firsts.append(x[1:3])
        along.append(n @ inertia_operator(n))
        moments.append(x[3])
    h, _, known_of_h, _ = np.linalg.lstsq(np.vstack(across), np.concatenate(firsts), rcond=None)
    J, _, known_of_J, _ = np.linalg.lstsq(np.array(along), np.array(moments), rcond=1e-6)
    J = J if known_of_J == 6 else np.full(6, np.nan)
    parameters = STANDARD.to_parameters(np.concatenate([[np.mean(masses)], h, J]))
    return parameters, 1 + int(known_of_h) + int(known_of_J)


def _axis(spacecraft: Spacecraft, run: Motion) -> Array:
    """Return the axis (3,) in C of the joint that moves in a run; it is constant."""
    fastest = np.abs(run.qdot).max(axis=0)
    moving = np.flatnonzero(fastest > 1e-9 * fastest.max())
    if len(moving) != 1:
        listed = ", ".join(spacecraft.joint_names[k] for k in moving[:4]) or "none"
        raise InputError(
            f"the two-body method is for one joint that moves at a time; here move: {listed}"
        )
    rate = np.eye(len(spacecraft.joint_names))[moving]
    w = BodyDynamics.at(spacecraft.tree.lumped, run.q[:1], rate).w_BC[0]
    if not w.any():
        name = spacecraft.joint_names[moving[0]]
        raise InputError(f"the two-body method needs a joint of the arm; '{name}' turns no target")
    return np.asarray(w / np.linalg.norm(w))
