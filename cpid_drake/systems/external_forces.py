"""What acts on a simulated spacecraft from outside: disturbance, gravity gradient, burns, table."""

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import (
    Context,
    ContinuousState,
    DiscreteValues,
    EventStatus,
    ValueProducer,
)

from cpid_drake.array import Array
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.simulated_disturbance import WALK_PERIOD, SimulatedDisturbance
from cpid_drake.spacecraft.floating_base import floating_joint
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.ports import SpacecraftSystem

TABLE_FREQUENCY = 10.0
"""Natural frequency of height and tilt on a simulated table [Hz]: far above that of any motion."""

Load = tuple[int, Array, Array, Array, Array]
"""Index of a body B, its point Q as p_BQ and p_WQ [m], torque about Q [N·m] and force at Q [N]."""

_ONCE = 1e12  # a period so long that a periodic event happens once [s]


class ExternalForces(SpacecraftSystem):
    """Applies all forces from outside to a plant, and integrates their momentum.

    - The disturbance is a torque, and a force on the base at the common centre of mass. The force
      is an acceleration times the mass of all bodies, so the target need not be known to choose it.
    - The gravity gradient of an orbit acts on every body: W's origin moves along the orbit.
    - Thrusters on the base give a multiple of the logged thrust.
    - A table holds the base's origin at z = 0 and the table's normal along W's z axis, by springs
      with critical damping in proportion to the current inertia. It does not act in the plane.

    .. pydrake_system::

        name: ExternalForces
        input_ports:
        - state
        output_ports:
        - spatial_forces
        - impulse
        - thrust

    - `state`: x = [q; v] of the plant.
    - `spatial_forces`: for `MultibodyPlant.get_applied_spatial_force_input_port()`.
    - `impulse` (6): the momentum [L; P] about W's origin, in W, that the forces have given.
    - `thrust` (7): the time [s] of the latest entry of the log of thrust, then the logged torque
      about B's origin [N·m] and force [N], in B; NaN before the first.

    The impulse is continuous state. Disturbance and thrust are discrete state, which changes at the
    times of their steps only.

    Args:
        spacecraft: the spacecraft; on a table if it is from `Spacecraft.on_table`.
        plant: the finalized plant of spacecraft and target.
        disturbance: torque and acceleration as a function of time; default: none.
        orbit: the orbit of W's origin; default: none.
        thrust: samples [τ; f] (N, 6) in B, each of which holds until the next; default: none.
        thrust_scale: the true thrust as a multiple of the logged one.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        plant: MultibodyPlant,
        *,
        disturbance: SimulatedDisturbance | None = None,
        orbit: Orbit | None = None,
        thrust: Samples | None = None,
        thrust_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.set_name("external_forces")
        self._plant = plant
        self._plant_context = self._declare_plant_context(plant)
        self._disturbance, self._orbit = disturbance, orbit
        self._thrust_scale, self._normal_B = thrust_scale, spacecraft.tree.normal_B
        # The spacecraft is the plant's first model, so its bodies have the same indices.
        self._base = plant.get_body(spacecraft.base.index())
        self._first_velocity = floating_joint(plant, self._base).velocity_start()
        self._mass = plant.CalcTotalMass(plant.CreateDefaultContext())
        bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
        self._bodies = [body for body in bodies if body.default_mass() != 0]
        inertias = [body.default_spatial_inertia() for body in self._bodies]
        self._masses = np.array([inertia.get_mass() for inertia in inertias])
        self._coms = np.array([inertia.get_com() for inertia in inertias])
        self._central = np.array(
            [i.Shift(i.get_com()).CalcRotationalInertia().CopyToFullMatrix3() for i in inertias]
        )
        self._state_port = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._disturbance_index = self.DeclareDiscreteState(
            np.zeros(6) if disturbance is None else disturbance.at(0.0)
        )
        if disturbance is not None and disturbance.walks:
            self.DeclarePeriodicDiscreteUpdateEvent(WALK_PERIOD, 0.0, self._step_disturbance)
        self._thrust_index = self.DeclareDiscreteState(np.full(7, np.nan))
        if thrust is not None:
            for time, value in zip(thrust.time.tolist(), thrust.value, strict=True):
                self._declare_thrust(np.append(time, value))
        self._loads_cache = self.DeclareCacheEntry(
            "loads",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(object()),
                calc=lambda context, value: value.set_value(self._loads(context)),
            ),
            {self.all_input_ports_ticket(), self.xd_ticket(), self.time_ticket()},
        )
        self.DeclareAbstractOutputPort(
            name="spatial_forces",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_spatial_forces,
            prerequisites_of_calc={self.cache_entry_ticket(self._loads_cache.cache_index())},
        )
        self.DeclareStateOutputPort("impulse", self.DeclareContinuousState(6))
        self.DeclareStateOutputPort("thrust", self._thrust_index)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Set the derivative of the impulse: the wrench of all forces about W's origin."""
        loads = self._loads_cache.Eval(context)
        p, torque, force = (np.array([load[k] for load in loads]) for k in (2, 3, 4))
        rate = np.concatenate([torque + cross(p, force), force], axis=1).sum(axis=0)
        derivatives.get_mutable_vector().SetFromVector(rate)

    def _step_disturbance(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        assert self._disturbance is not None
        number = round(context.get_time() / WALK_PERIOD)
        discrete_state.set_value(self._disturbance_index, self._disturbance.piece(number))
        return EventStatus.Succeeded()

    def _declare_thrust(self, entry: Array) -> None:
        def update(context: Context, discrete_state: DiscreteValues) -> EventStatus:
            discrete_state.set_value(self._thrust_index, entry)
            return EventStatus.Succeeded()

        self.DeclarePeriodicDiscreteUpdateEvent(_ONCE, float(entry[0]), update)

    def _calc_spatial_forces(self, context: Context, output: Value) -> None:
        forces = []
        for index, p_BQ, _, torque_W, force_W in self._loads_cache.Eval(context):
            applied = ExternallyAppliedSpatialForce()
            applied.body_index, applied.p_BoBq_B = BodyIndex(index), p_BQ
            applied.F_Bq_W = SpatialForce(torque_W, force_W)
            forces.append(applied)
        output.set_value(forces)

    def _loads(self, context: Context) -> list[Load]:
        scratch = self._plant_context(context)
        self._plant.SetPositionsAndVelocities(scratch, self._state_port.Eval(context))
        X_WB = self._base.EvalPoseInWorld(scratch)
        R_WB, p_WB, origin = X_WB.rotation().matrix(), X_WB.translation(), np.zeros(3)
        base = int(self._base.index())
        value = context.get_discrete_state(self._disturbance_index).value()
        p_WScm = self._plant.CalcCenterOfMassPositionInWorld(scratch)
        p_BScm = X_WB.inverse() @ p_WScm
        loads = [(base, p_BScm, p_WScm, value[:3], self._mass * value[3:])]
        logged = np.nan_to_num(context.get_discrete_state(self._thrust_index).value()[1:])
        torque_W, force_W = self._thrust_scale * logged.reshape(2, 3) @ R_WB.T
        loads.append((base, origin, p_WB, torque_W, force_W))
        if self._orbit is not None:
            loads += self._gravity_gradient(self._orbit, scratch, context.get_time())
        if self._normal_B is not None:
            reaction = self._table_reaction(R_WB @ self._normal_B, scratch)
            loads.append((base, origin, p_WB, *reaction))
        return loads

    def _gravity_gradient(self, orbit: Orbit, scratch: Context, time: float) -> list[Load]:
        """Return a force at the centre of mass of every body with mass, and its torque."""
        poses = [body.EvalPoseInWorld(scratch) for body in self._bodies]
        R = np.array([pose.rotation().matrix() for pose in poses])
        p_WBcm = np.array([pose.translation() for pose in poses]) + rotate(R, self._coms)
        force_W = self._masses[:, None] * (p_WBcm @ orbit.tide(np.array([time]))[0].T)
        inertia_W = R @ self._central @ np.swapaxes(R, -1, -2)
        torque_W = orbit.torque(inertia_W, np.full(len(R), time))
        indices = [int(body.index()) for body in self._bodies]
        return list(zip(indices, self._coms, p_WBcm, torque_W, force_W, strict=True))

    def _table_reaction(self, normal_W: Array, scratch: Context) -> tuple[Array, Array]:
        """Return moments across W's z axis and a force along it, with the table's normal in W."""
        z = self._base.EvalPoseInWorld(scratch).translation()[2]
        V_WB = self._base.EvalSpatialVelocityInWorld(scratch)
        place = np.array([*np.cross(NORMAL_W, normal_W)[:2], z])
        rate = np.array([*V_WB.rotational()[:2], V_WB.translational()[2]])
        held = self._first_velocity + np.array([0, 1, 5])
        inertia = self._plant.CalcMassMatrix(scratch)[np.ix_(held, held)]
        w = 2 * np.pi * TABLE_FREQUENCY
        x, y, lift = -inertia @ (w**2 * place + 2 * w * rate)
        return np.array([x, y, 0.0]), lift * NORMAL_W
