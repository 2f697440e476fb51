"""Computed torque for a tree of joints on a free base."""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
)

from cpid_drake.errors import InputError
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.plant_scratch import PlantScratch
from cpid_drake.systems.ports import add_connected


class ComputedTorque(LeafSystem):
    """Base class of the joint controllers: computed torque with a model of spacecraft and target.

    `FreeFloatingDynamics` gives the efforts that accelerate the joints by
    a_J = q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q). These efforts act between the links, so they conserve
    momentum whatever the model is. The ports and arguments are those of `JointController`.
    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        plant: MultibodyPlant,
        *,
        natural_frequency: float = 10.0,
        damping_ratio: float = 1.0,
    ) -> None:
        super().__init__()
        self.set_name("joint_controller")
        gains = (natural_frequency, damping_ratio)
        if not (np.isfinite(gains).all() and min(gains) > 0):
            raise InputError(
                "controller gains must be > 0: natural_frequency "
                f"{natural_frequency:g}, damping_ratio {damping_ratio:g}"
            )
        self._dynamics = FreeFloatingDynamics(spacecraft, plant)
        self._scratch = PlantScratch(plant)
        self._stiffness = natural_frequency**2
        self._damping = 2 * damping_ratio * natural_frequency
        columns = spacecraft.columns_in(plant)
        self._q_columns, self._v_columns = (columns[k] for k in spacecraft.joint_state_columns)

        self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorInputPort("desired_motion", 3 * len(self._v_columns))
        self.DeclareVectorOutputPort(
            name="generalized_force",
            size=plant.num_velocities(),
            calc=self._calc_generalized_force,
            prerequisites_of_calc={self.all_input_ports_ticket(), self.all_state_ticket()},
        )

    def _model_context(self, context: Context) -> Context:
        """Return a context of the model, whose state is overwritten."""
        return self._scratch.context

    def _calc_generalized_force(self, context: Context, output: BasicVector) -> None:
        state = self.GetInputPort("state").Eval(context)
        q_d, qdot_d, qddot_d = self.GetInputPort("desired_motion").Eval(context).reshape(3, -1)
        a_J = (
            qddot_d
            + self._damping * (qdot_d - state[self._v_columns])
            + self._stiffness * (q_d - state[self._q_columns])
        )
        model = self._model_context(context)
        self._dynamics.plant.SetPositionsAndVelocities(model, state)
        output.SetFromVector(self._dynamics.generalized_force(model, a_J))


class JointController(ComputedTorque):
    """Drives the joints of a spacecraft along a motion; the base floats freely.

    This is computed torque with a constant model, see `ComputedTorque`.

    With a plant that includes the target the joints follow the desired motion exactly. A controller
    that must not know the target uses `Spacecraft.plant`, or better a plant with a nominal target:
    without one, the torques at the wrist are far too small for the load. A nominal target of half
    or twice the true mass suffices, because feedback corrects the rest.

    .. pydrake_system::

        name: JointController
        input_ports:
        - state
        - desired_motion
        output_ports:
        - generalized_force

    - `state`: x = [q; v] of the controller's model, which is that of the spacecraft's plant if the
      target is welded.
    - `desired_motion` (3 J): q_d, q̇_d, q̈_d of the J joints.
    - `generalized_force`: for the plant's applied-generalized-force port; zero on the base.

    Args:
        spacecraft: the spacecraft to be controlled.
        plant: the controller's model, with or without target. If the simulated plant has a
            compliant wrist, the model must have it too.
        natural_frequency: ω of the joint errors [rad/s].
        damping_ratio: ζ of the joint errors.

    Raises:
        InputError: the plant does not have the spacecraft's joints, or a gain is not positive.

    """

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        desired_motion: OutputPort,
        generalized_force: InputPort,
        plant: MultibodyPlant,
        **gains: float,
    ) -> "JointController":
        """Add a controller and connect its inputs and its output.

        Args:
            builder: the diagram's builder.
            spacecraft: the spacecraft to be controlled.
            state: x = [q; v], usually `MultibodyPlant.get_state_output_port()`.
            desired_motion: usually the output of a `JointMotionSource`.
            generalized_force: the input to drive, usually
                `MultibodyPlant.get_applied_generalized_force_input_port()`.
            plant: the controller's model; see the constructor.
            gains: the feedback gains; see the constructor.

        Raises:
            InputError: a port has the wrong size for this spacecraft; also the errors of the
                constructor.

        """
        ports = {"state": state, "desired_motion": desired_motion}
        system = add_connected(builder, JointController(spacecraft, plant, **gains), ports)
        builder.Connect(system.GetOutputPort("generalized_force"), generalized_force)
        return system
