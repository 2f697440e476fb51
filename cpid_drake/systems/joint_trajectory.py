"""A joint motion as one of Drake's trajectories, for its `TrajectorySource`."""

from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import FunctionHandleTrajectory

from cpid_drake.array import Array
from cpid_drake.dynamics.joint_motion import JointMotion


class JointTrajectory(FunctionHandleTrajectory):  # type: ignore[misc]  # no usable stub
    """A prescribed joint motion: (3 J, 1) positions [rad or m], then rates, then accelerations.

    They are one vector, so that each instant takes one evaluation of the motion. Before its start
    and after its end the joints rest.

    Args:
        motion: the motion.
        start: time at which it starts [s].

    """

    def __init__(self, motion: JointMotion, start: float = 0.0) -> None:
        def value(time: float) -> Array:
            return motion.evaluate(time - start).reshape(-1, 1)

        super().__init__(value, value(start).size, 1, start, start + motion.duration)

    def source(self) -> TrajectorySource:
        """Return Drake's source of positions, rates and accelerations (3 J), one after another."""
        return TrajectorySource(self)
