"""What counts as evidence against a total momentum of zero."""

import numpy as np
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import identify
from cpid_drake.logs.simulated_noise import add_noise


def test_a_momentum_too_small_to_be_noticed_is_in_the_intervals(craft, skewed_target):
    """1.3 mN·m·s are 2.6 σ of the momentum, and 8 σ of a target that is fitted with zero.

    Of all directions of L, this one shows least for its effect on the target.
    """
    suite, motion = coarse_suite(), Sines.drawn(4, seed=101, duration=5.0, size=0.6)
    momentum_W = np.array([-0.35e-3, -0.64e-3, -1.08e-3, 0.0, 0.0, 0.0])
    samples = measured(craft, motion, skewed_target, suite, momentum_W)
    found = identify(craft, add_noise(suite, samples, seed=1), sensors=suite)
    error = found.parameters - skewed_target.to_vector()
    nees = error @ np.linalg.solve(found.covariance, error)
    assert nees < chi2.isf(1e-4, 10) or not found.passed
