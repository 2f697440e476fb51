"""One joint at a time: Murotsu's two bodies, and the same motion without the planar assumption.

All joints but one are locked, so that the craft is two rigid bodies that turn about the joint's
axis n, which is fixed in C. The *planar* relations take the motion as one across n: with E (2, 3)
an orthonormal basis across n and v_p = EᵀE v, a sample gives three rows in (m, E m c, nᵀ J n),

    E v m + ω_n E ñ Eᵀ (E m c) = −E P,     −nᵀ ṽ_p Eᵀ (E m c) + ω_n nᵀ J n = −n·L,

the standard rows with ω → ω_n n and v → v_p. The base tilts, so they have an error of the model.
Source: Murotsu et al. 1994, as Ning et al. 2016 describe it; its text was not available.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import HalfCosine
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import (
    STANDARD,
    parameter_scale,
    relative_parameterization,
    standard_to_relative,
)
from cpid_drake.dynamics.rotations import cross, skew
from cpid_drake.dynamics.rows import inertia_operator
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft

Array = NDArray[np.float64]

SECONDS = 10.0 / 3
"""Duration of one joint's move [s]: three in the ten seconds of the paper's motion."""

RATE_MARGIN = 0.95
"""Share of the joints' rate limits that the moves use."""

POSTURES = 300
"""Postures among which the best is chosen: more gain less than the choice of another target."""

GUESS = InertialParameters(50.0, np.array([0.3, 0.0, 0.0]), np.diag([5.0, 6.0, 7.0]))
"""A target for which the posture is chosen; the true one is not known then."""


@dataclass(frozen=True, eq=False)
class OneAfterAnother:
    """Joint motions, one after the other; each starts where the one before ends."""

    parts: Sequence[HalfCosine]

    @property
    def duration(self) -> float:
        """Duration of all [s]."""
        return sum(part.duration for part in self.parts)

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)
        ends = np.cumsum([part.duration for part in self.parts])
        which = np.minimum(np.searchsorted(ends, time, side="right"), len(ends) - 1)
        starts = np.append(0.0, ends[:-1])[which]
        values = np.stack([part.evaluate(time - starts) for part in self.parts])
        return np.take_along_axis(values, which[None, ..., None, None], axis=0)[0]

    def instants(self) -> Array:
        """Return times (N,) that resolve the motion [s]."""
        starts = np.cumsum([0.0, *(part.duration for part in self.parts[:-1])])
        times = (start + part.instants() for start, part in zip(starts, self.parts))
        return np.unique(np.concatenate(list(times)))


def moves(spacecraft: Spacecraft, q: Array, joints: Sequence[int]) -> OneAfterAnother:
    """Return moves of one joint after another from q (J,), as fast as its limits allow.

    A joint moves to the side on which it has more room.
    """
    parts = []
    limits = spacecraft.limits
    for joint in joints:
        size = 2 * SECONDS / np.pi * RATE_MARGIN * limits.rates[joint]
        room = min(limits.highest[joint] - q[joint], 1e9), min(q[joint] - limits.lowest[joint], 1e9)
        step = min(size, room[0]) if room[0] >= room[1] else -min(size, room[1])
        end = q.copy()
        end[joint] += step
        parts.append(HalfCosine(q, end, SECONDS))
        q = end
    return OneAfterAnother(parts)


def best_moves(spacecraft: Spacecraft, count: int = 3) -> OneAfterAnother:
    """Return moves of the `count` outermost joints of the arm, from the best random posture.

    Best is the smallest worst σ of the relative rows for the target `GUESS`. Distances between
    bodies are not looked at.

    Raises:
        InputError: the arm has fewer joints, or a joint has no limits.

    """
    chain, limits = arm_joints(spacecraft), spacecraft.limits
    outermost = chain[:3][::-1]
    if len(outermost) < 3 or not np.isfinite(limits.rates[chain]).all():
        raise InputError("one joint at a time needs three joints with rate limits in the arm")
    low, high = (np.clip(each, -np.pi, np.pi) for each in (limits.lowest, limits.highest))
    rng, scale = np.random.default_rng(1), parameter_scale(GUESS.to_vector())
    psi = standard_to_relative(GUESS.to_standard_vector(), spacecraft.mass)
    form, best, found = relative_parameterization(spacecraft.mass), np.inf, None
    for _ in range(POSTURES):
        q = np.zeros(len(spacecraft.joint_names))
        q[chain] = rng.uniform(low[chain], high[chain])
        motion = moves(spacecraft, q, [outermost[k % 3] for k in range(count)])
        times = (np.arange(5 * count) + 0.5) / (5 * count) * motion.duration
        samples = motion.evaluate(times)
        known = BodyDynamics.at(spacecraft.tree.lumped, samples[:, 0], samples[:, 1])
        A = known.regressor(known.base_twist(psi)[0]).reshape(-1, 10) / scale
        s, Vt = np.linalg.svd(A, full_matrices=False)[1:]
        root = Vt.T / np.maximum(s, 1e-12) / scale[:, None]
        sigma = np.linalg.norm(form.jacobian(psi) @ root, axis=1)
        if (worst := (sigma / scale).max()) < best:
            best, found = worst, motion
    assert found is not None
    return found


def arm_joints(spacecraft: Spacecraft) -> list[int]:
    """Return the joints of the arm that turn the target, the outermost first."""
    chain, k, bodies = list[int](), spacecraft.tree.capture_body, spacecraft.tree.bodies
    while k >= 0:
        if bodies[k].joint >= 0 and not bodies[k].prismatic:
            chain.append(bodies[k].joint)
        k = bodies[k].parent
    return chain


def six_axes(spacecraft: Spacecraft) -> OneAfterAnother:
    """Return six moves about six axes: of two joints from each of three postures.

    Among random postures, those whose axes determine the moments of inertia best. The turns between
    them are left out.
    """
    chain, limits = arm_joints(spacecraft), spacecraft.limits
    rng, best, found = np.random.default_rng(2), 0.0, None
    joints, units = chain[1:3], np.eye(len(spacecraft.joint_names))[chain[1:3]]
    low, high = (np.clip(each, -np.pi, np.pi) for each in (limits.lowest, limits.highest))
    for _ in range(POSTURES):
        q = np.zeros((3, len(units[0])))
        q[:, chain] = rng.uniform(low[chain], high[chain], (3, len(chain)))
        axes = BodyDynamics.at(spacecraft.tree.lumped, np.repeat(q, 2, 0), np.tile(units, (3, 1)))
        n = axes.w_BC / np.linalg.norm(axes.w_BC, axis=1, keepdims=True)
        of_J = np.einsum("ni,nij->nj", n, inertia_operator(n))
        least = np.linalg.svd(of_J, compute_uv=False)[-1]
        if least > best:
            best, found = least, q
    assert found is not None
    return OneAfterAnother([moves(spacecraft, q, [j]).parts[0] for q in found for j in joints])


def moving_joint(qdot: Array, names: Sequence[str]) -> int:
    """Return the joint that moves in rates (N, J).

    Raises:
        InputError: none or several move, which the two bodies of this method exclude.

    """
    moving = np.flatnonzero(np.abs(qdot).max(axis=0) > 1e-9 * np.abs(qdot).max(initial=1e-300))
    if len(moving) != 1 or not qdot.any():
        listed = ", ".join(names[k] for k in moving[:4]) if qdot.any() else "none"
        raise InputError(
            f"the two-body method is for one joint that moves at a time; here move: {listed}"
        )
    return int(moving[0])


def planar_solution(spacecraft: Spacecraft, runs: Sequence[Motion]) -> tuple[Array, int]:
    """Return the parameters (10,) by the planar relations of runs of one joint each.

    The second result is the number of combinations of the parameters that the runs determine.

    Entries that the runs do not determine are NaN: three axes determine m and c, but not all of I;
    six do.

    Args:
        spacecraft: the known spacecraft.
        runs: exact motion, of which one joint moves in each.

    Raises:
        InputError: several joints move in a run.

    """
    rows, moments = [], []
    for run in runs:
        joint = moving_joint(run.qdot, spacecraft.joint_names)
        samples = momentum_samples(spacecraft.tree, run)
        v, w, P, L = np.swapaxes(samples.in_C, 0, 1)
        n = _axis(spacecraft, run, joint)
        E = np.linalg.svd(n[None])[2][1:]
        A = np.zeros((len(v), 3, 4))
        A[:, :2, 0], A[:, :2, 1:3] = v @ E.T, (w @ n)[:, None, None] * (E @ skew(n) @ E.T)
        A[:, 2, 1:3], A[:, 2, 3] = -cross(n, v @ E.T @ E) @ E.T, w @ n
        b = -np.column_stack([P @ E.T, L @ n])
        x = np.linalg.lstsq(A.reshape(-1, 4), b.ravel(), rcond=None)[0]
        rows.append((E, x))
        moments.append((n, x[3]))
    mass = np.mean([x[0] for _, x in rows])
    h, _, known_of_h, _ = np.linalg.lstsq(
        np.vstack([E for E, _ in rows]), np.concatenate([x[1:3] for _, x in rows]), rcond=None
    )
    of_J = np.array([n @ inertia_operator(n) for n, _ in moments])
    J, _, known_of_J, _ = np.linalg.lstsq(
        of_J, np.array([moment for _, moment in moments]), rcond=1e-6
    )
    if known_of_J < 6:
        J = np.full(6, np.nan)
    parameters = STANDARD.to_parameters(np.concatenate([[mass], h, J]))
    return parameters, 1 + int(known_of_h) + int(known_of_J)


def planar_runs(
    spacecraft: Spacecraft, target: InertialParameters, motion: OneAfterAnother
) -> list[Motion]:
    """Return the exact motion of each move, at rest in the end; the pose does not matter."""
    psi = standard_to_relative(target.to_standard_vector(), spacecraft.mass)
    runs = []
    for part in motion.parts:
        times = part.duration * (np.arange(20) + 0.5) / 20
        q, qdot, _ = np.moveaxis(part.evaluate(times), 1, 0)
        known = BodyDynamics.at(spacecraft.tree.lumped, q, qdot)
        w, v = known.base_twist(psi)
        attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
        names = spacecraft.joint_names
        runs.append(Motion(names, times, attitude, np.zeros_like(w), w, v, q, qdot))
    return runs


def _axis(spacecraft: Spacecraft, run: Motion, joint: int) -> Array:
    """Return a joint's axis (3,) in C, at the start of a run; it is constant."""
    rate = np.eye(len(spacecraft.joint_names))[joint][None]
    known = BodyDynamics.at(spacecraft.tree.lumped, run.q[:1], rate)
    if not known.w_BC.any():
        name = spacecraft.joint_names[joint]
        raise InputError(f"the two-body method needs a joint of the arm; '{name}' turns no target")
    return known.w_BC[0] / np.linalg.norm(known.w_BC[0])
