"""Errors that the sensors do not declare are named, if they change the target."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import TotalMomentum
from cpid_drake.identification.identify import identify
from cpid_drake.sensing.noise import SensorNoise, add_noise

HIDDEN = {
    "attitude.delay": ("attitude", "delay_ms", 30.0),
    "gyro.scale": ("gyro", "scale_ppm", 3000.0),
    "gyro.delay": ("gyro", "delay_ms", 30.0),
    "encoders.zero": ("encoders", "zero_mrad", 5.0),
}
ALL = [
    "attitude.delay",
    *(pytest.param(name, marks=pytest.mark.slow) for name in HIDDEN if name != "attitude.delay"),
]


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=10.0, size=0.6)


@pytest.fixture(scope="module")
def log(craft, motion, skewed_target):
    """Return a function from hidden errors to a noisy log and the drawn errors."""

    def make(name="", seed=4, target=skewed_target):
        suite = deepcopy(coarse_suite())
        if name:
            sensor, key, value = HIDDEN[name]
            setattr(suite[sensor], key, value)
        ideal = measured(craft, motion, target, suite)
        return add_noise(suite, ideal, seed), SensorNoise(suite, seed)

    return make


def test_a_clean_log_shows_no_errors(craft, log, skewed_target):
    measurements, _ = log()
    found = identify(craft, measurements, sensors=coarse_suite())
    assert found.passed
    assert not any("do not declare" in warning for warning in found.warnings)
    error = found.parameters - skewed_target.to_vector()
    assert (np.abs(error) < 4 * np.sqrt(np.diag(found.covariance))).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_a_hidden_error_is_named_with_its_value(craft, log, name):
    measurements, truth = log(name)
    found = identify(craft, measurements, sensors=coarse_suite())
    assert not found.passed
    sensor, key, _ = HIDDEN[name]
    assert "do not declare" in found.failures[0]
    assert f"{sensor}: {{{key}: " in found.failures[0]
    assert [effect.name for effect in found.undeclared.effects] == [name]
    prediction = found.undeclared.held_out
    assert prediction.seconds == pytest.approx(10 / 3, abs=1.0)
    assert prediction.chi_squared == pytest.approx(1.0, abs=0.3)
    assert prediction.without > 100
    assert prediction.describe() in "\n".join(found.undeclared.lines())
    assert found.undeclared.is_proposed
    if name == "attitude.delay":
        [effect] = found.undeclared.effects
        delay = 1e3 * truth.constants("attitude").delay
        assert abs(effect.value[0] - delay) < 4 * effect.sigma[0]
        assert f"{effect.value[0]:.3g} ± " in found.failures[0]


@pytest.mark.slow
def test_an_error_that_does_not_predict_the_end_is_not_proposed(craft, log):
    """A position that drifts like one under an acceleration, and is then calibrated again."""
    measurements, _ = log()
    position = measurements.position
    drift = np.where(position.time < 7.0, 0.5e-3 * position.time**2, 0.0)
    position = replace(position, value=position.value + drift[:, None] * np.eye(3)[0])
    drifting = measurements.updated({"position": position})
    momentum = TotalMomentum.zero()
    found = identify(craft, drifting, sensors=coarse_suite(), momentum=momentum)
    undeclared = found.undeclared
    assert [effect.name for effect in undeclared.effects] == ["acceleration"]
    assert undeclared.gain > 100  # it explains the whole log
    assert undeclared.held_out.without < 0.5 * undeclared.held_out.chi_squared
    assert not undeclared.is_proposed
    said = " ".join((*found.failures, *found.warnings, *undeclared.lines()))
    assert "the cause is not known" in said
    assert "do not predict better" in said
    assert "add it to" not in said
    assert "to declare them" not in said


@pytest.mark.parametrize("name", ALL)
def test_a_declared_error_is_estimated(craft, log, skewed_target, name):
    """Its interval and those of the target contain the truth, and nothing is doubted."""
    measurements, truth = log(name)
    sensor, key, value = HIDDEN[name]
    suite = deepcopy(coarse_suite())
    setattr(suite[sensor], key, value)
    found = identify(craft, measurements, sensors=suite)
    assert found.passed
    error = found.parameters - skewed_target.to_vector()
    assert (np.abs(error) < 4 * np.sqrt(np.diag(found.covariance))).all()
    [effect] = found.effects
    drawn = truth.constants(sensor, 4)
    true = {
        "delay": 1e3 * drawn.delay,
        "scale": 1e6 * np.diag(drawn.scale),
        "zero": 1e3 * drawn.zero,
    }[name.rpartition(".")[2]]
    assert effect.name == name
    assert (np.abs(effect.value - true) < 4 * effect.sigma).all()
    assert effect.is_learned
    assert (effect.sigma <= effect.prior_sigma).all()


@pytest.mark.slow
def test_an_error_that_does_not_matter_is_a_warning(craft, log, motion, skewed_target):
    """A lever arm of the position, with an excellent attitude, hardly changes the target."""
    suite = deepcopy(coarse_suite())
    hidden = replace(suite, position=replace(suite.position, lever_arm_mm=10.0))
    hidden.position.sigma = suite.position.sigma = 0.02
    ideal = measured(craft, motion, skewed_target, hidden)
    found = identify(craft, add_noise(hidden, ideal, 4), sensors=suite)
    assert found.passed


@pytest.mark.slow
def test_intervals_include_an_error_that_is_too_small_to_be_proposed(craft, motion, skewed_target):
    """Between what is not seen and what is named, an answer must not be confidently wrong."""
    suite = deepcopy(coarse_suite())
    suite.gyro.scale_ppm = 28.0
    log = add_noise(suite, measured(craft, motion, skewed_target, suite), 4)
    found = identify(craft, log, sensors=coarse_suite())
    assert found.passed
    assert not found.undeclared.effects
    probability = found.undeclared.suspected["gyro.scale"]
    assert 0.1 < probability < 0.99
    assert any(f"gyro.scale (probability {probability:.2g})" in each for each in found.warnings)
    plain = identify(craft, log, sensors=coarse_suite())
    np.testing.assert_array_equal(found.parameters, plain.parameters)
    scale = np.sqrt(np.diag(plain.covariance))
    wider = (found.covariance - plain.covariance) / scale / scale[:, None]
    assert np.linalg.eigvalsh(wider).max() > 2.0
    assert np.linalg.eigvalsh(wider).min() > -1e-6
    shown = found.consistency.intervals
    np.testing.assert_allclose(shown, found.intervals, rtol=1e-9)
    error = skewed_target.to_vector() - found.parameters
    assert (np.abs(error) < 3 * np.sqrt(np.diag(found.covariance))).all()


@pytest.mark.slow
@pytest.mark.parametrize(("share", "estimator"), [(0.05, "recursive_fit"), (0.3, "trajectory_fit")])
def test_a_fit_tells_the_share_of_its_log_that_it_leaves_out(craft, log, share, estimator):
    """The gyro is lost in noise for a while, and the answer is that of the rest."""
    measurements, _ = log()
    gyro, length = measurements.gyro, np.ptp(measurements.encoders.time)
    is_bad = np.abs(gyro.time - 0.7 * length) < share * length / 2
    jitter = np.random.default_rng(3).normal(scale=0.2, size=gyro.value.shape)
    samples = {"gyro": replace(gyro, value=gyro.value + jitter * is_bad[:, None])}
    measurements = measurements.updated(samples)
    found = identify(craft, measurements, sensors=coarse_suite(), estimator=estimator)
    assert found.unexplained == pytest.approx(share, abs=0.05)
    failure = f"nothing explains {100 * found.unexplained:.0f} % of the log"
    assert (failure in found.failures) == (share > 0.1)
