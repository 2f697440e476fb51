"""The reaction of a table that carries a simulated spacecraft on air bearings."""

import numpy as np
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.spatial_forces import SpatialForces, force_on

FREQUENCY = 10.0
"""Natural frequency of height and tilt on a simulated table [Hz]."""


class TableReaction(SpatialForces):
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
        super().__init__("table_reaction", plant)
        if spacecraft.tree.normal_B is None:
            raise InputError("the spacecraft floats freely; give Spacecraft.on_table()")
        self._normal_B = spacecraft.tree.normal_B
        # The spacecraft is the plant's first model, so its bodies have the same indices.
        self._base = plant.get_body(spacecraft.base.index())
        start = self._base.floating_velocities_start_in_v()
        self._held = start + np.array([0, 1, 5])  # tilt about x and y, height

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder, spacecraft: Spacecraft, *, plant: MultibodyPlant
    ) -> "TableReaction":
        """Add a table and connect its input; see the constructor and `SpatialForces`."""
        return TableReaction(spacecraft, plant)._added(builder)

    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        scratch = self._plant_context(context)
        X_WB = self._base.EvalPoseInWorld(scratch)
        V_WB = self._base.EvalSpatialVelocityInWorld(scratch)
        tilt = np.cross(NORMAL_W, X_WB.rotation() @ self._normal_B)
        place = np.array([tilt[0], tilt[1], X_WB.translation()[2]])
        rate = np.array([*V_WB.rotational()[:2], V_WB.translational()[2]])
        inertia = self._plant.CalcMassMatrix(scratch)[np.ix_(self._held, self._held)]
        w = 2 * np.pi * FREQUENCY
        x, y, lift = -inertia @ (w**2 * place + 2 * w * rate)
        return [force_on(self._base, np.zeros(3), [x, y, 0.0], lift * NORMAL_W)]
