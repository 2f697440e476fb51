"""Whiteness on noise of known memory."""

import numpy as np
import pytest
from scipy.signal import lfilter

from cpid_drake.estimation.whiteness import LagSums


def whiteness(residuals):
    return LagSums().added(residuals).whiteness


@pytest.mark.parametrize("channels", [1, 6])
def test_the_band_is_3_3_sigma_of_white_noise(channels):
    rng = np.random.default_rng(5)
    found = [whiteness(rng.normal(size=(300, channels))) for _ in range(400)]
    assert np.std([each.lag_one / each.band for each in found]) == pytest.approx(1 / 3.3, rel=0.1)


@pytest.mark.parametrize("memory", [-0.4, 0.0, 0.5, 0.9])
def test_correlation_and_its_time_are_those_of_noise_with_memory(memory):
    """Of first order: (1 + ρ)/(1 − ρ) samples count as one; by all samples, or block by block."""
    steps = np.random.default_rng(6).normal(size=(200_000, 3))
    noise, sums = lfilter([1.0], [1.0, -memory], steps, axis=0), LagSums()
    for block in np.split(noise, 200):
        sums = sums.added(block)
    for found in (whiteness(noise), sums.whiteness):
        assert found.lag_one == pytest.approx(memory, abs=0.02)
        assert found.correlation_time == pytest.approx(max((1 + memory) / (1 - memory), 1), rel=0.1)
        assert found.rms == pytest.approx(np.std(noise), rel=0.02)
        assert found.is_white == (memory == 0.0)


def test_blocks_add_up_to_what_all_residuals_show():
    """Neighbours in two blocks count, too: slow residuals of short blocks are as slow."""
    rng = np.random.default_rng(10)
    noise, sums = lfilter([1.0], [1.0, -0.98], rng.normal(size=(3000, 3)), axis=0), LagSums()
    for block in np.split(noise, [7, 30, 1000, 1020]):
        sums = sums.added(block)
    whole = LagSums().added(noise)
    np.testing.assert_array_equal(sums.pairs, whole.pairs)
    np.testing.assert_allclose(sums.correlation, whole.correlation, atol=1e-12)


def test_few_white_residuals_seem_no_slower_than_they_are():
    """What 300 samples show of a memory by chance is not called one."""
    rng = np.random.default_rng(7)
    times = [whiteness(rng.normal(size=(300, 3))).correlation_time for _ in range(200)]
    assert np.mean(times) < 1.01
    assert np.mean(np.equal(times, 1.0)) > 0.9


def test_the_time_of_white_and_slow_noise_is_that_of_their_sum():
    """Of equal parts white and Gauss-Markov noise with T samples: 1 + T/2, however small ρ is."""
    rng, memory = np.random.default_rng(8), np.exp(-2 / 40)
    slow = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], rng.normal(size=(100_000, 3)), axis=0)
    noise = slow + rng.normal(size=slow.shape)
    assert whiteness(noise).correlation_time == pytest.approx(1 + 40 / 2, rel=0.15)


def test_a_spike_does_not_hide_correlation():
    rng = np.random.default_rng(9)
    noise = lfilter([1.0], [1.0, -0.8], rng.normal(size=(3000, 3)), axis=0)
    noise[1500] += 1e4
    assert not LagSums().added(noise).whiteness.is_white


@pytest.mark.parametrize(
    ("memory", "size", "fails"), [(0.95, 0.2, 1), (0.95, 0.02, 0), (0.6, 1.0, 0)]
)
def test_slow_residuals_fail_though_they_are_smaller_than_the_noise(memory, size, fails):
    noise = lfilter([1.0], [1.0, -memory], np.random.default_rng(7).normal(size=(3000, 3)), axis=0)
    assert whiteness(size * noise / noise.std()).fails == bool(fails)
