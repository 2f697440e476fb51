"""Effects of the constant errors on the base's motion.

Every quantity is in units of its σ, so its prior is a standard normal distribution. A kind that is
not here changes readings only; the model of its sensor has their derivatives.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.compliance import write_shifts, write_turns
from cpid_drake.estimation.likelihood.constants import COMPLIANCE, STRETCH, THRUST_SCALE
from cpid_drake.estimation.likelihood.effects import (
    Effect,
    MotionChange,
    joint_changes,
    write_change,
)
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory

Write = Callable[[BaseMotion, Trajectory, float, MotionChange], None]
"""Writes the change of the motion by σ of each entry of an error."""


class Constant(Effect):
    """A constant error.

    Args:
        motion: the base's motion.
        name: of the error.

    """

    def __init__(self, motion: BaseMotion, name: str) -> None:
        error = motion.constants.errors[name]
        self.name, self.size, self.kind = name, error.size, error.kind
        self._motion, self._sigma = motion, error.sigma

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        if self.kind in _WRITE:
            _WRITE[self.kind](self._motion, trajectory, self._sigma, change)


def _acceleration(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of an acceleration of the system's centre of mass, in W."""
    change.a_Wcm[:] = sigma * np.eye(3)


def _torque(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of a torque about the system's centre of mass, in W."""
    elapsed = (motion.times - motion.joints.start)[:, None, None]
    change.w[:] = sigma * elapsed * (trajectory.inverse @ np.swapaxes(trajectory.R, -1, -2))


def _thrust_scale(
    motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange
) -> None:
    """Write that of the scale of logged thrust."""
    change.thrust[:] = sigma


def _zeros(motion: BaseMotion, trajectory: Trajectory, sigma: float, change: MotionChange) -> None:
    """Write that of the joints' zeros: the measured positions are the true ones plus these."""
    by_q, _ = joint_changes(motion, trajectory)
    less = MotionSensitivity(*(-sigma * value for value in (by_q.w, by_q.com, by_q.v)))
    write_change(change, less, motion, trajectory)


_WRITE: dict[str, Write] = {
    "acceleration": _acceleration,
    "torque": _torque,
    THRUST_SCALE: _thrust_scale,
    COMPLIANCE: write_turns,
    STRETCH: write_shifts,
    "zero": _zeros,
}
