"""Estimates over time: those of one pass are those of fits of the first samples."""

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured, sigmas

from cpid_drake import identify
from cpid_drake.logs.simulated_noise import add_noise

SUITE = coarse_suite()


@pytest.fixture(scope="module")
def log(craft, skewed_target):
    motion = Sines.drawn(4, seed=3, duration=8.0, size=0.6)
    return add_noise(SUITE, measured(craft, motion, skewed_target, SUITE), seed=4)


def test_they_are_those_of_the_first_samples(craft, log):
    """About the target of all samples, and of those alone; their start is that of the log."""
    found = identify(craft, log, sensors=SUITE)
    history = found.history()
    times = np.array([time for time, _ in history])
    assert (np.diff(times) > 0).all()
    for k in (3, len(history) - 1):
        time, early = history[k]
        alone = identify(craft, log.between(0.0, time), sensors=SUITE)
        assert early.sample_count == pytest.approx(alone.sample_count, abs=20)
        assert np.abs((early.parameters - alone.parameters) / sigmas(alone)).max() < 0.5
        np.testing.assert_allclose(sigmas(early), sigmas(alone), rtol=0.2)
    widths = np.array([sigmas(each) for _, each in history[3:]])
    assert (np.diff(widths, axis=0) < 0).all()
    assert np.all(widths[-1] > sigmas(found))
