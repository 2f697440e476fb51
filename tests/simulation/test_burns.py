"""Burns of thrusters in a Diagram: the momentum they add, their log, and what is identified."""

from dataclasses import replace

import numpy as np
import pytest
from flyer_cases import MOVING, payload

from cpid_drake import identify, make_simulation
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.simulated_disturbance import SimulatedDisturbance
from cpid_drake.simulation.burns import Burn
from cpid_drake.simulation.scenario import DisturbanceConfig
from cpid_drake.simulation.trials import base_trajectory, draw, ideal_samples, make_case

FORCE, POINT, TORQUE = (
    np.array([0.2, -0.1, 0.1]),
    np.array([0.1, 0.2, -0.1]),
    np.array([0, 0.01, 0]),
)
SCALE = 0.3


def with_burn(duration=3.0):
    burns = [Burn(0.73, 1.1, FORCE, POINT, TORQUE)]
    scenario = payload(duration, 1e-9, momentum_W=MOVING, burns=burns)
    suite = load_sensors("testbed")
    suite.disturbances = Disturbances(thrust_scale=SCALE)
    scenario.sensors.suite, scenario.sensors.explicit = "", suite
    scenario.identification.momentum = "unknown"
    return scenario


@pytest.fixture(scope="module")
def run():
    scenario = with_burn()
    scenario.simulation.disturbance = DisturbanceConfig(np.array([4e-3, -3e-3, 2e-3]))
    simulation = make_simulation(scenario)
    return simulation, simulation.run()


def test_the_plant_gets_the_momentum_of_the_burn(run):
    """Its force times its length, and the moment of the force at its point."""
    simulation, context = run
    telemetry = simulation.motion(context)
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    expected = simulation.expected_momentum(context)
    np.testing.assert_allclose(np.hstack([L, P]), expected, rtol=0, atol=2e-6)
    mass = simulation.spacecraft.mass + simulation.truth.mass
    push = mass * simulation.scenario.simulation.disturbance.acceleration_W * 3.0
    added = np.linalg.norm(P[-1] - P[0] - push)
    np.testing.assert_allclose(added, 1.1 * np.linalg.norm(FORCE), rtol=1e-2)


def test_the_base_moves_as_momentum_says(run):
    """The plant's base, and that of the trials, whose momentum is integrated without a plant."""
    simulation, context = run
    telemetry, scenario = simulation.motion(context), simulation.scenario
    case = make_case(scenario, simulation.spacecraft, simulation.truth, scenario.make_suite(), 0)
    base = base_trajectory(case, simulation.spacecraft.tree, telemetry.time)
    np.testing.assert_allclose(telemetry.p_WB, base.p_WB, rtol=0, atol=1e-8)
    still = base_trajectory(replace(case, burns=()), simulation.spacecraft.tree, telemetry.time)
    assert np.abs(base.p_WB - still.p_WB).max() > 1e-2


def test_the_log_has_the_error_of_its_scale(run):
    """The seed determines it; the true thrust is the logged one times one plus the error."""
    simulation, context = run
    log = simulation.log(context).thrust
    noise = simulation.sensors.noise
    error = SimulatedDisturbance(noise.suite.disturbances, noise.seed).thrust_scale
    assert 0.01 < abs(error) < 4 * SCALE
    np.testing.assert_allclose(log.time, [0.73, 0.73 + 1.1])
    torque = TORQUE + np.cross(POINT, FORCE)
    np.testing.assert_allclose((1 + error) * log.value[0], [*torque, *FORCE])
    assert not log.value[1].any()


def test_trials_draw_the_error_of_the_scale():
    scenario = with_burn()
    craft, suite = scenario.spacecraft.make(), scenario.make_suite()
    case = make_case(scenario, craft, scenario.target_truth(), suite, 5)
    ideal = ideal_samples(case, craft.tree, craft.joint_names)
    sizes = [draw(case, craft, k).thrust.value[0, 3] / FORCE[0] for k in range(2)]
    assert sizes[0] != sizes[1]
    np.testing.assert_allclose(ideal.thrust.value[0, 3:], FORCE)
    scenario.simulation.burns_logged = False
    case = make_case(scenario, craft, scenario.target_truth(), suite, 5)
    assert not len(ideal_samples(case, craft.tree, craft.joint_names).thrust)


@pytest.mark.slow
def test_online_and_offline_identify_with_the_log_of_the_burn():
    """No change of momentum is found; without the log there is one, or a doubt."""
    suspicions = {}
    for logged in (True, False):
        scenario = with_burn(8.0)
        scenario.simulation.simulator.accuracy = 1e-7
        scenario.simulation.burns[0].force_B = 4 * FORCE
        scenario.simulation.burns_logged = logged
        scenario.identification.rows, scenario.identification.estimator = None, "recursive_fit"
        simulation = make_simulation(scenario)
        context = simulation.run()
        online = simulation.identification(context)
        offline = identify(
            simulation.spacecraft,
            simulation.log(context),
            estimator="recursive_fit",
            sensors=scenario.make_suite(),
            momentum=TotalMomentum.unknown(),
        )
        both = (online, offline)
        suspicions[logged] = [len(f.momentum_changes) + len(f.failures) for f in both]
        if logged:
            np.testing.assert_allclose(online.parameters, offline.parameters, rtol=1e-6, atol=1e-6)
            error = online.parameters - simulation.truth.to_vector()
            assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(online.covariance)))
    assert suspicions[True] == [0, 0]
    assert min(suspicions[False]) >= 1


@pytest.mark.slow
def test_an_estimator_without_thrust_is_doubted():
    scenario = with_burn(1.0)
    scenario.simulation.simulator.accuracy = 1e-4
    scenario.identification.estimator = "least_squares"
    simulation = make_simulation(scenario)
    context = simulation.run()
    assert "does not use the log of thrust" in simulation.identification(context).failures[0]
    found = identify(simulation.spacecraft, simulation.log(context), rows="standard")
    assert "thrusters fired from 0.73 s on" in found.failures[0]
