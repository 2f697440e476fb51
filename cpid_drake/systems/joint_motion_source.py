"""A joint motion as a Drake system."""

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from cpid_drake.dynamics.joint_motion import JointMotion


class JointMotionSource(LeafSystem):
    """Outputs a prescribed joint motion at the context's time.

    .. pydrake_system::

        name: JointMotionSource
        output_ports:
        - desired_motion

    - `desired_motion` (3 J): positions, rates and accelerations of the J joints, one after another.
    """

    def __init__(self, motion: JointMotion) -> None:
        super().__init__()
        self.set_name("joint_motion_source")
        self._motion = motion
        self.DeclareVectorOutputPort(
            name="desired_motion",
            size=motion.evaluate(0.0).size,
            calc=self._calc_desired_motion,
            prerequisites_of_calc={self.time_ticket()},
        )

    def _calc_desired_motion(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.evaluate(context.get_time()).ravel())
