"""Noise that is larger than declared, coloured, full of outliers, or that of a broken sensor."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, nees, with_drawn_errors

from cpid_drake import TotalMomentum, identify
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import Gyro, JointSensor, VectorSensor

ZERO = TotalMomentum.zero()
FAST_GYRO = Gyro(50.0, 0.005, 1.0, 0.1)
FITS = ("trajectory_fit", "recursive_fit")


@pytest.fixture(scope="module")
def ideal(craft, skewed_target):
    """Return a function from sensors and a duration to samples without noise."""

    def make(suite, duration):
        motion = Sines.drawn(4, seed=101, duration=duration, size=0.6)
        return measured(craft, motion, skewed_target, suite)

    return make


@pytest.mark.parametrize(("every", "is_trusted"), [(4, True), (2, False)])
def test_a_sensor_most_of_whose_samples_cannot_be_used_fails_a_check(
    craft, ideal, suite, every, is_trusted
):
    """However many samples other sensors have: here one of `every` and the next are no numbers."""
    samples = add_noise(suite, ideal(suite, 5.0), 4)
    value = samples.position.value.copy()
    value[::every] = np.nan
    value[1:6] = np.nan
    bad = samples.updated({"position": replace(samples.position, value=value)})
    found = identify(craft, bad, sensors=suite)
    assert found.rejected["position"] == np.isnan(value).any(axis=1).sum()
    assert found.passed == is_trusted
    assert is_trusted or "samples of position could not be used" in found.failures[0]


@pytest.mark.parametrize("is_exact", [False, True])
def test_a_sensor_without_stated_noise_is_named(craft, ideal, suite, is_exact):
    """It is taken as exact, which a suite says of itself with `unstated: exact`."""
    samples = add_noise(suite, ideal(suite, 2.0), 4)
    silent = replace(suite, gyro=Gyro(suite.gyro.rate), unstated="exact" if is_exact else None)
    warnings = identify(craft, samples, sensors=silent).warnings
    said = [text for text in warnings if "is stated: it was taken as exact" in text]
    assert len(said) == (not is_exact)
    assert all("noise of the angular velocity" in text and "'gyro:'" in text for text in said)


@pytest.mark.slow
def test_a_fit_tells_the_share_of_its_log_that_it_leaves_out(craft, ideal, suite):
    """The gyro is lost in noise for a while, and the answer is that of the rest."""
    share, samples = 0.3, add_noise(suite, ideal(suite, 10.0), 4)
    gyro = samples.gyro
    is_bad = np.abs(gyro.time - 7.0) < 10.0 * share / 2
    jitter = np.random.default_rng(3).normal(scale=0.2, size=gyro.value.shape)
    bad = {"gyro": replace(gyro, value=gyro.value + jitter * is_bad[:, None])}
    found = identify(craft, samples.updated(bad), sensors=suite)
    left_out = found.check("share of outliers").statistic
    assert left_out == pytest.approx(share, abs=0.05)
    assert f"{100 * left_out:.0f} % of a sensor's samples are outliers" in found.failures


@pytest.mark.parametrize("estimator", FITS)
def test_a_position_with_a_slow_error_fails_a_check_or_is_in_the_intervals(
    craft, ideal, skewed_target, estimator
):
    """A wave of 1.5 mm with a period of 3 s in place of white noise of 1 mm; no χ² sees it."""
    suite = coarse_suite(gyro=FAST_GYRO, position=VectorSensor(10.0, 1e-3))
    exact = ideal(suite, 8.0)
    wave = 1.5e-3 * np.sin(2 * np.pi * exact.position.time[:, None] / 3.0 + np.arange(3))
    position = replace(exact.position, value=exact.position.value + wave)
    clean = add_noise(suite, exact, 4)
    logs = spoiled = clean.updated({"position": position})
    if estimator == "trajectory_fit":  # it names the log, too
        logs = {"clean": clean, "spoiled": spoiled}
    found = identify(craft, logs, sensors=suite, estimator=estimator)
    assert np.isfinite(found.parameters).all()
    said = [*found.failures, *found.warnings]
    assert any("correlated" in each for each in said)
    assert not any("of clean" in each for each in said)
    assert found.failures or nees(found, skewed_target) < chi2.isf(1e-3, 10)


class TestLargerThanDeclared:
    @pytest.mark.parametrize(("factor", "is_trusted"), [(3.0, True), (6.0, False)])
    def test_three_times_passes_and_six_times_fails_a_check(self, craft, ideal, factor, is_trusted):
        suite = coarse_suite(gyro=FAST_GYRO)
        true = replace(suite, position=VectorSensor(5.0, factor * 1e-3))
        found = identify(craft, add_noise(true, ideal(true, 5.0), 4), sensors=suite)
        assert found.passed == is_trusted
        text = "the noise is larger than the sensors' file declares: that of the position"
        assert any(failure.startswith(text) for failure in found.failures) != is_trusted

    def test_of_much_better_sensors_the_noise_is_named_and_nothing_else(self, craft, ideal):
        true = coarse_suite(gyro=Gyro(50.0, 0.05, 1.0, 0.1), position=VectorSensor(5.0, 1e-2))
        samples, better = add_noise(true, ideal(true, 3.0), 4), coarse_suite(gyro=FAST_GYRO)
        found = identify(craft, samples, sensors=better, momentum=ZERO)
        assert all(text in " ".join(found.failures) for text in ("angular velocity", "position"))
        assert "noise is larger than the sensors' file declares" in found.failures[0]
        said = " ".join((*found.failures, *found.warnings))
        assert not any(word in said for word in ("most likely", "body", "lever arm", "includes it"))


def coloured(rng, times, shape, rho=0.5):
    white = rng.standard_normal((shape[0] + 300, shape[1])) * np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], white, axis=0)[300:]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("errors", "least"),
    [(coloured, 4), (lambda rng, times, shape: rng.standard_t(4, shape), 3)],
    ids=["correlated", "outliers"],
)
def test_intervals_hold(craft, ideal, skewed_target, errors, least):
    """Of each log that passes."""
    suite = coarse_suite(gyro=Gyro(50.0, 0.005, 1.0), encoders=JointSensor(50.0, 1e-5))
    exact, found = ideal(suite, 6.0), []
    for seed in range(4):
        draw = partial(errors, np.random.default_rng(seed))
        found.append(identify(craft, with_drawn_errors(suite, exact, draw), sensors=suite))
    squares = [nees(each, skewed_target) for each in found if each.passed]
    assert len(squares) >= least
    assert max(squares) < chi2.isf(1e-3, 10)
    assert np.sum(squares) < chi2.isf(1e-3, 10 * len(squares))
    assert np.sum(squares) > chi2.ppf(1e-6, 10 * len(squares))


@pytest.mark.slow
def test_noise_slower_than_a_block_widens_the_intervals(craft, ideal, skewed_target):
    """Half of a gyro's noise is correlated over 3 s: no block shows it, its size is as declared."""

    def white(rng, times, shape):
        return rng.standard_normal(shape)

    def half_slow(rng, times, shape):
        slow = coloured(rng, times, shape, np.exp(-20.0 / shape[0] / 3.0))
        return (white(rng, times, shape) + slow) / np.sqrt(2)

    suite = coarse_suite(gyro=Gyro(50.0, 0.005, 1.0), encoders=JointSensor(50.0, 1e-5))
    exact, squares = ideal(suite, 20.0), []
    for seed in range(4):
        log, slow = (
            with_drawn_errors(suite, exact, partial(draw, np.random.default_rng(seed)))
            for draw in (white, half_slow)
        )
        found = identify(craft, log.updated({"gyro": slow.gyro}), sensors=suite)
        squares += [nees(found, skewed_target)] if found.passed else []
    assert squares
    assert max(squares) < chi2.isf(1e-4, 10)


def test_a_gyro_bias_that_walks_is_no_other_target_in_the_first_half(craft, ideal):
    """The bias at half time is that at the end less what it has walked since."""
    suite = coarse_suite(gyro=Gyro(50.0, 0.005, 1.0, bias_random_walk=300.0))
    found = identify(craft, add_noise(suite, ideal(suite, 8.0), 2), sensors=suite)
    assert found.check("halves").passed
