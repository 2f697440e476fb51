"""The Drake Diagram of a scenario, and the telemetry of its runs."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, OutputPort
from pydrake.systems.primitives import LogVectorOutput, MatrixGain, VectorLogSink

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import package_folders, resolve_model
from cpid_drake.identification.checks import Check
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.result import Identification
from cpid_drake.identification.words import THRUST_NOT_USED
from cpid_drake.logs.log import THRUST, Log, Samples
from cpid_drake.simulation.burns import log_of_burns
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.external_forces import ExternalForces
from cpid_drake.systems.identifier import Identifier
from cpid_drake.systems.joint_controller import JointController
from cpid_drake.systems.joint_trajectory import JointTrajectory
from cpid_drake.systems.momentum_identifier import MomentumIdentifier
from cpid_drake.systems.plant_state import spacecraft_state
from cpid_drake.systems.sensor_identifier import SensorIdentifier
from cpid_drake.systems.spacecraft_sensors import (
    SpacecraftSensors,
    log_samples,
    measurements_from_logs,
)


@dataclass(frozen=True, eq=False)
class Simulation:
    """A scenario's Diagram and its systems.

    All state is in a Context: one Simulation serves any number of runs, each with its own Context.

    Attributes:
        scenario: the scenario.
        spacecraft: the spacecraft model.
        truth: the target in the simulated plant.
        joint_motion: the prescribed motion.
        diagram: the whole diagram.
        plant: spacecraft and target, in zero gravity.
        state_columns: columns of the plant's x = [q; v] that are the state of the spacecraft.
        identifier: the online identifier: a `MomentumIdentifier` on the plant's exact state, or a
            `SensorIdentifier` on the sensors.
        state_log: logs the state of the plant.
        thrust: the log of the burns, with the error of its scale; empty without burns.
        impulse_log: logs the momentum that forces from outside give; None without any.
        sensors: the scenario's sensors, if it has any.
        sensor_logs: log the sensors' samples, by name.

    """

    scenario: Scenario
    spacecraft: Spacecraft
    truth: InertialParameters
    joint_motion: JointMotion
    diagram: Diagram
    plant: MultibodyPlant
    state_columns: NDArray[np.intp]
    identifier: Identifier
    state_log: VectorLogSink
    thrust: Samples
    impulse_log: VectorLogSink | None
    sensors: SpacecraftSensors | None = None
    sensor_logs: dict[str, VectorLogSink] = field(default_factory=dict)

    @property
    def left_out(self) -> tuple[str, ...]:
        """What of the joint motion the simulation leaves out, in words."""
        motion, end = self.joint_motion.duration, self.scenario.simulation.duration
        if motion <= end:
            return ()
        return (
            f"the joint motion takes {motion:g} s, and simulation.duration is {end:g} s: the last "
            f"{motion - end:g} s of the motion are left out",
        )

    def make_simulator(self) -> Simulator:
        """Return an initialized Simulator at t = 0, with the scenario's motion and momentum."""
        simulator = Simulator(self.diagram)
        settings = vars(self.scenario.simulation.simulator)
        ApplySimulatorConfig(SimulatorConfig(**settings), simulator)
        context = self.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        momentum_W = self.scenario.simulation.momentum_W
        state = self.plant.GetPositionsAndVelocities(context).copy()  # with relaxed springs
        state[self.state_columns] = self.spacecraft.initial_state(
            self.truth, self.joint_motion, momentum_W
        )
        self.plant.SetPositionsAndVelocities(context, state)
        simulator.Initialize()
        return simulator

    def run(
        self,
        monitor: Callable[[Context], EventStatus | None] = lambda context: None,
        realtime_rate: float = 0.0,
    ) -> Context:
        """Simulate the scenario's duration; return the root Context with the logs and the estimate.

        Args:
            monitor: called with the root Context after every step; may end the run as a monitor of
                Drake's Simulator does.
            realtime_rate: ratio of simulated to real time; 0 for as fast as possible.

        Raises:
            InputError: the motion is too fast for the simulation.

        """
        return self.run_sampled([], monitor, realtime_rate)[0]

    def run_sampled(
        self,
        times: ArrayLike,
        monitor: Callable[[Context], EventStatus | None] = lambda context: None,
        realtime_rate: float = 0.0,
    ) -> tuple[Context, Motion]:
        """Simulate as `run` does; also return the telemetry at increasing times (N,) [s]."""
        times = np.asarray(times, dtype=float)
        simulator = self.make_simulator()
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.set_monitor(monitor)
        root_context, states = simulator.get_context(), []
        for time in [*times, self.scenario.simulation.duration]:
            try:
                simulator.AdvanceTo(time)
            except RuntimeError as error:
                now = root_context.get_time()
                raise InputError(f"the simulation fails at t = {now:.6g} s: {error}") from error
            states.append(self.state(root_context))
        simulator.AdvancePendingEvents()  # the samples that are due at the end
        self.identifier.Finish(simulator.get_mutable_context())
        sampled = self.spacecraft.to_motion(times, np.array(states)[:-1])
        return root_context.Clone(), sampled

    def state(self, root_context: Context) -> Array:
        """Return the state x = [q; v] of the spacecraft at the present time of a run."""
        context = self.plant.GetMyContextFromRoot(root_context)
        state = self.plant.GetPositionsAndVelocities(context)[self.state_columns]
        return np.asarray(state)

    def identification(self, root_context: Context) -> Identification:
        """Return the identification in a run's Context, with its checks; see `checks`."""
        context = self.identifier.GetMyContextFromRoot(root_context)
        answer = checked(self.identifier.identification(context), self.spacecraft.tree)
        if not len(self.thrust) or isinstance(self.identifier, SensorIdentifier):
            return answer
        text = THRUST_NOT_USED.format(f"{self.thrust.time[0]:.4g}", answer.estimator)
        return replace(answer, checks=(Check("thrust", text), *answer.checks))

    def motion(self, root_context: Context) -> Motion:
        """Return the logged motion of a run."""
        times, states = _entries(self.state_log, root_context)
        return self.spacecraft.to_motion(times, states[:, self.state_columns])

    def momentum(self, root_context: Context) -> Array:
        """Return the momentum [L; P] of all bodies about W's origin, in W, (N, 6), in the log."""
        context = self.plant.CreateDefaultContext()
        momenta = []
        for state in _entries(self.state_log, root_context)[1]:
            self.plant.SetPositionsAndVelocities(context, state)
            momentum = self.plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
            momenta.append(momentum.get_coeffs())
        return np.array(momenta)

    def expected_momentum(self, root_context: Context) -> Array:
        """Return what `momentum` should be (N, 6): that at the start, and what forces gave."""
        momentum_W = self.scenario.simulation.momentum_W
        if self.impulse_log is None:
            return np.tile(momentum_W, (len(_entries(self.state_log, root_context)[0]), 1))
        return momentum_W + _entries(self.impulse_log, root_context)[1]

    def log(self, root_context: Context) -> Log:
        """Return the samples of the sensors in a run, and the log of thrust if there is one.

        Raises:
            InputError: the scenario has no sensors.

        """
        if self.sensors is None:
            raise InputError(
                "this simulation has no sensors; give sensors.suite or sensors.explicit in its "
                "scenario"
            )
        log = measurements_from_logs(self.sensors, self.sensor_logs, root_context)
        if not len(self.thrust) or not self.scenario.simulation.burns_logged:
            return log
        return log.updated({THRUST: self.thrust})


def make_simulation(scenario: Scenario, *, target: InertialParameters | None = None) -> Simulation:
    """Build a scenario's Diagram: motion, controller, plant, identifier, logs.

    If the scenario has sensors, the Diagram contains and logs them. The recursive fit reads
    them; least squares reads the plant's exact state.

    Args:
        scenario: the scenario.
        target: simulate this target instead of the scenario's true one.

    Raises:
        InputError: something in the scenario cannot be built; the message names it.

    """
    spacecraft = scenario.spacecraft.make()
    if scenario.target.visual_model is not None:  # its path is checked, although nothing is drawn
        resolve_model(scenario.target.visual_model, package_folders(scenario.spacecraft.packages))
    truth = target or scenario.target_truth()
    motion = scenario.make_joint_motion(spacecraft)

    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    plant.set_name("plant")
    wrist = scenario.simulation.wrist
    grasp = MultibodyPlant.WeldFrames if wrist is None else wrist.connect

    def connect(plant: MultibodyPlant, frame_C: Frame, frame_T: Frame) -> None:
        grasp(plant, frame_C, frame_T)
        for mass in scenario.simulation.sprung_masses:
            mass.add_to(plant)

    spacecraft.add_to(plant, truth, connect=connect)
    state = spacecraft_state(builder, spacecraft, plant.get_state_output_port())

    source, config = builder.AddSystem(JointTrajectory(motion).source()), scenario.controller
    mass, moment = config.nominal_mass, 0.4 * config.nominal_mass * config.nominal_radius**2
    sphere = InertialParameters(mass, np.zeros(3), moment * np.eye(3))
    sensors, sensor_logs, suite = None, {}, scenario.make_suite()
    forces, thrust = _add_forces(builder, scenario, spacecraft, plant)
    spatial_forces = None
    if forces is not None and config.has_target_model and not scenario.simulation.sprung_masses:
        spatial_forces = forces.GetOutputPort("spatial_forces")
    controller = JointController.AddToBuilder(
        builder,
        spacecraft,
        state=plant.get_state_output_port(),
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=truth if config.has_target_model else sphere,
        connect=grasp,
        plant=plant,
        natural_frequency=config.natural_frequency,
        damping_ratio=config.damping_ratio,
        spatial_forces=spatial_forces,
    )
    if suite is not None:
        sensors = SpacecraftSensors.AddToBuilder(
            builder,
            spacecraft,
            state=state,
            suite=suite,
            seed=scenario.sensors.seed,
            **_flexible(builder, scenario, spacecraft, plant, controller),
        )
        sensor_logs = log_samples(builder, sensors)
    logged = {}
    if len(thrust) and forces is not None and scenario.simulation.burns_logged:
        logged[THRUST] = forces.GetOutputPort("thrust")
    identifier = _add_identifier(builder, scenario, spacecraft, state, sensors, logged)

    def log(port: OutputPort) -> VectorLogSink:
        return LogVectorOutput(port, builder, scenario.simulation.log_period)

    state_log = log(plant.get_state_output_port())
    impulse_log = forces and log(forces.GetOutputPort("impulse"))
    diagram = builder.Build()
    diagram.set_name("cpid")
    return Simulation(
        scenario,
        spacecraft,
        truth,
        motion,
        diagram,
        plant,
        spacecraft.columns_in(plant),
        identifier,
        state_log,
        thrust,
        impulse_log,
        sensors,
        sensor_logs,
    )


def _flexible(
    builder: DiagramBuilder,
    scenario: Scenario,
    spacecraft: Spacecraft,
    plant: MultibodyPlant,
    controller: JointController,
) -> dict[str, Any]:
    """Return what the sensors need if the joints are flexible: compliance and efforts."""
    compliance = 1e-6 * scenario.simulation.joint_compliance_urad
    if not compliance:
        return {}
    v = spacecraft.columns_in(plant)[spacecraft.joint_columns[1]] - plant.num_positions()
    gain = spacecraft.coupling.A.T @ np.eye(plant.num_velocities())[v]
    efforts = builder.AddSystem(MatrixGain(gain))
    efforts.set_name("joint_efforts")
    builder.Connect(controller.GetOutputPort("generalized_force"), efforts.get_input_port())
    return {"joint_compliance": compliance, "efforts": efforts.get_output_port()}


def _add_identifier(
    builder: DiagramBuilder,
    scenario: Scenario,
    spacecraft: Spacecraft,
    state: OutputPort,
    sensors: SpacecraftSensors | None,
    thrust: dict[str, OutputPort],
) -> Identifier:
    config = scenario.identification
    momentum = TotalMomentum.named(config.momentum)
    estimator = scenario.online_estimator
    if sensors is None or estimator == "least_squares":
        return MomentumIdentifier.AddToBuilder(
            builder,
            spacecraft,
            state=state,
            rows=config.rows or "standard",
            momentum=momentum,
            period=config.period,
            offset=config.offset,
        )
    prior = config.prior
    return SensorIdentifier.AddToBuilder(
        builder,
        spacecraft,
        **sensors.sample_ports(),
        **thrust,
        suite=sensors.suite,
        momentum=momentum,
        known_bodies=scenario.body_uncertainty(),
        prior=None if prior is None else prior.prior("the scenario's prior"),
    )


def _add_forces(
    builder: DiagramBuilder, scenario: Scenario, spacecraft: Spacecraft, plant: MultibodyPlant
) -> tuple[ExternalForces | None, Samples]:
    """Add the forces from outside, if there are any; return them and the log of thrust."""
    disturbance, suite = scenario.make_disturbance(), scenario.make_suite()
    orbit = None if suite is None else suite.orbit
    scale, burns = 1 + disturbance.thrust_scale, log_of_burns(scenario.simulation.burns)
    thrust = Samples(burns.time, burns.value / scale)
    on_table = spacecraft.tree.normal_B is not None
    if disturbance.is_zero and orbit is None and not len(thrust) and not on_table:
        return None, thrust
    forces = ExternalForces(
        spacecraft,
        plant,
        disturbance=disturbance,
        orbit=orbit,
        thrust=thrust,
        thrust_scale=scale,
    )
    ports = {"spatial_forces": plant.get_applied_spatial_force_input_port()}
    return forces.connected(builder, state=plant.get_state_output_port(), **ports), thrust


def _entries(sink: VectorLogSink, root_context: Context) -> tuple[Array, Array]:
    """Return the times (N,) and values (N, n) of a log, each time once."""
    log = sink.FindLog(root_context)
    times, first = np.unique(log.sample_times(), return_index=True)
    return times, log.data()[:, first].T
