"""Effects of the constant errors on the base's motion.

Every quantity is in units of its σ, so its prior is a standard normal distribution. A kind that is
not here changes readings only; the model of its sensor has their derivatives.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.estimation.likelihood.constants import (
    ACCELERATION_B,
    OF_THRUST,
    TARGET_WHEEL,
    TORQUE_B,
    VALVE_DELAY,
    WHEEL,
    YIELDING,
    ConstantError,
)
from cpid_drake.estimation.likelihood.effect_terms import (
    MotionChange,
    write_force,
    write_yielding,
)
from cpid_drake.estimation.likelihood.motion_model import BaseMotion, Trajectory

Write = Callable[[BaseMotion, Trajectory, float, MotionChange], None]
"""Writes the change of the motion by σ of each entry of an error."""


def moves(error: ConstantError, motion: BaseMotion) -> bool:
    """Return whether a constant error changes the motion as `write_constant` writes it.

    Other errors change the readings alone, or the joint motion; see `joint_errors`.
    """
    return error.kind in (*OF_THRUST, *YIELDING, *_WRITE) or error.name in motion.forces


def write_constant(
    error: ConstantError, motion: BaseMotion, trajectory: Trajectory, change: MotionChange
) -> None:
    """Write the change of the motion by a constant error, which contains zeros."""
    if error.kind == VALVE_DELAY:
        change.delay[:] = error.sigma
    elif error.kind in OF_THRUST:
        change.thrust[motion.constants.of_thrust.index(error.name)] = error.sigma
    elif error.name in motion.forces:
        write_force(motion.forces[error.name], motion, trajectory, change)
    elif error.kind in YIELDING:
        write_yielding(error, motion, trajectory, change)
    elif error.kind in _WRITE:
        _WRITE[error.kind](motion, trajectory, error.sigma, change)


def _wheel(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of the angular momentum of rotors in the base, which rotates with it.

    That of the other bodies is counted at the start, so that a wheel alone is no momentum.
    """
    N = len(motion.nodes)
    R = trajectory.R[:N]
    change.w[:] = sigma * (trajectory.mobility @ R[0] - trajectory.inverse[:N])
    change.L[:] = sigma * (R[0] - R[-1])


def _target_wheel(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of the angular momentum of rotors in the target, which rotates with it."""
    N = len(motion.nodes)
    R, R_BC = trajectory.R[:N], motion.grid.R_BC
    first = R[0] @ R_BC[0]
    change.w[:] = sigma * (trajectory.mobility @ first - trajectory.inverse[:N] @ R_BC)
    change.L[:] = sigma * (first - R[-1] @ R_BC[-1])


def _leak_torque(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of a torque about the centre of mass that rotates with the base."""
    impulse = sigma * motion.accumulated(trajectory.R[: len(motion.nodes)])
    change.w[:], change.L[:] = trajectory.mobility @ impulse, impulse[-1]


def _leak_acceleration(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of an acceleration of the centre of mass that rotates with the base.

    A table lets none act along its normal.
    """
    N, normal = len(motion.nodes), motion.tree.normal_B
    free = np.eye(3) if normal is None else np.eye(3) - np.outer(normal, normal)
    velocity = sigma * motion.accumulated(trajectory.R[:N] @ free)
    both = np.concatenate([motion.accumulated(velocity), velocity], axis=1).reshape(N, -1)
    later = motion.interpolation(motion.times[N:]) @ both
    steps = np.concatenate([both, later]).reshape(-1, 6, 3)
    change.position[:], change.velocity[:] = steps[:, :3], steps[:, 3:]


_WRITE: dict[str, Write] = {
    WHEEL: _wheel,
    TARGET_WHEEL: _target_wheel,
    TORQUE_B: _leak_torque,
    ACCELERATION_B: _leak_acceleration,
}
