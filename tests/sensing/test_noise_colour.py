"""The noise of fast samples is seen above the frequencies of the motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from cpid_drake import load_sensors
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise_colour import noise_factors, noise_of
from cpid_drake.sensing.sensors import Gyro

SIGMA = 2e-5
RATE = 100.0


def noise(seed, rho=0.0, count=1000):
    """Return noise (count, 3) of σ = 1 with a correlation of neighbours."""
    white = np.random.default_rng(seed).standard_normal((count + 500, 3)) * np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], white, axis=0)[500:]


def moving(values, rate=RATE):
    """Return samples of a motion that is 10,000 times as large as the noise, plus values."""
    time = np.arange(len(values)) / rate
    motion = 0.2 * np.sin(2 * np.pi * time[:, None] * [0.3, 0.5, 0.9] + [0.0, 1.0, 2.0])
    return Samples(time, motion + values)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.9])
def test_size_and_correlation_are_found_under_a_motion(rho):
    found = [noise_of(moving(SIGMA * noise(seed, rho)), SIGMA) for seed in range(8)]
    assert np.mean([each.correlation for each in found]) == pytest.approx(rho, abs=0.04)
    slow = np.median([each.slow_sigma for each in found]) / SIGMA
    assert slow == pytest.approx(np.sqrt((1 + rho) / (1 - rho)), rel=0.3)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 5.0])
def test_larger_white_noise_is_found(ratio):
    found = noise_of(moving(ratio * SIGMA * noise(1)), SIGMA)
    assert found.sigma / SIGMA == pytest.approx(ratio, rel=0.05)
    assert (found.gain > 40) == (ratio > 1)


def test_spikes_and_missing_samples_do_not_matter():
    values = SIGMA * noise(2)
    values[[100, 300, 650]] += 1.0
    samples = moving(values)
    kept = np.delete(np.arange(1000), [50, 51, 400, 720])
    for each in (samples, Samples(samples.time[kept], samples.value[kept])):
        found = noise_of(each, SIGMA)
        assert found.sigma / SIGMA == pytest.approx(1.0, rel=0.1)
        assert abs(found.correlation) < 0.1


@pytest.mark.parametrize("ratio", [1.0, 2.0])
@pytest.mark.parametrize("start", [300, 437, 512])
@pytest.mark.parametrize("length", [0, 50])
def test_firings_of_thrusters_do_not_matter(ratio, start, length):
    """A firing is a jump of the velocity, a burn one of the acceleration at its start and end."""
    ramp = np.clip((np.arange(1000) - start) / max(length, 1), 0.0, 1.0)
    samples = moving(ratio * SIGMA * noise(4) + 0.02 * ramp[:, None] * [1.0, -0.5, 0.3])
    found = noise_of(samples, SIGMA)
    assert 0.85 * ratio < found.slow_sigma / SIGMA < 1.3 * ratio


def test_slow_or_few_or_uneven_samples_do_not_show_their_noise():
    samples = moving(SIGMA * noise(3))
    assert noise_of(moving(SIGMA * noise(3), rate=10.0), SIGMA) is None
    assert noise_of(samples.where(slice(0, 150)), SIGMA) is None
    assert noise_of(Samples(samples.time**1.01, samples.value), SIGMA) is None


def test_factors_are_those_of_noisy_sensors_only():
    suite = replace(load_sensors("flight"), gyro=Gyro(100.0, 0.001, 0.1))
    sigma = float(suite.sigmas("gyro")[0])
    for ratio, rho, expected in ((1.0, 0.0, None), (0.5, 0.0, None), (2.0, 0.0, 2.0)):
        gyro = moving(ratio * sigma * noise(4, rho))
        encoders = moving(suite.sigmas("encoders")[0] * noise(5))
        log = Measurements(("a", "b", "c"), {"gyro": gyro, "encoders": encoders})
        factors = noise_factors(log, suite)
        assert set(factors) == (set() if expected is None else {"gyro"})
        if expected is not None:
            assert factors["gyro"] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("preset", ["flight", "testbed", "servicer", "coarse", "digits6"])
def test_a_noisier_suite_has_larger_sigmas(preset):
    suite = load_sensors(preset)
    for name in suite.present():
        noisier = suite.noisier({name: 3.0})
        np.testing.assert_allclose(noisier.sigmas(name), 3 * suite.sigmas(name), rtol=1e-9)
        others = set(suite.present()) - {name}
        assert all((noisier.sigmas(n) == suite.sigmas(n)).all() for n in others)
