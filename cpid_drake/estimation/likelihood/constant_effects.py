"""Effects of the constant errors on the base's motion.

Every quantity is in units of its σ, so its prior is a standard normal distribution. A kind that is
not here changes readings only; the model of its sensor has their derivatives.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.compliance import write_shifts, write_turns
from cpid_drake.estimation.likelihood.constants import (
    ACCELERATION_B,
    COMPLIANCE,
    DRIFT,
    OF_THRUST,
    STRETCH,
    TORQUE_B,
    VALVE_DELAY,
    WHEEL,
    ZERO,
    ConstantError,
)
from cpid_drake.estimation.likelihood.effects import (
    MotionChange,
    joint_changes,
    write_change,
    write_force,
)
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory

Write = Callable[[BaseMotion, Trajectory, float, MotionChange], None]
"""Writes the change of the motion by σ of each entry of an error."""


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
    elif error.kind in _WRITE:
        _WRITE[error.kind](motion, trajectory, error.sigma, change)


def _wheel(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of the angular momentum of rotors in the base, which turns with it.

    That of the other bodies is counted at the start, so that a wheel alone is no momentum.
    """
    R, end = trajectory.R, len(motion.nodes) - 1
    change.w[:] = sigma * trajectory.inverse @ (np.swapaxes(R, -1, -2) @ R[0] - np.eye(3))
    change.L[:] = sigma * (R[0] - R[end])


def _zeros(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of the joints' zeros: the measured positions are the true ones plus these."""
    by_q, _ = joint_changes(motion, trajectory)
    less = MotionSensitivity(*(-sigma * value for value in vars(by_q).values()))
    write_change(change, less, motion, trajectory)


def _drifts(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of constant rates of the joints' zeros: positions and rates are too large."""
    elapsed = (motion.times - motion.origin)[:, None, None]
    by_q, by_qdot = (vars(each).values() for each in joint_changes(motion, trajectory))
    by = (elapsed * q + qdot for q, qdot in zip(by_q, by_qdot, strict=True))
    less = MotionSensitivity(*(-sigma * value for value in by))
    write_change(change, less, motion, trajectory)


def _leak_torque(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of a torque about the centre of mass that turns with the base."""
    N = len(motion.nodes)
    impulse = sigma * motion.accumulated(trajectory.R[:N])
    later = motion.interpolation(motion.times[N:]) @ impulse.reshape(N, -1)
    gained = np.concatenate([impulse, later.reshape(-1, 3, 3)])
    change.w[:] = trajectory.inverse @ np.swapaxes(trajectory.R, -1, -2) @ gained
    change.L[:] = impulse[-1]


def _leak_acceleration(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of an acceleration of the centre of mass that turns with the base.

    A table lets none act along its normal.
    """
    N, normal = len(motion.nodes), motion.tree.normal_B
    free = np.eye(3) if normal is None else np.eye(3) - np.outer(normal, normal)
    velocity = sigma * motion.accumulated(trajectory.R[:N] @ free)
    both = np.concatenate([motion.accumulated(velocity), velocity], axis=1).reshape(N, -1)
    later = motion.interpolation(motion.times[N:]) @ both
    found = np.concatenate([both, later]).reshape(-1, 6, 3)
    change.position[:], change.velocity[:] = found[:, :3], found[:, 3:]


_WRITE: dict[str, Write] = {
    WHEEL: _wheel,
    COMPLIANCE: write_turns,
    STRETCH: write_shifts,
    ZERO: _zeros,
    DRIFT: _drifts,
    TORQUE_B: _leak_torque,
    ACCELERATION_B: _leak_acceleration,
}
