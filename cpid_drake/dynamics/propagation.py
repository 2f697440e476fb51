"""The base's motion that follows from joint motion, momentum and external forces.

The system's angular momentum about its centre of mass, the motion of this centre and the joints
determine the base's motion (see `body_dynamics`), so only the attitude, and the momentum under
forces, are integrated: for many targets at once, without a simulation of the dynamics.

Source: Ning et al. 2016, Eqs. 5 and 9, solved for the motion of the base.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy.special import roots_jacobi

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import (
    conjugate,
    cross,
    quaternion_rate,
    rotate,
    rotate_by_quaternion,
)
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError

_DEGREE = 7  # of a step's polynomials: with steps of 0.2 s, they follow motions of 1 Hz to 1e-11
_MOST_TURN = 1e6  # [rad] in all samples; beyond, the attitude is lost in rounding


def _lobatto(degree: int) -> tuple[Array, Array, Array]:
    """Return points as shares of a step, and by their values: coefficients, integrals to each."""
    inner = roots_jacobi(degree - 1, 1, 1)[0]  # of the Legendre polynomial's derivative
    x = np.concatenate([[-1.0], inner, [1.0]])
    by_values = np.linalg.inv(legendre.legvander(x, degree))
    primitives = legendre.legint(np.eye(degree + 1), lbnd=-1)
    return (x + 1) / 2, by_values, legendre.legval(x, primitives).T @ by_values / 2


_POINTS, _BY_VALUES, _INTEGRALS = _lobatto(_DEGREE)


@dataclass(frozen=True)
class BaseTrajectory:
    """Motion of the base at N instants, for one target or, with leading axes (...), for many.

    Attributes:
        quaternion_WB: (..., N, 4) attitude as unit quaternions (w, x, y, z).
        p_WB: (..., N, 3) position of B's origin in W [m].
        w_WB: (..., N, 3) angular velocity in W [rad/s].
        v_WB: (..., N, 3) velocity of B's origin in W [m/s].
        momentum_W: (..., N, 6) total momentum [L; P] about W's origin, in W [N·m·s, N·s].

    """

    quaternion_WB: Array
    p_WB: Array
    w_WB: Array
    v_WB: Array
    momentum_W: Array

    def to_motion(
        self, joint_names: tuple[str, ...], times: ArrayLike, motion: JointMotion
    ) -> Motion:
        """Return the trajectory of one target with its joint motion, at the N times [s]."""
        one = (value[None] for value in vars(self).values())
        return BaseTrajectory(*one).to_motions(joint_names, times, motion)[0]

    def to_motions(
        self, joint_names: tuple[str, ...], times: ArrayLike, motion: JointMotion
    ) -> list[Motion]:
        """Return the same of each of many targets."""
        times = np.asarray(times, dtype=float)
        q, qdot, _ = np.moveaxis(motion.evaluate(times), -2, 0)
        bases = zip(self.quaternion_WB, self.p_WB, self.w_WB, self.v_WB, strict=True)
        return [Motion(joint_names, times, *base, q, qdot) for base in bases]


@dataclass(frozen=True, eq=False)
class Wrench:
    """Forces and torques on spacecraft and target from outside.

    Attributes:
        disturbance_W: (..., 6) torque about the system's centre of mass Scm, and acceleration of
            this centre, in W [N·m, m/s²]; of each target, or of all.
        constant_B: (6,) torque about B's origin and force of thrusters, in B [N·m, N].
        orbit: the orbit of W's origin; None for no gravity gradient.

    """

    disturbance_W: ArrayLike = (0.0,) * 6
    constant_B: ArrayLike = (0.0,) * 6
    orbit: Orbit | None = None

    def about_com(
        self,
        times: Array,
        quaternion_WB: Array,
        p_WScm: Array,
        p_BScm_B: Array,
        mass: Array,
        J_B: Array,
    ) -> tuple[Array, Array]:
        """Return torque about Scm and force (..., n, 3), in W, for J (..., n, 3, 3) about Scm."""
        (torque, acceleration), (torque_B, force_B) = (
            np.split(np.asarray(values, dtype=float)[..., None, :], 2, axis=-1)
            for values in (self.disturbance_W, self.constant_B)
        )
        torque_B = torque_B - cross(p_BScm_B, force_B)
        if self.orbit is not None:
            nadir_W = self.orbit.nadir(times)
            nadir_B = rotate_by_quaternion(conjugate(quaternion_WB), nadir_W)
            torque_B = torque_B + 3 * self.orbit.n**2 * cross(nadir_B, rotate(J_B, nadir_B))
            acceleration = acceleration + rotate(self.orbit.tide(times), p_WScm)
        return (
            torque + rotate_by_quaternion(quaternion_WB, torque_B),
            mass[..., None, None] * acceleration + rotate_by_quaternion(quaternion_WB, force_B),
        )


def propagate(
    tree: KinematicTree,
    motion: JointMotion,
    phi: ArrayLike,
    times: ArrayLike,
    *,
    quaternion_WB: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    p_WB: ArrayLike = (0.0, 0.0, 0.0),
    momentum_W: ArrayLike = (0.0,) * 6,
    wrench: Callable[[float], Wrench] | None = None,
    edges: ArrayLike = (),
    max_step: float = 0.2,
) -> BaseTrajectory:
    """Propagate the base's pose through a joint motion, for one target or for many at once.

    Collocation at Lobatto points: in each step, the state is a polynomial through them, which a
    fixed number of Picard's iterations solves, and all samples are on it. The kinematics are
    computed once for all targets.

    Args:
        tree: the spacecraft model.
        motion: the motion of its joints.
        phi: (..., 10) standard vectors.
        times: (N,) increasing instants of the result [s]; the motion starts at the first.
        quaternion_WB: (..., 4) attitude at the start (w, x, y, z).
        p_WB: (..., 3) position at the start [m].
        momentum_W: (..., 6) total momentum [L; P] about W's origin at the start, in W
            [N·m·s, N·s].
        wrench: the external forces from a time on [s]; default: none, so that the momentum is
            constant.
        edges: the times at which they change [s].
        max_step: longest step [s], and largest rotation in a step at the rate of the start [rad];
            no step contains an edge, or a break of the motion.

    Raises:
        InputError: times that do not increase, a step that is not positive, a rotation of more than
            a million radians, or a target that no rigid body is; see `BodyDynamics.mobility`.

    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not times.size or (np.diff(times) <= 0).any() or not max_step > 0:
        raise InputError("times must be increasing instants, at least one; max_step must be > 0 s")
    psi = standard_to_relative(np.asarray(phi, dtype=float), tree.mass)
    dynamics = BodyDynamics.at(tree, *np.moveaxis(motion.evaluate(times)[:, :2], 1, 0))
    mass, com = dynamics.total_mass(psi), dynamics.com(psi)
    q_WB, p_WB, momentum_W = (
        np.asarray(values, dtype=float) for values in (quaternion_WB, p_WB, momentum_W)
    )
    p_WScm = p_WB + rotate_by_quaternion(q_WB, com[..., 0, :])
    L = momentum_W[..., :3] - cross(p_WScm, momentum_W[..., 3:])
    first = dynamics.part(np.array([0]))
    L_B = rotate_by_quaternion(conjugate(q_WB), L)[..., None, :]
    w_B = rotate(first.mobility(psi), L_B - first.momentum_at_rest(psi))  # at the start
    spin = float(np.abs(w_B).sum(axis=-1).max())
    if not spin * (times[-1] - times[0]) < _MOST_TURN:
        raise InputError(f"the base rotates at {spin:.3g} rad/s at the start: too fast to follow")
    longest = max_step / max(1.0, spin)
    breaks = np.union1d(motion.breaks(), edges)
    breaks = breaks[(breaks > times[0]) & (breaks < times[-1])]
    ends = np.concatenate([times[:1], breaks, times[-1:]])  # of the steps
    counts = np.maximum(np.ceil(np.diff(ends) / longest - 1e-9).astype(int), 1)
    parts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(ends, ends[1:], counts)]
    starts = np.concatenate(parts)
    lengths = np.diff(starts, append=times[-1])
    grid = starts[:, None] + lengths[:, None] * _POINTS
    points = BodyDynamics.at(tree, *np.moveaxis(motion.evaluate(grid.ravel())[:, :2], 1, 0))
    mobility, at_rest = points.mobility(psi), points.momentum_at_rest(psi)
    if wrench is not None:
        J, com_at_points = points.inertia(psi), points.com(psi)

    def rate(k: int, acting: Wrench | None, state: Array) -> Array:
        q_WB, p_WScm, L, P = _parts(state)
        own = slice(k * len(_POINTS), (k + 1) * len(_POINTS))
        L_B = rotate_by_quaternion(conjugate(q_WB), L)
        w_B = rotate(mobility[..., own, :, :], L_B - at_rest[..., own, :])
        turning = quaternion_rate(q_WB, w_B)
        if acting is None:
            return turning
        torque_force = acting.about_com(
            grid[k], q_WB, p_WScm, com_at_points[..., own, :], mass, J[..., own, :, :]
        )
        return np.concatenate([turning, P / mass[..., None, None], *torque_force], axis=-1)

    start = [q_WB, p_WScm, L, momentum_W[..., 3:]]
    shape = np.broadcast_shapes(*(part.shape[:-1] for part in start), mass.shape)
    state = np.concatenate(
        [np.broadcast_to(part, (*shape, part.shape[-1])) for part in start], axis=-1
    )
    step_of = np.searchsorted(starts, times, side="right") - 1
    states = []
    for k, (begin, length) in enumerate(zip(starts, lengths)):
        acting = None if wrench is None else wrench(float(begin))
        curve = np.repeat(state[..., None, :], len(_POINTS), axis=-2)
        travel = state[..., 10:] / mass[..., None] * length
        curve[..., 4:7] += _POINTS[:, None] * travel[..., None, :]  # exact without forces
        for _ in range(_DEGREE):  # each adds a power of the rotation in a step, as a degree does
            rates = length * rate(k, acting, curve)
            change = np.einsum("ij,...jk->...ik", _INTEGRALS, rates)
            curve[..., : rates.shape[-1]] = state[..., None, : rates.shape[-1]] + change
        inside = (times[step_of == k] - begin) / (length or 1.0)
        weights = legendre.legvander(2 * inside - 1, _DEGREE) @ _BY_VALUES
        states.append(np.einsum("sj,...jk->...sk", weights, curve))
        state = curve[..., -1, :]
        state[..., :4] /= np.linalg.norm(state[..., :4], axis=-1, keepdims=True)

    q_WB, p_WScm, L, P = _parts(np.concatenate(states, axis=-2))
    q_WB = q_WB / np.linalg.norm(q_WB, axis=-1, keepdims=True)
    of_Scm = (rotate_by_quaternion(conjugate(q_WB), v) for v in (L, P / mass[..., None, None]))
    w_B, v_B = dynamics.base_twist(psi, *of_Scm)
    base = p_WScm - rotate_by_quaternion(q_WB, com)
    if tree.normal_B is not None:  # the table holds the height
        normal = rotate_by_quaternion(start[0], tree.normal_B)[..., None, :]
        base = base + np.sum((p_WB[..., None, :] - base) * normal, axis=-1, keepdims=True) * normal
    w, v = rotate_by_quaternion(q_WB, w_B), rotate_by_quaternion(q_WB, v_B)
    momentum = np.concatenate([L + cross(p_WScm, P), P], axis=-1)
    return BaseTrajectory(q_WB, base, w, v, momentum)


def _parts(state: Array) -> list[Array]:
    """Return attitude, centre of mass, L about it, and P of states (..., 13)."""
    return np.split(state, [4, 7, 10], axis=-1)
