"""External forces and torques on a simulated spacecraft, as a Drake system."""

from collections.abc import Sequence

from pydrake.math import RigidTransform
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    OutputPort,
)

from cpid_drake.sensors.disturbances import WALK_PERIOD, SimulatedDisturbance
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.spatial_forces import SpatialForces, force_on


class DisturbanceSource(SpatialForces):
    """Accelerates the centre of mass of spacecraft and target, and turns them about it.

    The force acts on the base, at the current centre of mass of the system. It is the acceleration
    times the mass of the system, so the target need not be known to choose a disturbance. Torque
    and acceleration are discrete state; they change every `disturbances.WALK_PERIOD`, if they do.

    .. pydrake_system::

        name: DisturbanceSource
        input_ports:
        - state
        - moment1
        output_ports:
        - spatial_forces

    - `state`: x = [q; v] of the plant.
    - `moment1`, … (3): what masses that move in their bodies add to mass times centre of mass, from
      `SprungMass`; one input for each such mass.
    - `spatial_forces`: for `MultibodyPlant.get_applied_spatial_force_input_port()`.

    Args:
        spacecraft: the spacecraft, whose base the force acts on.
        plant: the finalized plant of spacecraft and target.
        disturbance: torque and acceleration as a function of time.
        masses: number of masses that move in their bodies.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        plant: MultibodyPlant,
        disturbance: SimulatedDisturbance,
        masses: int = 0,
    ) -> None:
        super().__init__("disturbance_source", plant, self.xd_ticket())
        self._disturbance = disturbance
        # The spacecraft is the plant's first model, so its bodies have the same indices.
        self._base = plant.get_body(spacecraft.base.index())
        self._mass = plant.CalcTotalMass(self._scratch.context)
        self._moment_ports = [
            self.DeclareVectorInputPort(f"moment{k + 1}", 3) for k in range(masses)
        ]
        self._index = self.DeclareDiscreteState(disturbance.at(0.0))
        if disturbance.walks:
            self.DeclarePeriodicDiscreteUpdateEvent(
                period_sec=WALK_PERIOD, offset_sec=0.0, update=self._update
            )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        plant: MultibodyPlant,
        disturbance: SimulatedDisturbance,
        moments: Sequence[OutputPort] = (),
    ) -> "DisturbanceSource":
        """Add a source and connect its inputs; see the constructor and `SpatialForces`."""
        source = DisturbanceSource(spacecraft, plant, disturbance, len(moments))._added(builder)
        for port, moment in zip(source._moment_ports, moments, strict=True):
            builder.Connect(moment, port)
        return source

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        number = round(context.get_time() / WALK_PERIOD)
        discrete_state.set_value(self._index, self._disturbance.piece(number))
        return EventStatus.Succeeded()

    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        scratch = self._plant_context(context)
        X_WB: RigidTransform = self._base.EvalPoseInWorld(scratch)
        p_WScm = self._plant.CalcCenterOfMassPositionInWorld(scratch)
        for port in self._moment_ports:
            p_WScm = p_WScm + port.Eval(context) / self._mass
        value = context.get_discrete_state(self._index).value()
        p_BScm = X_WB.inverse() @ p_WScm
        return [force_on(self._base, p_BScm, value[:3], self._mass * value[3:])]
