"""The momentum that a target has because its grasp is not rigid, as a Drake system."""

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.systems.plant_scratch import PlantScratch


class TargetDeflection(LeafSystem):
    """Computes the momentum of the target minus that of the same target fixed to C.

    .. pydrake_system::

        name: TargetDeflection
        input_ports:
        - state
        output_ports:
        - relative_momentum

    - `state`: x = [q; v] of the plant.
    - `relative_momentum` (6): [L; P] about W's origin, in W [N·m·s, N·s].

    Args:
        plant: the finalized plant of spacecraft and target.
        capture_frame: C in this plant.
        body: the target's body.
        target: the target.

    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        capture_frame: Frame,
        body: RigidBody,
        target: InertialParameters,
    ) -> None:
        super().__init__()
        self.set_name("target_deflection")
        self._plant, self._scratch = plant, PlantScratch(plant)
        self._frames = capture_frame, body.body_frame()
        self._inertia = target.to_spatial_inertia()
        self._state_port = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorOutputPort(
            name="relative_momentum",
            size=6,
            calc=self._calc_relative_momentum,
            prerequisites_of_calc={self.all_input_ports_ticket()},
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant,
        *,
        capture_frame: Frame,
        body: RigidBody,
        target: InertialParameters,
    ) -> "TargetDeflection":
        """Add the system and connect its input to the plant; see the constructor."""
        system = builder.AddSystem(
            TargetDeflection(plant, capture_frame=capture_frame, body=body, target=target)
        )
        builder.Connect(plant.get_state_output_port(), system.GetInputPort("state"))
        return system

    def _calc_relative_momentum(self, context: Context, output: BasicVector) -> None:
        scratch = self._scratch.context
        self._plant.SetPositionsAndVelocities(scratch, self._state_port.Eval(context))
        held, moving = (self._momentum(scratch, frame) for frame in self._frames)
        output.SetFromVector(moving - held)

    def _momentum(self, plant_context: Context, frame: Frame) -> NDArray[np.float64]:
        """Return the momentum [L; P] about W's origin of the target if it is fixed to a frame."""
        X_WT = frame.CalcPoseInWorld(plant_context)
        V_WT = frame.CalcSpatialVelocityInWorld(plant_context)
        momentum = self._inertia.ReExpress(X_WT.rotation()) * V_WT
        return np.asarray(momentum.Shift(-X_WT.translation()).get_coeffs())
