"""Effects of the constant errors on the base's motion and on the readings.

Every quantity is in units of its σ, so its prior is a standard normal distribution.
"""

import numpy as np

from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.compliance import write_shifts, write_turns
from cpid_drake.estimation.likelihood.constants import (
    COMPLIANCE,
    STRETCH,
    THRUST_SCALE,
    ConstantError,
)
from cpid_drake.estimation.likelihood.effects import (
    Effect,
    MotionChange,
    joint_changes,
    write_change,
)
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory


class Constant(Effect):
    """A constant error; the model of its sensor has the derivatives of the readings.

    Args:
        motion: the base's motion.
        error: the constant error.

    """

    def __init__(self, motion: BaseMotion, error: ConstantError) -> None:
        self.name, self.size, self.sigma = error.name, error.size, error.sigma
        self._motion = motion


class Acceleration(Constant):
    """A constant acceleration of the system's centre of mass, in W."""

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        change.a_Wcm[:] = self.sigma * np.eye(3)


class Torque(Constant):
    """A constant torque about the system's centre of mass, in W."""

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        elapsed = (self._motion.instants.times - self._motion.joints.start)[:, None, None]
        by_L = trajectory.inverse @ np.swapaxes(trajectory.R, -1, -2)
        change.w[:] = self.sigma * elapsed * by_L


class ThrustScale(Constant):
    """An error of the scale of logged thrust."""

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        change.thrust[:] = self.sigma


class JointZeros(Constant):
    """Errors of the joints' zeros: the measured positions are the true ones plus these.

    The model of a block is linear in them, about their nominal value at its start.
    """

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        by_q, _ = joint_changes(self._motion, trajectory)
        less = MotionSensitivity(*(-self.sigma * value for value in (by_q.w, by_q.com, by_q.v)))
        write_change(change, less, self._motion, trajectory)


class Compliance(Constant):
    """The compliance of the grasp about the axes of C; the model is linear in it, about zero."""

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        write_turns(self._motion, trajectory, self.sigma, change)


class Stretch(Compliance):
    """The compliance of the grasp along the axes of C; the model is linear in it, about zero."""

    def change_motion(self, trajectory: Trajectory, change: MotionChange) -> None:
        """See `Effect`."""
        write_shifts(self._motion, trajectory, self.sigma, change)


def constant_effects(motion: BaseMotion) -> list[Effect]:
    """Return the effects of all constant errors of a motion, in their order in the state."""
    classes: dict[str, type[Constant]] = {
        "acceleration": Acceleration,
        "torque": Torque,
        THRUST_SCALE: ThrustScale,
        COMPLIANCE: Compliance,
        STRETCH: Stretch,
        "zero": JointZeros,
    }
    errors = motion.constants.errors.values()
    return [classes.get(error.kind, Constant)(motion, error) for error in errors]
