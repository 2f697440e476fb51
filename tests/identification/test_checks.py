"""Checks fail where the answer cannot be right, and say so where they cannot run."""

from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import TotalMomentum, identify
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import Gyro, VectorSensor

ZERO = TotalMomentum.zero()
FAST_GYRO = Gyro(50.0, 0.005, 1.0, 0.1)
FITS = ("trajectory_fit", "recursive_fit")


@pytest.fixture(scope="module")
def log(craft, skewed_target):
    """Return a function from true sensors and a duration to a noisy log, and one without noise."""

    def make(suite, duration):
        motion = Sines.drawn(4, seed=101, duration=duration, size=0.6)
        ideal = measured(craft, motion, skewed_target, suite)
        return add_noise(suite, ideal, seed=4), ideal

    return make


def test_a_sensor_that_nothing_explains_fails_a_check(craft, log):
    """The attitude is random: no other motion would help."""
    suite = coarse_suite()
    samples, _ = log(suite, 1.2)
    attitude = samples.attitude
    value = np.random.default_rng(1).standard_normal(attitude.value.shape)
    value /= np.linalg.norm(value, axis=1)[:, None]
    spoiled = samples.updated({"attitude": replace(attitude, value=value)})
    found = identify(craft, spoiled, sensors=suite)
    assert not found.passed
    assert "larger angles" not in found.explain()


@pytest.mark.parametrize("estimator", FITS)
def test_a_position_with_a_slow_error_fails_a_check(craft, log, estimator):
    """A wave of 1.5 mm with a period of 3 s in place of white noise of 1 mm; no χ² sees it."""
    suite = coarse_suite(gyro=FAST_GYRO, position=VectorSensor(10.0, 1e-3))
    samples, ideal = log(suite, 8.0)
    time = ideal.position.time[:, None]
    wave = 1.5e-3 * np.sin(2 * np.pi * time / 3.0 + np.arange(3))
    position = replace(ideal.position, value=ideal.position.value + wave)
    spoiled = samples.updated({"position": position})
    found = identify(craft, spoiled, sensors=suite, estimator=estimator)
    assert np.isfinite(found.parameters).all()
    assert any("correlated from sample to sample (+0.9" in failure for failure in found.failures)


@pytest.mark.parametrize(("factor", "is_trusted"), [(3.0, True), (6.0, False)])
def test_noise_of_three_times_the_given_one_passes_and_of_six_times_fails_a_check(
    craft, log, factor, is_trusted
):
    suite = coarse_suite(gyro=FAST_GYRO)
    samples, _ = log(replace(suite, position=VectorSensor(5.0, factor * 1e-3)), 5.0)
    found = identify(craft, samples, sensors=suite)
    assert found.passed == is_trusted
    text = "the noise is larger than the sensors' file declares: that of the position"
    assert any(failure.startswith(text) for failure in found.failures) != is_trusted


def test_a_log_read_with_much_better_sensors_names_the_noise_and_nothing_else(craft, log):
    suite = coarse_suite(gyro=Gyro(50.0, 0.05, 1.0, 0.1), position=VectorSensor(5.0, 1e-2))
    samples, _ = log(suite, 3.0)
    better = coarse_suite(gyro=FAST_GYRO)
    found = identify(craft, samples, sensors=better, momentum=ZERO)
    assert all(text in " ".join(found.failures) for text in ("angular velocity", "position"))
    assert "noise is larger than the sensors' file declares" in found.failures[0]
    said = " ".join((*found.failures, *found.warnings))
    assert not any(word in said for word in ("most likely", "body", "lever arm", "includes it"))
    assert not found.undeclared.effects


@pytest.mark.slow
def test_an_error_that_may_act_is_said_also_where_the_noise_is_larger_than_given(craft, log):
    suite = coarse_suite(gyro=FAST_GYRO)
    hidden = replace(
        suite, position=VectorSensor(5.0, 2.5e-3), gyro=replace(FAST_GYRO, scale_ppm=60.0)
    )
    samples, _ = log(hidden, 6.0)
    found = identify(craft, samples, sensors=suite, momentum=ZERO)
    assert found.passed
    assert found.noise["position"] > 1.5
    assert found.undeclared.suspected or found.undeclared.effects
    for name, probability in found.undeclared.suspected.items():
        if probability > 0.1:
            assert any(f"{name} (probability" in warning for warning in found.warnings)


@pytest.mark.slow
def test_what_held_out_samples_judge_is_proposed_by_the_others_alone(craft, log):
    """The end of this log is needed to find the scale of the gyro, so it cannot confirm it."""
    hidden = coarse_suite()
    hidden.gyro.scale_ppm = 150.0
    samples, _ = log(hidden, 4.0)
    suite = coarse_suite()
    whole, beginning = (
        identify(craft, part, sensors=suite, momentum=ZERO).undeclared
        for part in (samples, samples.between(0.0, 4.0 * 2 / 3))
    )
    judged = () if whole.held_out is None else whole.effects
    assert {each.name for each in judged} <= {each.name for each in beginning.effects}


def test_all_of_a_result_is_of_one_fit(craft, log):
    """The noise of the position is that of the residuals for the target and its errors alike."""
    suite, true = coarse_suite(gyro=FAST_GYRO), coarse_suite(gyro=FAST_GYRO)
    suite.position.lever_arm_mm = true.position.lever_arm_mm = 20.0
    true.position.sigma = 2.8e-3
    samples, _ = log(true, 5.0)
    seen, given = (identify(craft, samples, sensors=s) for s in (suite, true))
    target = np.sqrt(np.diag(seen.covariance) / np.diag(given.covariance))
    assert (np.abs(target - 1) < 0.25).all()
    [effect], [expected] = seen.effects, given.effects
    np.testing.assert_allclose(effect.sigma, expected.sigma, rtol=0.25)
