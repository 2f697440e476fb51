"""Base motion that follows from joint motion while momentum is conserved.

The motion relative to the base is given by the joints; only the base's own twist is unknown. With
twists V = [ω; v] and momenta Π = [L; P] about B's origin, all in B, conservation of momentum reads

    (M + XᵀG(φ)X) V_WB + h + XᵀG(φ)V_BC = Π.

M and h are the known bodies' inertia and their momentum with the base at rest, X maps the base's
twist to the twist of the capture frame C, V_BC is the twist of C relative to B in C, and G(φ) is
the target's spatial inertia in C, linear in its standard vector φ. V_WB and its derivative w.r.t. φ
therefore have closed forms. Integrating V_WB gives the base's pose for many targets at once,
without a simulation of the dynamics. A base on a table has twists S u only (`plane.freedom`), and
the three equations Sᵀ (…) determine u; the others contain the reactions of the table.

Source: Ning et al. 2016, Eqs. 5 and 9, solved for the motion of the base.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.momentum import angular_momentum, linear_momentum
from cpid_drake.dynamics.parameterizations import vector_to_tensor
from cpid_drake.dynamics.plane import freedom
from cpid_drake.dynamics.rotations import cross, quaternion_rate, rotate, rotate_by_quaternion, skew
from cpid_drake.dynamics.spatial_inertia import moved_moments, spatial_inertia
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError


@dataclass(frozen=True)
class KnownDynamics:
    """Inertia and momentum of the known bodies at N instants of a joint motion.

    Attributes:
        M: (N, 6, 6) spatial inertia of the known bodies about B's origin, in B.
        h: (N, 6) momentum [L; P] of the known bodies about B's origin, in B, with the base at rest.
        X: (N, 6, 6) maps the base's twist, in B, to the twist of C, in C, with the joints at rest.
        V_BC: (N, 6) twist of C relative to B, in C.
        normal_B: (3,) normal in B of a table that carries the base; None without one.

    """

    M: NDArray[np.float64]
    h: NDArray[np.float64]
    X: NDArray[np.float64]
    V_BC: NDArray[np.float64]
    normal_B: NDArray[np.float64] | None = None

    def mobility(self, M: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ∂V/∂Π (..., N, 6, 6) of the base's twist for an inertia M: M⁻¹ if it is free."""
        if self.normal_B is None:
            return np.asarray(np.linalg.inv(M), dtype=float)
        S = freedom(self.normal_B)
        return np.asarray(S @ np.linalg.inv(S.T @ M @ S) @ S.T)


@dataclass(frozen=True)
class BaseTrajectory:
    """Motion of the base at N instants, for one target or, with leading axes (...), for many.

    Attributes:
        quaternion_WB: (..., N, 4) attitude as unit quaternions (w, x, y, z).
        p_WB: (..., N, 3) position of B's origin in W [m].
        w_WB: (..., N, 3) angular velocity in W [rad/s].
        v_WB: (..., N, 3) velocity of B's origin in W [m/s].

    """

    quaternion_WB: NDArray[np.float64]
    p_WB: NDArray[np.float64]
    w_WB: NDArray[np.float64]
    v_WB: NDArray[np.float64]

    def __getitem__(self, k: int) -> "BaseTrajectory":
        """Return the motion with target k, if there is one leading axis."""
        parts = (self.quaternion_WB, self.p_WB, self.w_WB, self.v_WB)
        return BaseTrajectory(*(part[k] for part in parts))

    def to_telemetry(
        self, joint_names: tuple[str, ...], times: ArrayLike, motion: JointMotion
    ) -> Telemetry:
        """Return one target's trajectory as telemetry, with its joint motion at the N times [s]."""
        times = np.asarray(times, dtype=float)
        q, qdot, _ = np.moveaxis(motion.evaluate(times), 1, 0)
        return Telemetry(joint_names, times, **vars(self), q=q, qdot=qdot)


def known_dynamics(tree: KinematicTree, q: ArrayLike, qdot: ArrayLike) -> KnownDynamics:
    """Return the known bodies' inertia and momentum at joint positions and rates, (N, J) each."""
    bodies, capture = propagate(tree, Telemetry.seen_from_base(q, qdot))
    moment, inertia = moved_moments(tree.masses, tree.inertias, bodies.R, bodies.r)
    M = spatial_inertia(tree.mass, moment.sum(axis=0), inertia.sum(axis=0))
    L = angular_momentum(tree, bodies, np.zeros(3))
    P = linear_momentum(tree, bodies)
    R_CB = np.swapaxes(capture.R_WC, -1, -2)
    X = np.zeros_like(M)
    X[:, :3, :3] = X[:, 3:, 3:] = R_CB
    X[:, 3:, :3] = -R_CB @ skew(capture.p_WC)
    V_BC = np.hstack([rotate(R_CB, capture.w_WC), rotate(R_CB, capture.v_WC)])
    return KnownDynamics(M, np.hstack([L, P]), X, V_BC, tree.normal_B)


def target_spatial_inertia(phi: ArrayLike) -> NDArray[np.float64]:
    """Return G(φ) (..., 6, 6) of vectors φ (..., 10): [L; P] = G [ω; v] about C's origin, in C."""
    phi = np.asarray(phi, dtype=float)
    return spatial_inertia(phi[..., 0], phi[..., 1:4], vector_to_tensor(phi[..., 4:]))


# ∂G/∂φ: constant, since G is linear in φ.
_G_BY_PHI = target_spatial_inertia(np.eye(10))


def base_twist(
    known: KnownDynamics, phi: ArrayLike, momentum_B: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return the base's twist [ω; v] (..., N, 6), in B, that conserves momentum.

    Args:
        known: N instants of the joint motion.
        phi: (..., 10) standard vectors of one or many targets; zeros for no target.
        momentum_B: (..., N, 6) total momentum [L; P] about B's origin, in B; default: zero.

    """
    M, h = _total(known, phi)
    rest = -h if momentum_B is None else np.asarray(momentum_B) - h
    if known.normal_B is not None:
        return rotate(known.mobility(M), rest)
    return np.asarray(np.linalg.solve(M, rest[..., None])[..., 0], dtype=float)


def base_twist_sensitivity(
    known: KnownDynamics, phi: ArrayLike, V_WB: ArrayLike
) -> NDArray[np.float64]:
    """Return ∂V_WB/∂φ (..., N, 6, 10) at a twist from `base_twist`, at fixed momentum in B.

    The derivative is −(M + XᵀGX)⁻¹ Xᵀ Y(V_WC), where Y is the target's momentum regressor, as in
    the standard rows.
    """
    M, _ = _total(known, phi)
    V_WC = rotate(known.X, V_WB) + known.V_BC
    Y = np.einsum("kij,...j->...ik", _G_BY_PHI, V_WC)
    return -known.mobility(M) @ np.swapaxes(known.X, -1, -2) @ Y


def propagate_base(
    tree: KinematicTree,
    motion: JointMotion,
    phi: ArrayLike,
    times: ArrayLike,
    *,
    quaternion_WB: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    p_WB: ArrayLike = (0.0, 0.0, 0.0),
    momentum_W: ArrayLike | Callable[[float], ArrayLike] | None = None,
    max_step: float = 0.1,
) -> BaseTrajectory:
    """Propagate the base's pose through a joint motion, for one target or for many at once.

    Fourth-order Runge-Kutta on attitude and position; the kinematics are computed once for all
    targets. With steps of 0.1 s the pose of the paper's motion is accurate to 1e-8.

    Args:
        tree: the known spacecraft.
        motion: the motion of its joints.
        phi: (..., 10) standard vectors.
        times: (N,) increasing instants of the result [s]; the motion starts at the first.
        quaternion_WB: (..., 4) attitude at the start (w, x, y, z).
        p_WB: (..., 3) position at the start [m].
        momentum_W: (..., 6) total momentum [L; P] about W's origin, in W [N·m·s, N·s]; default:
            zero. If external forces change it, a function that returns it at a time [s] in the
            range of `times`.
        max_step: longest step [s].

    Raises:
        InputError: times that do not increase, or a step that is not positive.

    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not times.size or (np.diff(times) <= 0).any():
        raise InputError("times must be increasing instants, at least one")
    if not max_step > 0:
        raise InputError(f"max_step must be > 0 s, not {max_step}")
    phi = np.asarray(phi, dtype=float)

    def momentum_at(time: float) -> NDArray[np.float64]:
        total = momentum_W(time) if callable(momentum_W) else momentum_W
        return np.asarray(total, dtype=float)

    batch = np.broadcast_shapes(
        phi.shape[:-1],
        np.shape(quaternion_WB)[:-1],
        np.shape(p_WB)[:-1],
        () if momentum_W is None else np.shape(momentum_at(times[0]))[:-1],
    )
    steps = np.maximum(np.ceil(np.diff(times) / max_step - 1e-9).astype(int), 1)
    starts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(times, times[1:], steps)]
    nodes = np.concatenate([*starts, times[-1:]])
    grid = np.sort(np.concatenate([nodes, (nodes[1:] + nodes[:-1]) / 2]))  # nodes and midpoints
    samples = motion.evaluate(grid)
    known = known_dynamics(tree, samples[:, 0], samples[:, 1])

    inverse = None
    if momentum_W is None:
        still = base_twist(known, phi)
    else:
        M, h = _total(known, phi)
        inverse = known.mobility(M)
        still = -rotate(inverse, h)
    twists = np.broadcast_to(still, (*batch, *still.shape[-2:]))

    def twist(node: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        if inverse is None:
            return twists[..., node, :]
        momentum = _momentum_in_base(momentum_at(grid[node]), pose)
        return twists[..., node, :] + rotate(inverse[..., node, :, :], momentum)

    pose = np.empty((*batch, 7))
    pose[..., :4], pose[..., 4:] = quaternion_WB, p_WB
    result = np.empty((*batch, times.size, 13))
    kept = np.concatenate([[0], np.cumsum(steps)])
    for k, node in enumerate(range(0, len(grid), 2)):
        keep = np.flatnonzero(kept == k)
        if keep.size:
            V = twist(node, pose)
            result[..., keep[0], :7] = pose
            result[..., keep[0], 7:10] = rotate_by_quaternion(pose[..., :4], V[..., :3])
            result[..., keep[0], 10:] = rotate_by_quaternion(pose[..., :4], V[..., 3:])
        if node + 2 < len(grid):
            pose = _runge_kutta_step(pose, twist, node, grid[node + 2] - grid[node])
    return BaseTrajectory(result[..., :4], result[..., 4:7], result[..., 7:10], result[..., 10:])


def _total(known: KnownDynamics, phi: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return inertia (..., N, 6, 6) and momentum (..., N, 6) at a base at rest, with the target."""
    XtG = np.swapaxes(known.X, -1, -2) @ target_spatial_inertia(phi)[..., None, :, :]
    return known.M + XtG @ known.X, known.h + rotate(XtG, known.V_BC)


def _runge_kutta_step(
    pose: NDArray[np.float64],
    twist: Callable[[int, NDArray[np.float64]], NDArray[np.float64]],
    node: int,
    step: float,
) -> NDArray[np.float64]:
    """Fourth-order step of (..., 7) poses over the grid's nodes `node`, +1 (midpoint) and +2."""
    a = _pose_rate(pose, twist(node, pose))
    middle = pose + step / 2 * a
    b = _pose_rate(middle, twist(node + 1, middle))
    middle = pose + step / 2 * b
    c = _pose_rate(middle, twist(node + 1, middle))
    end = pose + step * c
    d = _pose_rate(end, twist(node + 2, end))
    pose = pose + step / 6 * (a + 2 * b + 2 * c + d)
    pose[..., :4] /= np.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    return pose


def _pose_rate(pose: NDArray[np.float64], V: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rate of (quaternion, position) (..., 7) under a twist [ω; v] (..., 6) in B."""
    quaternion = pose[..., :4]
    rates = quaternion_rate(quaternion, V[..., :3]), rotate_by_quaternion(quaternion, V[..., 3:])
    return np.concatenate(rates, axis=-1)


def _momentum_in_base(
    momentum_W: NDArray[np.float64], pose: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return [L; P] about B's origin, in B, of a constant [L; P] about W's origin, in W."""
    L, P = momentum_W[..., :3], momentum_W[..., 3:]
    to_B = pose[..., :4] * [1.0, -1.0, -1.0, -1.0]
    about_B = L - cross(pose[..., 4:], P)
    parts = np.broadcast_arrays(rotate_by_quaternion(to_B, about_B), rotate_by_quaternion(to_B, P))
    return np.concatenate(parts, axis=-1)
