"""Errors that the sensors do not declare are named from several logs, and on a table."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from planar_cases import SUITE, TARGET, planar_craft
from planar_cases import errors as planar_errors
from planar_cases import motion as planar_motion
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, small_craft

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.identify import identify, identify_together
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise

PUSH = np.array([1e-3, -5e-4, 0.0])


def pushed(log: Measurements, times: float = 1.0) -> Measurements:
    """Return a log with the motion under a steady acceleration in the plane."""
    position = log.position
    way = 0.5 * position.time[:, None] ** 2 * PUSH * times
    return log.updated({"position": replace(position, value=position.value + way)})


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A spacecraft on a table whose normal is no axis of C."""
    return planar_craft(tmp_path_factory.mktemp("planar"), grip_rpy="0.4 -0.3 0.7")


@pytest.fixture(scope="module")
def logs(craft, skewed_target):
    """Two clean logs."""
    motions = (Sines.drawn(4, seed=seed, duration=10.0, size=0.6) for seed in (101, 102))
    suite = coarse_suite()
    return [
        add_noise(suite, measured(craft, motion, skewed_target, suite), seed=10)
        for motion in motions
    ]


@pytest.mark.slow
def test_clean_logs_show_no_errors(craft, logs):
    found = identify_together(craft, dict(zip("ab", logs)), sensors=coarse_suite())
    assert found.passed
    assert found.undeclared.effects == ()


@pytest.mark.slow
def test_a_force_is_named_with_its_log(craft, logs, skewed_target):
    mixed = {"a": logs[0], "b": pushed(logs[1])}
    found = identify_together(craft, mixed, sensors=coarse_suite())
    undeclared = found.undeclared
    [effect] = undeclared.effects
    assert (effect.name, effect.log) == ("acceleration", "b")
    assert (np.abs(effect.value - PUSH) < 4 * effect.sigma).all()
    assert effect.describe().endswith("during b")
    assert undeclared.declaration == ("disturbances: {acceleration: 0.001}",)
    assert undeclared.is_proposed
    assert any("do not declare: an external acceleration" in text for text in found.warnings)
    assert found.failures == ()
    error = found.parameters - skewed_target.to_vector()
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-3, 10)


@pytest.mark.slow
def test_a_force_is_named_beside_a_momentum_that_is_right(craft, logs, skewed_target):
    """The momentum is zero at the start: the samples of a steady force do not contradict it."""
    options = {"sensors": coarse_suite(), "momentum": TotalMomentum.zero()}
    found = identify(craft, pushed(logs[1], 2.0), **options)
    [effect] = found.undeclared.effects
    assert effect.name == "acceleration"
    assert (np.abs(effect.value - 2 * PUSH) < 4 * effect.sigma).all()
    assert found.undeclared.is_proposed
    assert found.momentum == "zero"
    assert found.failures == ()
    error = found.parameters - skewed_target.to_vector()
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-3, 10)


@pytest.mark.slow
def test_a_tumble_said_to_have_no_momentum_shows_no_other_error(craft, skewed_target):
    suite = coarse_suite()
    motion = Sines.drawn(4, seed=101, duration=10.0, size=0.6)
    log = add_noise(suite, measured(craft, motion, skewed_target, suite, MOMENTUM / 10), seed=10)
    found = identify(craft, log, sensors=suite, momentum=TotalMomentum.zero())
    assert "contradict a total momentum of zero" in found.failures[0]
    assert found.undeclared.effects == ()


@pytest.mark.slow
def test_an_error_of_a_sensor_on_a_table_is_named(table):
    """A delay so large that nothing explains some blocks without it."""
    suite = deepcopy(SUITE)
    suite.attitude.delay_ms = 30.0
    log = add_noise(suite, measured(table.on_table(), planar_motion(), TARGET, suite), 5)
    found = identify(table, log, sensors=SUITE, planar=True)
    [effect] = found.undeclared.effects
    assert effect.name == "attitude.delay"
    delay = 1e3 * SensorNoise(suite, 5).constants("attitude").delay
    assert abs(effect.value[0] - delay) < 4 * effect.sigma[0]
    assert found.undeclared.is_proposed
    assert any("the result includes it" in text for text in found.warnings)
    assert found.failures == ()
    assert abs(planar_errors(found)[0]) < 4  # the mass


@pytest.mark.slow
def test_a_clean_log_on_a_table_shows_no_errors(table):
    log = add_noise(SUITE, measured(table.on_table(), planar_motion(), TARGET, SUITE), 4)
    found = identify(table, log, sensors=SUITE, planar=True)
    assert found.passed
    assert found.undeclared.effects == ()
