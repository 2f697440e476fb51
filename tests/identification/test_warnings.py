"""What a result warns of, whoever reads it."""

from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import identify
from cpid_drake.logs.simulated_noise import add_noise


def test_noise_that_is_larger_than_given_widens_the_intervals(tmp_path, skewed_target):
    """As if the true noise had been given; the errors are within the intervals."""
    craft, suite = small_craft(tmp_path), coarse_suite(velocity=None)
    motion = Sines.drawn(4, seed=101, duration=4.0, size=0.6)
    perfect = measured(craft, motion, skewed_target, suite)
    loud = replace(
        suite,
        attitude=replace(suite.attitude, cross_boresight_arcsec=15.0, boresight_arcsec=120.0),
        gyro=replace(suite.gyro, angle_random_walk=0.015),
        position=replace(suite.position, sigma=3e-3),
    )
    quiet, noisy = (
        identify(craft, add_noise(each, perfect, 2), sensors=suite) for each in (suite, loud)
    )
    told = identify(craft, add_noise(loud, perfect, 2), sensors=loud)
    ratio = np.sqrt(np.diag(noisy.covariance) / np.diag(told.covariance))
    assert np.median(ratio) == pytest.approx(1.0, rel=0.35)
    assert (np.diag(noisy.covariance) > np.diag(quiet.covariance)).all()
    error = noisy.parameters - skewed_target.to_vector()
    assert error @ np.linalg.solve(noisy.covariance, error) < 35
    assert not any("times the given σ was assumed" in warning for warning in quiet.warnings)
    assert any("times the given σ was assumed" in warning for warning in noisy.warnings)
