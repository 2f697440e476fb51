"""A gyro whose bias is far beyond what its file declares is named, and changes no estimate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, nees

from cpid_drake import identify
from cpid_drake.logs.gyro_bias import gyro_bias
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor
from cpid_drake.sensors.suite import SensorSuite

BIAS = np.array([0.5, -0.35, 0.25])
"""Of a usual MEMS gyro [deg/s]; its file declares 3 deg/h."""


@pytest.fixture(scope="module")
def suite():
    """Sensors like those of `testbed`, slow for speed."""
    return SensorSuite(
        attitude=AttitudeSensor(20.0, 180.0, 180.0),
        gyro=Gyro(20.0, 0.1, 3.0, 1.0),
        position=VectorSensor(20.0, 5e-4),
        encoders=JointSensor(20.0, 1e-4),
    ).exact()


@pytest.fixture(scope="module")
def noisy(craft, suite, skewed_target):
    """Return a function (bias [deg/s], seed) -> a log."""

    def make(bias, seed=1):
        exact = measured(craft, Sines.drawn(4, 105 + seed, 6.0, 0.6), skewed_target, suite)
        log = add_noise(suite, exact, seed=seed)
        return log.updated({"gyro": Samples(log.gyro.time, log.gyro.value + np.radians(bias))})

    return make


def bias_of(result):
    [effect] = [each for each in result.effects if each.name.endswith("gyro.bias")]
    return effect


def test_a_large_bias_is_named_and_estimated(craft, suite, noisy, skewed_target):
    result = identify(craft, noisy(BIAS), sensors=suite)
    [warning] = result.warnings
    assert warning.startswith("the gyro has a bias of (0.4998 ± 0.0082, -0.3444")
    assert "times the sigma that its file declares" in warning
    assert warning.endswith("declare gyro.bias_deg_per_s: 0.38 and remove gyro.bias")
    assert result.passed, result.failures
    assert nees(result, skewed_target) < chi2.isf(1e-3, 10)
    effect = bias_of(result)
    assert effect.is_learned
    assert np.all(np.abs(effect.value / 3600 - BIAS) < 5 * effect.sigma / 3600 + 3 * 3 / 3600)
    assert "estimated    gyro.bias: the bias of the gyro is (1" in str(result)


@pytest.mark.parametrize("error", ["delay", "few samples", "scale"])
def test_other_errors_are_no_bias(craft, suite, skewed_target, noisy, error):
    """The derivative of an attitude that is late or sampled at 4 Hz would show one."""
    log = noisy(0.0)
    if error == "delay":
        late = Samples(log.attitude.time + 0.06, log.attitude.value)
        log = log.updated({"attitude": late})
    elif error == "scale":
        log = log.updated({"gyro": Samples(log.gyro.time, log.gyro.value * [1.002, 0.999, 1.001])})
    else:
        precise = replace(suite, attitude=AttitudeSensor(4.0, 2.0, 20.0))
        exact = measured(craft, Sines.drawn(4, 106, 6.0, 0.9), skewed_target, precise)
        log, suite = add_noise(precise, exact, seed=1), precise
    shown = gyro_bias(log, suite)
    assert shown.ratio(suite.gyro.bias_sigma) < 4
    moved = Samples(log.gyro.time, log.gyro.value + np.radians(BIAS))
    bias = gyro_bias(log.updated({"gyro": moved}), suite)
    assert np.all(np.abs(bias.value - np.radians(BIAS) - shown.value) < 0.1 * bias.sigma + 1e-4)
    assert bias.ratio(suite.gyro.bias_sigma) > 50


def test_a_bias_as_declared_is_not(craft, suite, noisy):
    result = identify(craft, noisy(0.0), sensors=suite)
    assert not any("bias" in text for text in result.warnings)
    assert bias_of(result).prior_sigma == pytest.approx(3.0)


def test_each_log_of_one_hardware_has_its_own_bias(craft, suite, noisy, skewed_target):
    logs = {"a": noisy(0.0, 1), "b": noisy(BIAS, 2)}
    result = identify(craft, logs, sensors=suite)
    assert [text[:11] for text in result.warnings if "bias" in text] == ["b: the gyro"]
    biases = {e.log: e for e in result.effects if e.name == "gyro.bias"}
    assert np.abs(biases["a"].value).max() < 60
    assert biases["b"].value[0] == pytest.approx(1800, rel=0.05)
    assert {e.hardware for e in result.effects} == {""}
    assert nees(result, skewed_target) < chi2.isf(1e-3, 10)


@pytest.mark.parametrize("key", ["bias: 0", "unstated: exact"])
def test_a_bias_that_the_file_excludes_is_not_sought_but_is_named(craft, suite, noisy, key):
    """A small one in a warning of a result that passes, a large one as a cause of failed checks."""
    gyro = replace(suite.gyro, bias=0.0 if key == "bias: 0" else None)
    excluded = replace(suite, gyro=gyro)
    small = identify(craft, noisy(BIAS / 10), sensors=excluded)
    large = identify(craft, noisy(BIAS), sensors=excluded)
    assert small.passed, small.failures
    assert not large.passed
    for result, [said], size in (
        (small, [text for text in small.warnings if "bias" in text], "(0.04"),
        (large, large.failures[:1], "most likely, the gyro has a bias of (0.49"),
    ):
        assert size in said
        assert f"which `{key}` excludes: declare gyro.bias_deg_per_s: 0." in said
        assert said.endswith(" and remove gyro.bias") == (key == "bias: 0")
        assert not any(each.name == "gyro.bias" for each in result.effects)


def test_no_bias_is_named_without_one(craft, suite, noisy):
    exact = replace(suite, gyro=replace(suite.gyro, bias=0.0))
    assert not any("bias" in text for text in identify(craft, noisy(0.0), sensors=exact).warnings)


def test_the_error_of_the_integral_is_no_bias(craft, skewed_target):
    """Exact samples at a low rate: the trapezoids alone would look like a bias."""
    exact = coarse_suite(attitude=AttitudeSensor(10.0, 0.1, 0.1), gyro=Gyro(10.0, 1e-4, 1e-3))
    log = measured(craft, Sines.drawn(4, 107, 8.0, 1.5), skewed_target, exact)
    assert gyro_bias(log, exact).ratio(exact.gyro.bias_sigma) < 4
