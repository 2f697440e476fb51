"""The first-order effect of a flexible grasp on the base's motion."""

import numpy as np
from scipy.interpolate import CubicSpline

from cpid_drake.dynamics.parameterizations import tensor_to_vector, vector_to_tensor
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.dynamics.spatial_inertia import point_mass_inertia
from cpid_drake.estimation.likelihood.effects import MotionChange
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory


def wrist_moment(motion: BaseMotion, trajectory: Trajectory) -> CubicSpline | None:
    """Return the moment about C's origin that moves a rigidly held target, (3,) in C [N·m].

    It is a function of time. Its rate is that seen from C. None if ψ is that of no body.

    Args:
        motion: the base's motion.
        trajectory: its trajectory.

    """
    psi, nodes, grid = trajectory.state.psi, motion.nodes, motion.grid.dynamics
    mu, first = float(psi[0]), psi[1:4]
    if mu <= 0:
        return None
    R_CB = np.swapaxes(grid.R_BC, -1, -2)
    R_WC = trajectory.R[: len(nodes)] @ grid.R_BC
    w_BC = rotate(R_CB, trajectory.w[: len(nodes)])
    w, sdot = w_BC + grid.w_BC, grid.sdot + cross(w_BC, grid.s)
    I_cm = vector_to_tensor(psi[4:]) - point_mass_inertia(mu, first / mu)
    momentum = np.hstack([rotate(R_WC, w @ I_cm), rotate(R_WC, mu * sdot + cross(w, first))])
    rates = CubicSpline(nodes, momentum).derivative()(nodes)
    R_CW = np.swapaxes(R_WC, -1, -2)
    turning, force = rotate(R_CW, rates[:, :3]), rotate(R_CW, rates[:, 3:])
    return CubicSpline(nodes, turning + cross(first / mu, force))


def write_compliance(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write the change of the motion by σ of the compliance about each axis of C.

    The target turns against C by δ = -(compliance) τ, with the moment τ of a rigid grasp. This
    holds if the modes of the grasp are much faster than the motion, and if external forces on the
    target are small. The turn changes c and I_*, and the target's angular velocity by δ̇. The
    angular momentum about the system's centre of mass then changes by
    Y(ω) Δψ + I_* δ̇ + s × (δ̇ × μc), with the terms of `RelativeDynamics`.

    Args:
        motion: the base's motion.
        trajectory: its trajectory.
        sigma: [rad/(N·m)].
        change: three columns, which contain zeros.

    """
    moment = wrist_moment(motion, trajectory)
    if moment is None:
        return
    psi, at = trajectory.state.psi, motion.instants
    dynamics, first, inertia = at.dynamics, psi[1:4], vector_to_tensor(psi[4:])
    Y, per_mass = dynamics.regressor(trajectory.w), dynamics.R_BC / dynamics.mass
    turns, rates = -sigma * moment(at.times), -sigma * moment(at.times, 1)
    for axis, unit in enumerate(np.eye(3)):
        turn, rate = turns[:, axis, None], rates[:, axis, None]
        moved = np.cross(unit, first)
        turned = skew(unit) @ inertia - inertia @ skew(unit)
        by_turn = np.concatenate([np.zeros(1), moved, tensor_to_vector(turned)])
        by_rate = rotate(dynamics.R_BC, inertia @ unit + cross(dynamics.s, moved))
        momentum = turn * (Y @ by_turn) + rate * by_rate
        change.w[:, :, axis] = -rotate(trajectory.inverse, momentum)
        change.com[:, :, axis] = rotate(per_mass, turn * moved)
        change.com_rate[:, :, axis] = rotate(
            per_mass, turn * cross(dynamics.w_BC, moved) + rate * moved
        )
