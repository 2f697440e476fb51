"""The reaction of a table that carries a simulated spacecraft on air bearings."""

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem

from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.plant_scratch import PlantScratch

FREQUENCY = 10.0
"""Natural frequency of height and tilt on a simulated table [Hz]."""


class TableReaction(LeafSystem):
    """Holds the height and the tilt of the base by a force along W's z axis and moments across it.

    Stiff springs with critical damping hold the base's origin at z = 0 and the table's normal in
    the base along W's z axis. They do not act in the plane, so the linear momentum in the plane and
    the angular momentum about W's z axis are conserved. Their stiffness is in proportion to the
    current inertia of the system, so that height and tilt have one natural frequency.

    .. pydrake_system::

        name: TableReaction
        input_ports:
        - state
        output_ports:
        - spatial_forces

    - `state`: x = [q; v] of the plant.
    - `spatial_forces`: for `MultibodyPlant.get_applied_spatial_force_input_port()`.

    Args:
        spacecraft: a spacecraft on a table, from `Spacecraft.on_table`.
        plant: the finalized plant of spacecraft and target.

    Raises:
        InputError: the spacecraft floats freely.

    """

    def __init__(self, spacecraft: Spacecraft, plant: MultibodyPlant) -> None:
        super().__init__()
        self.set_name("table_reaction")
        if spacecraft.tree.normal_B is None:
            raise InputError("the spacecraft floats freely; give Spacecraft.on_table()")
        self._normal_B = spacecraft.tree.normal_B
        self._plant, self._scratch = plant, PlantScratch(plant)
        # The spacecraft is the plant's first model, so its bodies have the same indices.
        self._base = plant.get_body(spacecraft.base.index())
        start = self._base.floating_velocities_start_in_v()
        self._held = start + np.array([0, 1, 5])  # tilt about x and y, height
        self._state_port = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareAbstractOutputPort(
            name="spatial_forces",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_spatial_forces,
            prerequisites_of_calc={self.all_input_ports_ticket()},
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder, spacecraft: Spacecraft, *, plant: MultibodyPlant
    ) -> "TableReaction":
        """Add a table and connect its input to a plant of the same diagram; see the constructor.

        `spatial_forces` remains to be connected, since a plant has one input for all such forces.
        """
        table = builder.AddSystem(TableReaction(spacecraft, plant))
        builder.Connect(plant.get_state_output_port(), table.GetInputPort("state"))
        return table

    def _calc_spatial_forces(self, context: Context, output: Value) -> None:
        scratch = self._scratch.context
        self._plant.SetPositionsAndVelocities(scratch, self._state_port.Eval(context))
        X_WB = self._base.EvalPoseInWorld(scratch)
        V_WB = self._base.EvalSpatialVelocityInWorld(scratch)
        tilt = np.cross(NORMAL_W, X_WB.rotation() @ self._normal_B)
        place = np.array([tilt[0], tilt[1], X_WB.translation()[2]])
        rate = np.array([*V_WB.rotational()[:2], V_WB.translational()[2]])
        inertia = self._plant.CalcMassMatrix(scratch)[np.ix_(self._held, self._held)]
        w = 2 * np.pi * FREQUENCY
        x, y, lift = -inertia @ (w**2 * place + 2 * w * rate)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._base.index()
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(np.array([x, y, 0.0]), lift * NORMAL_W)
        output.set_value([force])
