"""What all systems have in common that push or turn bodies of a plant."""

from abc import abstractmethod
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, DependencyTicket, DiagramBuilder, LeafSystem

from cpid_drake.systems.plant_scratch import PlantScratch


class SpatialForces(LeafSystem):
    """A system with the state of a plant as an input, and forces on its bodies as an output.

    The first input is `state`, the plant's x = [q; v]. The first output is `spatial_forces`, for
    `MultibodyPlant.get_applied_spatial_force_input_port()`.

    Args:
        name: name of the system.
        plant: the finalized plant.
        depends_on: what the forces depend on besides the inputs.

    """

    def __init__(self, name: str, plant: MultibodyPlant, *depends_on: DependencyTicket) -> None:
        super().__init__()
        self.set_name(name)
        self._plant, self._scratch = plant, PlantScratch(plant)
        self._state_port = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareAbstractOutputPort(
            name="spatial_forces",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_spatial_forces,
            prerequisites_of_calc={self.all_input_ports_ticket(), *depends_on},
        )

    def _added(self, builder: DiagramBuilder) -> Self:
        """Add the system, and connect its input to the plant of the same diagram.

        `spatial_forces` remains to be connected, since a plant has one input for all such forces.
        """
        builder.AddSystem(self)
        builder.Connect(self._plant.get_state_output_port(), self._state_port)
        return self

    def _plant_context(self, context: Context) -> Context:
        """Return a context of the plant with its current positions and velocities."""
        self._plant.SetPositionsAndVelocities(self._scratch.context, self._state_port.Eval(context))
        return self._scratch.context

    def _calc_spatial_forces(self, context: Context, output: Value) -> None:
        output.set_value(self._forces(context))

    @abstractmethod
    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        """Return the forces."""


def force_on(
    body: RigidBody, p_BQ: ArrayLike, torque_W: ArrayLike, force_W: ArrayLike
) -> ExternallyAppliedSpatialForce:
    """Return a force on a body.

    Args:
        body: the body B.
        p_BQ: (3,) the point Q of B at which the force acts [m].
        torque_W: (3,) torque about Q [N·m].
        force_W: (3,) force [N].

    """
    applied = ExternallyAppliedSpatialForce()
    applied.body_index, applied.p_BoBq_B = body.index(), np.asarray(p_BQ)
    applied.F_Bq_W = SpatialForce(np.asarray(torque_W), np.asarray(force_W))
    return applied
