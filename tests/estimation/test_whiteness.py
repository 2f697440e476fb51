"""Whiteness on noise of known memory."""

import numpy as np
import pytest
from scipy.signal import lfilter

from cpid_drake.estimation.whiteness import whiteness


@pytest.mark.parametrize("channels", [1, 6])
def test_the_band_holds_white_noise_in_95_percent(channels):
    rng = np.random.default_rng(5)
    found = [whiteness(rng.normal(size=(300, channels))) for _ in range(400)]
    inside = np.mean([abs(each.lag_one) <= each.band for each in found])
    assert 0.91 < inside < 0.985


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_correlation_time_is_that_of_noise_with_memory(memory):
    """Of first order: (1 + ρ)/(1 − ρ) samples count as one, and neighbours correlate by ρ."""
    steps = np.random.default_rng(6).normal(size=(200_000, 3))
    noise = lfilter([1.0], [1.0, -memory], steps, axis=0)
    found = whiteness(noise)
    assert found.lag_one == pytest.approx(memory, abs=0.02)
    assert found.correlation_time == pytest.approx((1 + memory) / (1 - memory), rel=0.1)
