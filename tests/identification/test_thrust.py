"""Logs with thrust: the target is found with intervals that hold; unlogged thrust is noticed."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import SUITE, planar_craft
from planar_cases import TARGET as PLANAR_TARGET
from planar_cases import errors as planar_errors
from planar_cases import motion as planar_motion

from cpid_drake import TargetPrior, identify, load_scenario, shipped_scenario
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.propagation import Wrench, propagate
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.validation import validate
from cpid_drake.logs.log import THRUST, Samples, ideal_log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.thrusters import Thrusters, Valve
from cpid_drake.simulation.burns import Burn, log_of_burns
from cpid_drake.simulation.trials import draw, ideal_samples, make_case

BURNS = [
    Burn(3.1, 1.3, np.array([0.6, -0.4, 0.3]), np.array([0.2, 0.15, -0.1])),
    Burn(5.0, 0.4, torque_B=np.array([0.0, 0.1, -0.1])),
]


class Flight:
    """A simulated motion with burns, its sensors and its target."""

    def __init__(self, scenario, preset, burns, scale=0.02, momentum=(0.0,) * 6):
        config = load_scenario(shipped_scenario(scenario))
        config.simulation.momentum_W = np.array(momentum)
        config.simulation.burns = burns
        self.suite = load_sensors(preset, unstated="exact")
        self.suite.disturbances = Disturbances(thrust_scale=scale)
        self.craft = config.spacecraft.make()
        self.target = config.target_truth().to_vector()
        self.case = make_case(config, self.craft, config.target_truth(), self.suite, 11)
        self.log = draw(self.case, self.craft, 0)

    def identify(self, log, **options):
        return identify(self.craft, log, sensors=self.suite, **options)

    def errors(self, found):
        """Return the errors of all parameters in units of their σ."""
        return (found.parameters - self.target) / np.sqrt(np.diag(found.covariance))


@pytest.fixture(scope="module")
def flight():
    return Flight("free_flyer_payload", "testbed", BURNS)


@pytest.fixture(scope="module")
def found(flight):
    return flight.identify(flight.log)


def test_the_target_and_the_scale_are_found(flight, found):
    """Nothing is doubted, no change of momentum is found, and kicks of thrusters are no noise."""
    assert found.failures == ()
    assert len(found.momentum_changes) == 0
    assert found.warnings == ()
    assert np.abs(flight.errors(found)).max() < 3.5
    [scale] = [effect for effect in found.effects if effect.name == "thrust_scale"]
    true = BURNS[0].force_B[0] / flight.log.thrust.value[0, 3] - 1
    assert abs(scale.value[0] - 100 * true) < 3.5 * scale.sigma[0]
    assert scale.sigma[0] < 0.5
    assert "the true thrust differs" in scale.describe()


def test_thrust_that_is_logged_several_times_is_counted_and_does_no_harm(flight, found):
    thrust = flight.log.thrust
    rows = np.repeat(np.arange(len(thrust)), 3)
    again = flight.identify(flight.log.updated({THRUST: thrust.where(rows)}))
    assert again.rejected == {**found.rejected, THRUST: 2 * len(thrust)}
    assert again.failures == ()
    np.testing.assert_array_equal(again.parameters, found.parameters)


def test_a_fit_starts_with_what_declared_thrust_tells(flight):
    """Mass and moments of inertia within a tenth."""
    model = Model(flight.craft.tree, flight.suite)
    values, _ = start_of(model, [LogState.of(model, flight.log)])
    form = relative_parameterization(model.mass)
    places = [0, 4, 5, 6]
    found = form.to_parameters(values[PSI])[places]
    np.testing.assert_allclose(found, flight.target[places], rtol=0.1)


@pytest.mark.slow
def test_a_forgotten_momentum_is_estimated_in_a_log_with_thrust():
    """Its estimate is the momentum at the start: a burn changes it soon."""
    momentum = 0.005 * np.array([0.6, -0.8, 0.5, 0.0, 0.0, 0.0])
    burns = [replace(BURNS[0], time=0.1)]
    case = Flight("free_flyer_payload", "testbed", burns, momentum=momentum)
    found = case.identify(case.log)
    assert found.momentum == "unknown"
    assert found.failures == ()
    assert any("contradict a total momentum of zero" in warning for warning in found.warnings)
    assert np.abs(case.errors(found)).max() < 3.5
    sigma = np.sqrt(np.diag(found.momentum_covariance))
    assert (np.abs(found.momentum_estimate - momentum) < 4 * sigma).all()


@pytest.mark.slow
def test_valves_that_stay_closed_change_nothing():
    """Forces err only where there are some."""
    idle = Flight("free_flyer_payload", "testbed", [])
    closed = Samples(np.array([0.0]), np.zeros((1, 1)))
    expected = identify(idle.craft, idle.log, sensors=replace(idle.suite, disturbances=None))
    suite = replace(idle.suite, disturbances=None, thrusters=Thrusters({"left": Valve()}))
    found = identify(idle.craft, idle.log.updated({"valve:left": closed}), sensors=suite)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    assert found.warnings == expected.warnings


@pytest.mark.slow
def test_a_scale_that_is_not_stated_is_estimated(flight):
    """Nobody knows the scale of a log of thrust exactly."""
    silent = replace(flight.suite, disturbances=None, unstated=None)
    found = identify(flight.craft, flight.log, sensors=silent)
    assert found.failures == ()
    [scale] = [effect for effect in found.effects if effect.name == "thrust_scale"]
    true = BURNS[0].force_B[0] / flight.log.thrust.value[0, 3] - 1
    assert abs(scale.value[0] - 100 * true) < 3.5 * scale.sigma[0]
    assert np.abs(flight.errors(found)).max() < 3.5


@pytest.mark.slow
def test_a_log_of_the_wrong_sign_is_noticed(flight):
    """Axes or signs of thrusters that are not those of the base contradict the motion."""
    log = flight.log.thrust
    turned = flight.log.updated({THRUST: Samples(log.time, -log.value)})
    found = flight.identify(turned)
    assert len(found.momentum_changes) or found.failures


@pytest.mark.slow
def test_an_exact_log_is_fitted_exactly(flight):
    """The thrust switches between samples, which are exact to 1e-8; so it is without thrust."""
    case = replace(flight.case, suite=load_sensors("ideal"))
    exact = ideal_samples(case, flight.craft.tree, flight.craft.joint_names)
    found = identify(flight.craft, exact, sensors=case.suite)
    np.testing.assert_allclose(found.parameters, flight.target, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_many_pulses_are_no_noise():
    """Fifteen in six seconds: the thrust is never steady for long."""
    force, point = np.array([4.0, -3.0, 2.0]), np.array([0.5, 0.4, -0.6])
    pulses = [Burn(1.0 + 0.4 * k, 0.05, force, point) for k in range(15)]
    flight = Flight("exciting_motion", "flight", pulses)
    found = flight.identify(flight.log)
    assert not any("noise" in text for text in (*found.warnings, *found.failures))
    assert np.abs(flight.errors(found)).max() < 3.5


@pytest.mark.slow
def test_a_log_with_thrust_is_predicted(flight):
    """The rest of a log follows from its beginning, the target and the thrust."""
    target = TargetPrior("the target", flight.target, np.diag((1e-3 * np.ones(10)) ** 2))
    options = {"sensors": flight.suite, "momentum": TotalMomentum.zero()}
    found = validate(flight.craft, target, flight.log, **options)
    assert found.is_target_right
    burn, mass = BURNS[0], flight.craft.mass + flight.target[0]
    speed = burn.duration * np.linalg.norm(burn.force_B) / mass
    pushed = 1e3 * speed * (found.end - burn.time - burn.duration)
    [position] = [error for error in found.errors if error.sensor == "position"]
    assert pushed > 100
    assert position.rms < pushed / 20


@pytest.mark.slow
def test_thrusters_on_a_table(tmp_path):
    """Force in the plane and torque about its normal push; the table holds the rest."""
    craft = planar_craft(tmp_path)
    burn = Burn(4.03, 2.0, np.array([0.5, -0.3, 2.0]), torque_B=np.array([0.5, 0.5, 0.12]))
    suite = replace(SUITE, disturbances=Disturbances(thrust_scale=0.05))

    def motion_of(times):
        table, joints = craft.on_table().tree, planar_motion()
        thrust = log_of_burns([burn])
        base = propagate(
            table, joints, PLANAR_TARGET.to_standard_vector(), times, edges=thrust.time,
            wrench=lambda time: Wrench(constant_B=thrust.held_at(time)),
        )  # fmt: skip
        return base.to_motion(craft.joint_names, times, joints)

    ideal = ideal_log(suite, craft.joint_names, motion_of, planar_motion().duration)
    log = add_noise(suite, ideal.updated({THRUST: log_of_burns([burn])}), 0)
    found = identify(craft, log, sensors=suite, planar=True)
    assert found.failures == ()
    assert len(found.momentum_changes) == 0
    assert np.abs(planar_errors(found)).max() < 3.5
