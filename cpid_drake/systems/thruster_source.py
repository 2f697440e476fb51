"""Burns of thrusters on a simulated spacecraft, and their log, as a Drake system."""

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
)

from cpid_drake.logs.log import Samples
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.spatial_forces import SpatialForces, force_on

_ONCE = 1e12  # a period so long that a periodic event happens once [s]


class ThrusterSource(SpatialForces):
    """Pushes and turns the base of a spacecraft, and reports its thrust.

    .. pydrake_system::

        name: ThrusterSource
        input_ports:
        - state
        output_ports:
        - spatial_forces
        - thrust

    - `state`: x = [q; v] of the plant.
    - `spatial_forces`: for `MultibodyPlant.get_applied_spatial_force_input_port()`.
    - `thrust` (7): the time [s] of the latest entry of the log, then the logged torque about B's
      origin [N·m] and force [N], in B; NaN before the first.

    The thrust is discrete state, which changes at the times of the log only.

    Attributes:
        scale: the true thrust as a multiple of the logged one.

    Args:
        spacecraft: the spacecraft, on whose base the thrusters are.
        plant: the finalized plant of spacecraft and target.
        log: samples [τ; f] (N, 6) in B, each of which holds until the next.
        scale: the true thrust as a multiple of the logged one.

    """

    def __init__(
        self, spacecraft: Spacecraft, plant: MultibodyPlant, log: Samples, scale: float = 1.0
    ) -> None:
        super().__init__("thruster_source", plant, self.xd_ticket())
        self.scale = scale
        # The spacecraft is the plant's first model, so its bodies have the same indices.
        self._base = plant.get_body(spacecraft.base.index())
        self._index = self.DeclareDiscreteState(np.full(7, np.nan))
        for time, value in zip(log.time.tolist(), log.value, strict=True):
            self._declare_change(np.append(time, value))
        self.DeclareVectorOutputPort(
            name="thrust", size=7, calc=self._calc_thrust, prerequisites_of_calc={self.xd_ticket()}
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        plant: MultibodyPlant,
        log: Samples,
        scale: float = 1.0,
    ) -> "ThrusterSource":
        """Add a source and connect its input; see the constructor and `SpatialForces`."""
        return ThrusterSource(spacecraft, plant, log, scale)._added(builder)

    def _declare_change(self, entry: NDArray[np.float64]) -> None:
        def update(context: Context, discrete_state: DiscreteValues) -> EventStatus:
            discrete_state.set_value(self._index, entry)
            return EventStatus.Succeeded()

        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=_ONCE, offset_sec=float(entry[0]), update=update
        )

    def _calc_thrust(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._index).value())

    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        R_WB = self._base.EvalPoseInWorld(self._plant_context(context)).rotation().matrix()
        wrench = self.scale * np.nan_to_num(context.get_discrete_state(self._index).value()[1:])
        return [force_on(self._base, np.zeros(3), R_WB @ wrench[:3], R_WB @ wrench[3:])]
