"""Effects of the constant errors on the base's motion.

Every quantity is in units of its σ, so its prior is a standard normal distribution. A kind that is
not here changes readings only; the model of its sensor has their derivatives.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.compliance import write_shifts, write_turns
from cpid_drake.estimation.likelihood.constants import (
    COMPLIANCE,
    DRIFT,
    OF_THRUST,
    STRETCH,
    WHEEL,
    ZERO,
    ConstantError,
)
from cpid_drake.estimation.likelihood.effects import (
    Effect,
    MotionChange,
    joint_changes,
    write_change,
)
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory

Write = Callable[[BaseMotion, Trajectory, float, MotionChange], None]
"""Writes the change of the motion by σ of each entry of an error."""


def constant_effect(motion: BaseMotion, name: str) -> Effect:
    """Return the effect of a constant error.

    Args:
        motion: the base's motion.
        name: of the error.

    """
    error = motion.constants.errors[name]

    def change_motion(trajectory: Trajectory, change: MotionChange) -> None:
        if error.kind in OF_THRUST:
            change.thrust[motion.constants.of_thrust.index(name)] = error.sigma
        elif error.kind == DRIFT:
            _write_drift(motion, trajectory, error, change)
        elif error.kind in _WRITE:
            _WRITE[error.kind](motion, trajectory, error.sigma, change)

    return Effect(name, error.size, change_motion)


def _acceleration(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of an acceleration of the system's centre of mass, in W."""
    elapsed = (motion.times - motion.joints.start)[:, None, None]
    change.position[:], change.velocity[:] = (
        sigma * each * np.eye(3) for each in (elapsed**2 / 2, elapsed)
    )


def _torque(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of a torque about the system's centre of mass, in W."""
    elapsed = (motion.times - motion.joints.start)[:, None, None]
    change.w[:] = sigma * elapsed * (trajectory.inverse @ np.swapaxes(trajectory.R, -1, -2))
    change.L[:] = sigma * elapsed[len(motion.nodes) - 1] * np.eye(3)


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


def _write_drift(
    motion: BaseMotion, trajectory: Trajectory, error: ConstantError, change: MotionChange
) -> None:
    """Write that of a constant rate of a joint's zero: position and rate are too large."""
    elapsed, j = (motion.times - motion.origin)[:, None], error.joint
    by_q, by_qdot = (vars(each).values() for each in joint_changes(motion, trajectory))
    by = (elapsed * q[..., j] + qdot[..., j] for q, qdot in zip(by_q, by_qdot, strict=True))
    less = MotionSensitivity(*(-error.sigma * value[..., None] for value in by))
    write_change(change, less, motion, trajectory)


_WRITE: dict[str, Write] = {
    "acceleration": _acceleration,
    "torque": _torque,
    WHEEL: _wheel,
    COMPLIANCE: write_turns,
    STRETCH: write_shifts,
    ZERO: _zeros,
}
