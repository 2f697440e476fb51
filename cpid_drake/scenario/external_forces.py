"""Forces on the simulated plant besides the motors': disturbances, burns, springs, a table."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink
from scipy.interpolate import CubicSpline

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.burns import log_of_burns
from cpid_drake.logs.log import Samples
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.disturbances import SimulatedDisturbance
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.disturbance_source import DisturbanceSource
from cpid_drake.systems.gravity_gradient import GravityGradient
from cpid_drake.systems.sprung_mass import SprungMass
from cpid_drake.systems.table_reaction import TableReaction
from cpid_drake.systems.target_deflection import TargetDeflection
from cpid_drake.systems.thruster_source import ThrusterSource


@dataclass(frozen=True, eq=False)
class ExternalForces:
    """The systems of a Diagram that apply forces to bodies.

    Attributes:
        disturbance: torque and acceleration from outside.
        masses: the sprung masses.
        logs: log their relative momenta, and that of a target on a compliant wrist, every
            `SimulationConfig.log_period`.
        orbit: the orbit of W's origin; None for no gravity gradient.
        thrusters: the thrusters; None without burns.
        thrust: the log of the burns, with the error of its scale; empty without burns.

    """

    disturbance: SimulatedDisturbance
    masses: tuple[SprungMass, ...]
    logs: tuple[VectorLogSink, ...]
    orbit: Orbit | None
    thrusters: ThrusterSource | None
    thrust: Samples

    def start(self, root_context: Context) -> None:
        """Put the sprung masses at rest; the plant must have its initial state."""
        for mass in self.masses:
            mass.start(root_context)

    def expected_momentum(
        self,
        momentum_W: NDArray[np.float64],
        q: NDArray[np.float64],
        full: KinematicTree,
        telemetry: Telemetry,
        root_context: Context,
    ) -> NDArray[np.float64]:
        """Return the momentum [L; P] of the rigid model about W's origin, in W, (N, 6).

        It follows from the momentum at t = 0, the disturbance, the gravity gradient, the burns, the
        sprung masses and a compliant wrist. The rigid model has the momentum of the system without
        that of the masses relative to their bodies, and of the target relative to C. On a table
        only the components in the plane are those of the simulation.

        Args:
            momentum_W: (6,) the momentum at t = 0, where B coincides with W.
            q: (J,) the joint positions at t = 0.
            full: the spacecraft with the target.
            telemetry: the logged motion at N times.
            root_context: Context of a run to these times.

        """
        times = telemetry.time
        edges = self.disturbance.changes(0.0, times[-1])
        now, by_time = 0.0, {}
        state = momentum_W, BodyDynamics.at(full, q[None], 0 * q[None]).p_BK[0]
        for time in sorted({*times.tolist(), *edges}):
            state = momentum_after(*state, full.mass, self.disturbance.at(now), time - now)
            now, by_time[time] = time, state
        expected, undisturbed = map(np.array, zip(*(by_time[time] for time in times.tolist())))
        if self.orbit is not None or self.thrusters is not None:
            expected += self._of_gradient(full, telemetry, undisturbed)
        if self.thrusters is not None:
            expected += self._of_thrust(telemetry)
        for sink in self.logs:
            log = sink.FindLog(root_context)
            logged, first = np.unique(log.sample_times(), return_index=True)
            expected -= log.data()[:, first[np.searchsorted(logged, times)]].T
        return expected

    def _of_gradient(
        self, full: KinematicTree, telemetry: Telemetry, p_WScm: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the momentum (N, 6) that the gravity gradient adds, integrated over the motion.

        So is the moment of the disturbing force at a centre of mass that gradient and thrust move.
        The arguments are those of `expected_momentum`, and the centre of mass (N, 3) without it.
        """
        times, R = telemetry.time, telemetry.R_WB
        dynamics = BodyDynamics.at(full, telemetry.q, 0 * telemetry.q)
        p = telemetry.p_WB + rotate(R, dynamics.p_BK)
        tide, torque = np.zeros_like(p), np.zeros_like(p)
        if self.orbit is not None:
            tide = full.mass * rotate(self.orbit.tide(times), p)
            torque = self.orbit.torque(R @ dynamics.I_K @ np.swapaxes(R, -1, -2), times)
        push = full.mass * np.array([self.disturbance.at(time)[3:] for time in times])
        rates = np.hstack([torque + cross(p, tide) + cross(p - p_WScm, push), tide])
        return np.asarray(CubicSpline(times, rates).antiderivative()(times))

    def _of_thrust(self, telemetry: Telemetry) -> NDArray[np.float64]:
        """Return the momentum (N, 6) that the burns add, integrated over the motion."""
        assert self.thrusters is not None
        times, R = telemetry.time, telemetry.R_WB
        to_W = np.zeros((len(times), 6, 6))  # from [τ; f] in B to the wrench about W's origin
        to_W[:, :3, :3] = to_W[:, 3:, 3:] = R
        to_W[:, :3, 3:] = skew(telemetry.p_WB) @ R
        integral = CubicSpline(times, to_W).antiderivative()
        ends = np.append(self.thrust.time[1:], np.inf)
        added = np.zeros((len(times), 6))
        for start, end, value in zip(self.thrust.time, ends, self.thrust.value):
            before, after = (integral(np.minimum(times, edge)) for edge in (start, end))
            added += self.thrusters.scale * (after - before) @ value
        return added


def momentum_after(
    momentum_W: NDArray[np.float64],
    p_WScm: NDArray[np.float64],
    mass: float,
    disturbance_W: NDArray[np.float64],
    time: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return total momentum and centre of mass after a time [s] with a constant disturbance.

    Newton's and Euler's laws, P' = m a, p' = P / m and L' = τ + p × m a, have a cubic polynomial
    of time as their solution, independent of how the bodies move.

    Args:
        momentum_W: (6,) total momentum [L; P] about W's origin, in W [N·m·s, N·s].
        p_WScm: (3,) p, the centre of mass of the system, in W [m].
        mass: m of the system [kg].
        disturbance_W: (6,) torque τ about this centre and its acceleration a, in W [N·m, m/s²].
        time: [s].

    """
    torque, acceleration = np.split(disturbance_W, 2)
    force, P = mass * acceleration, momentum_W[3:]
    path = p_WScm * time + (P / mass / 2 + acceleration * time / 6) * time**2  # integral of p
    added = np.concatenate([torque * time + cross(path, force), force * time])
    return momentum_W + added, p_WScm + (P / mass + acceleration * time / 2) * time


def add_external_forces(
    builder: DiagramBuilder,
    scenario: Scenario,
    spacecraft: Spacecraft,
    plant: MultibodyPlant,
    body: RigidBody,
    truth: InertialParameters,
) -> ExternalForces:
    """Add the external forces of a scenario to a Diagram, and connect them to its plant.

    Args:
        builder: the builder of the Diagram.
        scenario: the scenario.
        spacecraft: the spacecraft.
        plant: the finalized plant of spacecraft and target.
        body: the target's body in this plant.
        truth: the target.

    Raises:
        InputError: a sprung mass that its body cannot contain; also the errors of
            `Scenario.make_disturbance`.

    """
    disturbance, period = scenario.make_disturbance(), scenario.simulation.log_period
    masses = tuple(
        SprungMass.AddToBuilder(builder, plant, **vars(config))
        for config in scenario.simulation.sprung_masses
    )
    ports = [mass.GetOutputPort("spatial_forces") for mass in masses]
    if not disturbance.is_zero:
        source = DisturbanceSource.AddToBuilder(
            builder,
            spacecraft,
            plant=plant,
            disturbance=disturbance,
            moments=[mass.GetOutputPort("relative_moment") for mass in masses],
        )
        ports.append(source.GetOutputPort("spatial_forces"))
    if spacecraft.tree.normal_B is not None:
        table = TableReaction.AddToBuilder(builder, spacecraft, plant=plant)
        ports.append(table.GetOutputPort("spatial_forces"))
    suite = scenario.make_suite()
    orbit = None if suite is None else suite.orbit
    if orbit is not None:
        gradient = GravityGradient.AddToBuilder(builder, plant=plant, orbit=orbit)
        ports.append(gradient.GetOutputPort("spatial_forces"))
    scale, burns = 1 + disturbance.thrust_scale, log_of_burns(scenario.make_burns())
    thrust, thrusters = Samples(burns.time, burns.value / scale), None
    if len(thrust):
        thrusters = ThrusterSource.AddToBuilder(
            builder, spacecraft, plant=plant, log=thrust, scale=scale
        )
        ports.append(thrusters.GetOutputPort("spatial_forces"))
    if ports:
        all_forces = builder.AddSystem(ExternallyAppliedSpatialForceMultiplexer(len(ports)))
        for k, port in enumerate(ports):
            builder.Connect(port, all_forces.get_input_port(k))
        builder.Connect(all_forces.get_output_port(), plant.get_applied_spatial_force_input_port())
    moving: list[LeafSystem] = [*masses]
    if scenario.simulation.wrist is not None:
        # The spacecraft is the plant's first model, so its frames have the same indices.
        frame_C = plant.get_frame(spacecraft.capture_frame.index())
        moving.append(
            TargetDeflection.AddToBuilder(
                builder, plant, capture_frame=frame_C, body=body, target=truth
            )
        )
    logs = tuple(
        LogVectorOutput(each.GetOutputPort("relative_momentum"), builder, period) for each in moving
    )
    return ExternalForces(disturbance, masses, logs, orbit, thrusters, thrust)
