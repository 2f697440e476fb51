"""The sensors' file that a log shows: noise, rates and bias are right, and identify the log."""

from dataclasses import replace

import numpy as np
import pytest
from flyer_cases import flyer
from scipy.stats import chi2
from sensing_cases import Sines, measured, nees

from cpid_drake import InertialParameters, SensorSuite, identify, load_sensors
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.sensors_file import sensors_file
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

BAG = InertialParameters(
    8.5, [0.26, 0.02, -0.015], [[0.16, 0.012, -0.008], [0.012, 0.19, 0.01], [-0.008, 0.01, 0.25]]
)


def laboratory(rate, **others) -> SensorSuite:
    """Sensors whose errors are in units of a laboratory; the gyro has a large bias."""
    sensors = {
        "attitude": AttitudeSensor(rate, noise_deg=0.05),
        "gyro": Gyro(2 * rate, noise_deg_per_s=0.03, bias_deg_per_s=0.3),
        "position": VectorSensor(rate, sigma_mm=0.5),
        "encoders": JointSensor(rate, sigma_deg=0.006),
    }
    return SensorSuite(**(sensors | others)).exact()


@pytest.fixture
def written(tmp_path):
    """Return a function log -> the suite of its file, and the warnings."""

    def make(log):
        file = sensors_file(log, "a.csv")
        path = tmp_path / "sensors.yaml"
        path.write_text(file.text, encoding="utf-8")
        return load_sensors(path), file.warnings

    return make


@pytest.fixture(scope="module", params=["small", "flyer"])
def case(request, craft, skewed_target):
    """A craft, its target, and a function (rate, suite) -> a log of it, and its motion."""
    spacecraft, target, middle = craft, skewed_target, None
    if request.param == "flyer":
        spacecraft, target, middle = flyer(), BAG, np.array([0.8, -0.3, 1.1, -0.1])

    def log_of(rate, suite):
        motion = Sines.drawn(4, int(rate), 10.0, 0.5)
        if middle is not None:
            motion = replace(motion, middle=middle)
        return add_noise(suite, measured(spacecraft, motion, target, suite), seed=int(rate))

    return spacecraft, target, log_of


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_rates_and_noise_are_those_of_the_sensors(case, written, rate):
    suite = laboratory(rate, velocity=VectorSensor(rate, 2e-3))
    found, warnings = written(case[2](rate, suite))
    assert warnings == ()
    assert found.present().keys() == suite.present().keys()
    for name in suite.present():
        assert found[name].rate == pytest.approx(suite[name].rate, rel=1e-3)
        assert found.sigmas(name).max() == pytest.approx(suite.sigmas(name).max(), rel=0.2), name
        assert found[name].delay_ms is None  # the log does not show it
    assert found.unstated is None


def test_the_file_identifies_the_log_with_honest_intervals(case, written):
    spacecraft, target, log_of = case
    log = log_of(20.0, laboratory(20.0))
    found, _ = written(log)
    result = identify(spacecraft, log, sensors=found)
    assert result.passed, result.failures
    assert nees(result, target) < chi2.isf(1e-3, 10)
    [bias] = [effect for effect in result.effects if effect.name == "gyro.bias"]
    assert np.abs(bias.value).max() < 4 * bias.prior_sigma


def test_the_bias_is_that_of_the_gyro_against_the_attitude(craft, skewed_target, written):
    suite = laboratory(50.0, gyro=Gyro(50.0, noise_deg_per_s=0.03))
    exact = measured(craft, Sines.drawn(4, 3, 10.0, 0.5), skewed_target, suite)
    log = add_noise(suite, exact, seed=1)
    least = written(log)[0].gyro.bias
    bias = np.radians([0.6, -0.3, 0.2])
    moved = Samples(log.gyro.time, log.gyro.value + bias)
    size = written(log.updated({"gyro": moved}))[0].gyro.bias / 3600
    assert size == pytest.approx(np.degrees(np.sqrt(np.mean(bias**2))), rel=0.1)
    assert least / 3600 < 0.05


def test_a_motion_that_is_too_fast_for_a_sensor_is_said(craft, skewed_target, written):
    suite = laboratory(20.0, attitude=AttitudeSensor(2.5, 1.0, 1.0))
    log = add_noise(suite, measured(craft, Sines.drawn(4, 3, 20.0, 0.9), skewed_target, suite), 1)
    found, warnings = written(log)
    assert found.sigmas("attitude").max() > 1.2 * suite.sigmas("attitude").max()
    assert any("the motion is fast for the rate of the attitude" in text for text in warnings)


def test_a_log_without_attitude_states_no_bias(craft, skewed_target, written):
    suite = laboratory(20.0)
    log = add_noise(suite, measured(craft, Sines.drawn(4, 3, 5.0, 0.5), skewed_target, suite), 1)
    without = Log(log.joint_names, {n: s for n, s in log.samples.items() if n != "attitude"})
    found, _ = written(without)
    assert found.attitude is None
    assert found.gyro.bias is None


def test_too_few_samples_are_refused(craft, skewed_target):
    suite = laboratory(20.0)
    log = measured(craft, Sines.drawn(4, 3, 0.4, 0.5), skewed_target, suite)
    with pytest.raises(InputError, match="too few to estimate their noise"):
        sensors_file(log, "a.csv")
