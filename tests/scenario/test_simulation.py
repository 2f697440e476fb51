"""A scenario as a Diagram: momentum is conserved, and what is simulated is identified."""

import numpy as np
import pytest

from cpid_drake import (
    HalfCosine,
    InertialParameters,
    InputError,
    JointController,
    MomentumIdentifier,
    SensorIdentifier,
    identify,
    initial_state,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.scenario.schema import ControllerConfig


class Swinging:
    """A motion that does not start at rest."""

    duration = 4.0

    def __init__(self, joints: int) -> None:
        self.amplitude = np.linspace(0.2, 0.5, joints)

    def evaluate(self, time):
        t = np.asarray(time, dtype=float)[..., None]
        w = np.linspace(0.5, 1.5, self.amplitude.size)
        a = self.amplitude
        return np.stack([a * np.sin(w * t), a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)], -2)


def test_a_motion_that_starts_moving_needs_the_right_base_twist(servicer, skewed_target):
    """With it the system has no momentum; with a base at rest it has."""
    motion = Swinging(12)
    state = initial_state(servicer, skewed_target, motion)
    columns = servicer.joint_state_columns[1]
    np.testing.assert_allclose(state[columns], motion.evaluate(0.0)[1])
    plant = servicer.make_simulation_plant(skewed_target)
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, state)
    momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
    assert np.abs(momentum).max() < 1e-11

    base = np.arange(plant.num_positions(), plant.num_positions() + 6)
    state[base] = 0.0
    plant.SetPositionsAndVelocities(context, state)
    momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
    assert np.abs(momentum).max() > 1.0


def test_a_motion_from_rest_starts_at_rest(servicer, paper_target):
    state = initial_state(servicer, paper_target, HalfCosine(np.zeros(12), np.ones(12), 5.0))
    assert not state[servicer.plant.num_positions() :].any()


@pytest.mark.parametrize("mass", [5.0, 250.0])
def test_another_target_is_identified_as_that_target(paper_scenario, mass):
    """The answer follows the truth: it is not written anywhere but in the scenario."""
    paper_scenario.target.mass = mass
    paper_scenario.target.p_CTcm_C = np.array([0.3, 0.1, -0.2])
    paper_scenario.simulation.simulator.accuracy = 1e-7
    simulation = make_simulation(paper_scenario)
    root_context = simulation.run()
    context = simulation.identifier.GetMyContextFromRoot(root_context)
    estimate = simulation.identifier.GetOutputPort("parameters").Eval(context)
    np.testing.assert_allclose(estimate, simulation.truth.to_vector(), rtol=1e-5, atol=1e-4)


def test_runs_are_repeatable_and_independent(paper_scenario):
    paper_scenario.simulation.simulator.accuracy = 1e-5
    paper_scenario.simulation.duration = 3.0
    simulation = make_simulation(paper_scenario)
    first, second = (simulation.telemetry(simulation.run()) for _ in range(2))
    np.testing.assert_array_equal(first.p_WB, second.p_WB)
    np.testing.assert_array_equal(first.q, second.q)


def test_drawing_changes_nothing(paper_scenario):
    """With a SceneGraph and Meshcat the same motion comes out."""
    from pydrake.geometry import Meshcat

    paper_scenario.simulation.simulator.accuracy = 1e-6
    paper_scenario.simulation.duration = 2.0
    plain = make_simulation(paper_scenario)
    drawn = make_simulation(paper_scenario, meshcat=Meshcat())
    ours, theirs = plain.telemetry(plain.run()), drawn.telemetry(drawn.run())
    np.testing.assert_allclose(ours.p_WB, theirs.p_WB, rtol=0, atol=1e-7)


def test_momentum_of_the_paper_case_is_conserved(paper_run):
    """At most 1e-8 N·s and N·m·s over the 10 s."""
    simulation, telemetry = paper_run.study.simulation, paper_run.study.telemetry
    P, L = total_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    assert np.linalg.norm(P, axis=1).max() < 1e-8
    assert np.linalg.norm(L, axis=1).max() < 1e-8
    assert telemetry.time[-1] == 10.0
    result = identify(simulation.spacecraft, telemetry)
    np.testing.assert_allclose(result.parameters, simulation.truth.to_vector(), atol=1e-7)


def test_the_diagram_names_its_systems(paper_scenario):
    simulation = make_simulation(paper_scenario)
    for name in ("plant", "joint_controller", "joint_motion_source", "momentum_identifier"):
        assert simulation.diagram.HasSubsystemNamed(name)


def test_a_tumbling_capture_is_identified_with_its_momentum():
    """Online, in the full simulation; the momentum stays what the scenario says."""
    scenario = load_scenario(shipped_scenario("tumbling_capture"))
    scenario.simulation.simulator.accuracy = 1e-9
    scenario.simulation.duration = 5.0
    simulation = make_simulation(scenario)
    root_context = simulation.run()
    telemetry = simulation.telemetry(root_context)
    P, L = total_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    momentum = np.tile(scenario.simulation.momentum_W, (len(telemetry), 1))
    np.testing.assert_allclose(np.hstack([L, P]), momentum, rtol=0, atol=1e-7)
    context = simulation.identifier.GetMyContextFromRoot(root_context)
    estimate = simulation.identifier.GetOutputPort("parameters").Eval(context)
    np.testing.assert_allclose(estimate, simulation.truth.to_vector(), rtol=0, atol=1e-5)
    # The paper's form, on the same data, assumes zero momentum.
    wrong = identify(simulation.spacecraft, telemetry, rows="eq18").parameters
    assert abs(wrong[0] - 100.0) > 1.0


# -- sensors -------------------------------------------------------------------------------------


def test_least_squares_goes_on_from_the_exact_state(paper_scenario):
    """Sensors are there and logged, and change nothing but the integrator's steps."""
    paper_scenario.simulation.duration = 3.0
    paper_scenario.simulation.simulator.accuracy = 1e-8
    paper_scenario.sensors.suite = "coarse"
    simulation = make_simulation(paper_scenario)
    assert isinstance(simulation.identifier, MomentumIdentifier)
    root_context = simulation.run()
    context = simulation.identifier.GetMyContextFromRoot(root_context)
    estimate = simulation.identifier.GetOutputPort("parameters").Eval(context)
    np.testing.assert_allclose(estimate, simulation.truth.to_vector(), rtol=0, atol=1e-5)
    encoders = simulation.measurements(root_context).encoders
    assert encoders.time[-1] == 3.0
    assert len(encoders) == 3 * simulation.sensors.suite.encoders.rate + 1
    truth = simulation.joint_motion.evaluate(encoders.time)[:, 0]
    error = np.abs(encoders.value - truth).max()
    assert 0 < error < 8 * simulation.sensors.suite.sigmas("encoders")[0]


def test_the_seed_is_that_of_the_sensors(paper_scenario):
    paper_scenario.simulation.duration = 0.2
    paper_scenario.simulation.simulator.accuracy = 1e-4
    paper_scenario.sensors.suite = "flight"
    gyros = []
    for seed in (1, 1, 2):
        paper_scenario.sensors.seed = seed
        simulation = make_simulation(paper_scenario)
        gyros.append(simulation.measurements(simulation.run()).gyro.value)
    np.testing.assert_array_equal(gyros[0], gyros[1])
    assert (gyros[0] != gyros[2]).all()


def test_without_sensors_there_are_no_measurements(paper_scenario):
    simulation = make_simulation(paper_scenario)
    assert simulation.sensors is None
    root_context = simulation.make_simulator().get_context()
    with pytest.raises(InputError, match=r"give sensors\.suite"):
        simulation.measurements(root_context)


def test_a_filter_without_sensors_is_refused(paper_scenario):
    """Also in a scenario that no file has been checked for."""
    paper_scenario.identification.estimator = "momentum_filter"
    with pytest.raises(InputError, match=r"momentum_filter needs sensors\.suite"):
        make_simulation(paper_scenario)
    paper_scenario.identification.estimator = "guess"
    with pytest.raises(InputError, match="no online estimator 'guess'"):
        make_simulation(paper_scenario)


def test_what_the_filter_identifies_is_drawn():
    """A recording of a run that is long enough for an estimate scales its ellipsoid."""
    from base64 import b64decode
    from re import findall

    from pydrake.geometry import Meshcat

    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite = "flight"
    scenario.identification.estimator = "momentum_filter"
    scenario.simulation.duration = 1.5
    scenario.simulation.simulator.accuracy = 1e-5
    meshcat = Meshcat()
    simulation = make_simulation(scenario, meshcat=meshcat)
    assert isinstance(simulation.identifier, SensorIdentifier)
    meshcat.StartRecording()
    simulation.run()
    meshcat.PublishRecording()
    commands = map(b64decode, findall(r"base64,([A-Za-z0-9+/=]{100,})", meshcat.StaticHtml()))
    [animation] = [command for command in commands if b"set_animation" in command]
    assert b"cpid/estimated_inertia/ellipsoid/shape" in animation


def test_a_controller_has_the_gains_and_the_sphere_of_its_scenario(servicer):
    """Its efforts are those of a controller made by hand, off the motion and in motion."""
    scenario = load_scenario(shipped_scenario("paper"))
    scenario.controller = ControllerConfig(False, 60.0, 0.7, 3.0, 0.6)
    simulation = make_simulation(scenario)
    root = simulation.diagram.CreateDefaultContext()
    state = simulation.plant.GetPositionsAndVelocities(
        simulation.plant.GetMyContextFromRoot(root)
    ).copy()
    q, v = servicer.joint_state_columns
    state[q] += 0.1
    state[v] -= 0.2
    simulation.plant.SetPositionsAndVelocities(
        simulation.plant.GetMyMutableContextFromRoot(root), state
    )
    system = simulation.diagram.GetSubsystemByName("joint_controller")
    found = system.GetOutputPort("generalized_force").Eval(system.GetMyContextFromRoot(root))

    sphere = InertialParameters(60.0, np.zeros(3), 0.4 * 60.0 * 0.7**2 * np.eye(3))
    model = servicer.make_simulation_plant(sphere)
    by_hand = JointController(servicer, model, natural_frequency=3.0, damping_ratio=0.6)
    context = by_hand.CreateDefaultContext()
    desired = simulation.joint_motion.evaluate(0.0).ravel()
    by_hand.GetInputPort("state").FixValue(context, state)
    by_hand.GetInputPort("desired_motion").FixValue(context, desired)
    np.testing.assert_allclose(
        found, by_hand.GetOutputPort("generalized_force").Eval(context), rtol=1e-12, atol=1e-12
    )
    assert np.abs(found).max() > 1.0
