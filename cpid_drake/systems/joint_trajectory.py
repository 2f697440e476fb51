"""A joint motion as one of Drake's trajectories, for its `TrajectorySource`."""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from cpid_drake.dynamics.joint_motion import JointMotion


class JointTrajectory(Trajectory):  # type: ignore[misc]  # the base has no usable stub
    """A prescribed joint motion: (J, 1) positions [rad or m], with rates and accelerations.

    Before its start and after its end the joints rest.

    Args:
        motion: the motion.
        start: time at which it starts [s].
        order: which derivative of the positions the value is: 0, 1 or 2.

    """

    def __init__(self, motion: JointMotion, start: float = 0.0, order: int = 0) -> None:
        super().__init__()
        self._motion, self._start, self._order = motion, start, order

    def __deepcopy__(self, memo: dict[int, object]) -> "JointTrajectory":
        """Return the same motion."""
        return JointTrajectory(self._motion, self._start, self._order)

    def source(self) -> TrajectorySource:
        """Return Drake's source of positions, rates and accelerations (3 J), one after another."""
        return TrajectorySource(
            self, output_derivative_order=2, zero_derivatives_beyond_limits=False
        )

    def do_rows(self) -> int:
        """Return J."""
        return self.do_value(0.0).size

    def do_cols(self) -> int:
        """Return 1."""
        return 1

    def do_start_time(self) -> float:
        """Return the time at which the motion starts [s]."""
        return self._start

    def do_end_time(self) -> float:
        """Return the time from which on the joints rest [s]."""
        return self._start + self._motion.duration

    def do_has_derivative(self) -> bool:
        """Return True."""
        return True

    def do_value(self, t: float) -> NDArray[np.float64]:
        """Return the values (J, 1) at a time [s]."""
        return self.DoEvalDerivative(t, 0)

    def DoEvalDerivative(self, t: float, derivative_order: int) -> NDArray[np.float64]:
        """Return a derivative (J, 1) of the values at a time [s]."""
        return self._motion.evaluate(t - self._start)[self._order + derivative_order, :, None]

    def DoMakeDerivative(self, derivative_order: int) -> "JointTrajectory":
        """Return the trajectory of a derivative of the values."""
        return JointTrajectory(self._motion, self._start, self._order + derivative_order)
