"""The first-order effects of a flexible grasp on the base's motion."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cpid_drake.dynamics.parameterizations import (
    point_mass_inertia,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.estimation.likelihood.effects import MotionChange
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory


def wrist_load(motion: BaseMotion, trajectory: Trajectory) -> CubicSpline | None:
    """Return the moment about C's origin and the force that move a rigidly held target (6,) in C.

    They are functions of time [N·m, N], with rates as seen from C. None if ψ is that of no body.

    Args:
        motion: the base's motion.
        trajectory: its trajectory.

    """
    psi, nodes, grid = trajectory.state.psi, motion.nodes, motion.grid
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
    return CubicSpline(nodes, np.hstack([turning + cross(first / mu, force), force]))


def write_turns(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write the change of the motion by σ of the compliance about each axis of C.

    The target turns against C by δ = -(compliance) τ, with the moment τ of a rigid grasp. This
    holds if the modes of the grasp are much faster than the motion, and if external forces on the
    target are small. The turn changes c and I_*, and the target's angular velocity by δ̇. The
    angular momentum about the system's centre of mass then changes by
    Y(ω) Δψ + I_* δ̇ + s × (δ̇ × μc), with the terms of `BodyDynamics`.

    Args:
        motion: the base's motion.
        trajectory: its trajectory.
        sigma: [rad/(N·m)].
        change: three columns, which contain zeros.

    """
    first, inertia = trajectory.state.psi[1:4], vector_to_tensor(trajectory.state.psi[4:])
    by_turn = [
        [
            0.0,
            *np.cross(unit, first),
            *tensor_to_vector(skew(unit) @ inertia - inertia @ skew(unit)),
        ]
        for unit in np.eye(3)
    ]
    _write(motion, trajectory, sigma, change, slice(0, 3), np.array(by_turn), inertia)


def write_shifts(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write the change of the motion by σ [m/N] of the compliance along each axis of C.

    The target moves against C by d = -(compliance) f, with the force f of a rigid grasp, under the
    conditions of `write_turns`. The shift changes c and I_*, and the velocity of the target's
    centre of mass by ḋ. The angular momentum about the system's centre of mass then changes by
    Y(ω) Δψ + (s + c) × μḋ. The arguments are those of `write_turns`.
    """
    mu, first = float(trajectory.state.psi[0]), trajectory.state.psi[1:4]
    by_shift = np.zeros((3, 10))
    for axis, unit in enumerate(np.eye(3)):
        moved = 2 * first[axis] * np.eye(3) - np.outer(first, unit) - np.outer(unit, first)
        by_shift[axis] = np.concatenate([[0.0], mu * unit, tensor_to_vector(moved)])
    spin = np.cross(first, np.eye(3))
    _write(motion, trajectory, sigma, change, slice(3, 6), by_shift, spin)


def _write(
    motion: BaseMotion,
    trajectory: Trajectory,
    sigma: float,
    change: MotionChange,
    place: slice,
    by_sizes: NDArray[np.float64],
    momentum_by_rates: NDArray[np.float64],
) -> None:
    """Write the change by displacements −σ × (three entries of the load at a place).

    Each changes ψ by a row of `by_sizes` (3, 10), and its rate the angular momentum about C, in C,
    by a row of `momentum_by_rates` (3, 3).
    """
    load = wrist_load(motion, trajectory)
    if load is None:
        return
    sizes = -sigma * np.stack([load(motion.times, order)[:, place] for order in range(2)])
    dynamics = motion.dynamics
    Y, per_mass = dynamics.regressor(trajectory.w), dynamics.R_BC / dynamics.mass
    for axis, (by_size, by_rate) in enumerate(zip(by_sizes, momentum_by_rates, strict=True)):
        value, rate = sizes[:, :, axis, None]
        moved = by_size[1:4]
        spin = rotate(dynamics.R_BC, by_rate + cross(dynamics.s, moved))
        momentum = value * (Y @ by_size) + rate * spin
        change.w[:, :, axis] = -rotate(trajectory.inverse, momentum)[: len(change.w)]
        change.com[:, :, axis] = rotate(per_mass, value * moved)
        if len(change.com_rate):
            change.com_rate[:, :, axis] = rotate(
                per_mass, value * cross(dynamics.w_BC, moved) + rate * moved
            )
