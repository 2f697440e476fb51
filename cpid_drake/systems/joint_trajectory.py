"""A joint motion as one of Drake's trajectories, for its `TrajectorySource`."""

from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import FunctionHandleTrajectory

from cpid_drake.array import Array
from cpid_drake.dynamics.joint_motion import JointMotion


class JointTrajectory(FunctionHandleTrajectory):  # type: ignore[misc]  # no usable stub
    """A prescribed joint motion: (J, 1) positions [rad or m], with rates and accelerations.

    Before its start and after its end the joints rest.

    Args:
        motion: the motion.
        start: time at which it starts [s].

    """

    def __init__(self, motion: JointMotion, start: float = 0.0) -> None:
        def derivative(time: float, order: int) -> Array:
            return motion.evaluate(time - start)[order, :, None]

        joints = motion.evaluate(0.0).shape[-1]
        end = start + motion.duration
        super().__init__(lambda time: derivative(time, 0), joints, 1, start, end)
        self.set_derivative(derivative)

    def source(self) -> TrajectorySource:
        """Return Drake's source of positions, rates and accelerations (3 J), one after another."""
        return TrajectorySource(
            self, output_derivative_order=2, zero_derivatives_beyond_limits=False
        )
