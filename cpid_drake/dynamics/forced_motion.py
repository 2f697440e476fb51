"""Base motion under forces that turn with the base: gravity gradient, and thrust.

Momentum [L; P] about W's origin, in W, is integrated together with the base's pose. `base_motion`
has the twist of the base for a given momentum; the wrench depends on the attitude, on the joints
and on the target, so that the momentum has no closed form.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.base_motion import (
    BaseTrajectory,
    known_dynamics,
    target_spatial_inertia,
)
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.rotations import cross, quaternion_rate, quaternion_to_matrix, skew, unskew
from cpid_drake.dynamics.tree import KinematicTree

LONGEST_STEP = 0.02
"""Longest step of the integration [s]."""


def propagate_forced(
    tree: KinematicTree,
    motion: JointMotion,
    phi: NDArray[np.float64],
    times: NDArray[np.float64],
    orbit: Orbit | None,
    *,
    momentum_W: ArrayLike,
    disturbance_W: ArrayLike = (0.0,) * 6,
    wrench_W: ArrayLike = (0.0,) * 6,
    wrench_B: ArrayLike = (0.0,) * 6,
    quaternion_WB: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    p_WB: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[BaseTrajectory, NDArray[np.float64]]:
    """Return the motion of the base for one target, and the momentum (6,) at the end.

    Fourth-order Runge-Kutta on pose and momentum.

    Args:
        tree: the known spacecraft.
        motion: the motion of its joints.
        phi: (10,) standard vector of the target.
        times: (N,) increasing instants of the result [s]; the motion starts at the first.
        orbit: the orbit of W's origin; None for no gravity gradient.
        momentum_W: (6,) total momentum [L; P] about W's origin at the start, in W [N·m·s, N·s].
        disturbance_W: (6,) constant torque about the system's centre of mass, and constant
            acceleration of this centre, in W [N·m, m/s²].
        wrench_W: (6,) constant external moment about W's origin and force, in W [N·m, N].
        wrench_B: (6,) constant torque about B's origin and force of thrusters, in B [N·m, N].
        quaternion_WB, p_WB: (4,), (3,) pose of the base at the start.

    """
    counts = np.maximum(np.ceil(np.diff(times) / LONGEST_STEP - 1e-9).astype(int), 1)
    starts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(times, times[1:], counts)]
    nodes = np.concatenate([*starts, times[-1:]])
    grid = np.sort(np.concatenate([nodes, (nodes[1:] + nodes[:-1]) / 2]))  # nodes and midpoints
    q, qdot, _ = np.moveaxis(motion.evaluate(grid), 1, 0)
    known = known_dynamics(tree, q, qdot)
    XtG = np.swapaxes(known.X, -1, -2) @ target_spatial_inertia(phi)
    M, h = known.M + XtG @ known.X, known.h + (XtG @ known.V_BC[..., None])[..., 0]
    mass = M[:, 5, 5]
    com = unskew(M[:, :3, 3:]) / mass[:, None]
    J = M[:, :3, :3] + mass[:, None, None] * skew(com) @ skew(com)
    inverse, rate2 = known.mobility(M), 0.0 if orbit is None else orbit.n**2
    nadir = np.zeros((len(grid), 3)) if orbit is None else orbit.nadir(grid)
    tide = np.zeros((len(grid), 3, 3)) if orbit is None else orbit.tide(grid)
    torque, acceleration = np.split(np.asarray(disturbance_W, dtype=float), 2)
    wrench = np.asarray(wrench_W, dtype=float)
    torque_B, force_B = np.split(np.asarray(wrench_B, dtype=float), 2)

    def twist(k: int, y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        R = quaternion_to_matrix(y[:4])
        L, P = y[7:10], y[10:]
        momentum = np.concatenate([(L - cross(y[4:7], P)) @ R, P @ R])
        return R, inverse[k] @ (momentum - h[k])

    def rate(k: int, y: NDArray[np.float64]) -> NDArray[np.float64]:
        R, V = twist(k, y)
        p_WScm = y[4:7] + R @ com[k]
        force = mass[k] * (acceleration + tide[k] @ p_WScm)
        r_B = nadir[k] @ R
        moment = torque + 3 * rate2 * (R @ cross(r_B, J[k] @ r_B))
        thrust = R @ force_B
        moment_W = moment + cross(p_WScm, force) + R @ torque_B + cross(y[4:7], thrust)
        added = np.concatenate([moment_W, force + thrust]) + wrench
        return np.concatenate([quaternion_rate(y[:4], V[:3]), R @ V[3:], added])

    y = np.concatenate([np.asarray(v, dtype=float) for v in (quaternion_WB, p_WB, momentum_W)])
    kept = np.concatenate([[0], np.cumsum(counts)])
    result = np.empty((len(times), 13))
    place = 0
    for step in range(len(nodes)):
        k = 2 * step
        if kept[place] == step:
            R, V = twist(k, y)
            result[place] = np.concatenate([y[:7], R @ V[:3], R @ V[3:]])
            place += 1
        if step + 1 < len(nodes):
            y = _step(rate, k, y, grid[k + 2] - grid[k])
    return BaseTrajectory(result[:, :4], result[:, 4:7], result[:, 7:10], result[:, 10:]), y[7:]


def _step(
    rate: Callable[[int, NDArray[np.float64]], NDArray[np.float64]],
    k: int,
    y: NDArray[np.float64],
    h: float,
) -> NDArray[np.float64]:
    """Return the state after a fourth-order step over nodes k, k + 1 (midpoint) and k + 2."""
    a = rate(k, y)
    b = rate(k + 1, y + h / 2 * a)
    c = rate(k + 1, y + h / 2 * b)
    d = rate(k + 2, y + h * c)
    y = y + h / 6 * (a + 2 * b + 2 * c + d)
    y[:4] /= np.linalg.norm(y[:4])
    return y
