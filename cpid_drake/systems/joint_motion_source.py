"""A joint motion as a Drake system."""

from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.files.errors import InputError


class JointMotionSource(LeafSystem):
    """Outputs a prescribed joint motion at the context's time.

    .. pydrake_system::

        name: JointMotionSource
        output_ports:
        - desired_motion

    - `desired_motion` (3 J): positions, rates and accelerations of the J joints, one after another.

    The motion is a parameter of the Context; it starts at t = 0.
    """

    def __init__(self, motion: JointMotion) -> None:
        super().__init__()
        self.set_name("joint_motion_source")
        self._motion_index = self.DeclareAbstractParameter(Value((0.0, motion)))
        self.DeclareVectorOutputPort(
            name="desired_motion",
            size=motion.evaluate(0.0).size,
            calc=self._calc_desired_motion,
            prerequisites_of_calc={self.time_ticket(), self.all_parameters_ticket()},
        )

    def set_motion(self, context: Context, motion: JointMotion) -> None:
        """Make another motion of the same joints from now on; it starts at the context's time.

        Raises:
            InputError: the motion has another number of joints.

        """
        size, expected = motion.evaluate(0.0).size, self.get_output_port().size()
        if size != expected:
            raise InputError(
                f"the motion has {size // 3} joints; that of this source has {expected // 3}"
            )
        value = (context.get_time(), motion)
        context.get_mutable_abstract_parameter(int(self._motion_index)).set_value(value)

    def _calc_desired_motion(self, context: Context, output: BasicVector) -> None:
        start, motion = context.get_abstract_parameter(int(self._motion_index)).get_value()
        output.SetFromVector(motion.evaluate(context.get_time() - start).ravel())
