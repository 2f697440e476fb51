"""Errors of rounded samples: their covariance is that of rounding at random zeros."""

import numpy as np
import pytest

from cpid_drake.estimation.likelihood.rounding import RoundedSamples

STEP, DRAWS, N = 1e-3, 4000, 40
TIMES = np.arange(N) / 100
BASIS = np.linalg.qr(np.vander(TIMES, 5, increasing=True))[0]


def motion(rate, acceleration=0.0):
    """Positions (N, 1) of a joint, in rad, from rate and acceleration in steps per sample."""
    k = np.arange(N)
    return STEP * (rate * k + acceleration * k**2 / 2)[:, None]


def errors(q, noise=0.0, seed=3):
    """Return (draws, N) errors of samples that are rounded at a random zero, with white noise."""
    rng = np.random.default_rng(seed)
    zero = STEP * rng.uniform(size=(DRAWS, 1))
    noisy = q.T + zero + noise * rng.normal(size=(DRAWS, N))
    return STEP * np.round(noisy / STEP) - q.T - zero


def rounded(q, noise=0.0, step=STEP):
    sigma = np.hypot(step / np.sqrt(12), noise)
    value = step * np.round(q / step) if step else q
    return RoundedSamples(BASIS, value, q, sigma, step)


MOTIONS = {
    "rest": (0.0, 0.0),
    "a step per sample": (1.0, 0.0),
    "nearly a step per sample": (1.01, 0.0),
    "half a step per sample": (0.5, 0.0),
    "starts from rest": (0.0, 0.05),
    "turns from step to step": (3.0, 0.007),
    "many steps per sample": (17.37, 0.43),
}


@pytest.mark.parametrize("noise", [0.0, 0.15 * STEP])
@pytest.mark.parametrize(("rate", "acceleration"), MOTIONS.values(), ids=MOTIONS)
def test_the_covariance_is_that_of_rounding_at_random_zeros(rate, acceleration, noise):
    """Within what the neglected harmonics of the correlation and the draws leave."""
    q = motion(rate, acceleration)
    e = errors(q, noise) / np.hypot(STEP / np.sqrt(12), noise)
    projected = e @ BASIS
    expected = projected.T @ projected / DRAWS
    found = rounded(q, noise).covariance()[0]
    # Harmonics beyond the sixth count as white; at half a step per sample they add up.
    largest = max(np.linalg.eigvalsh(expected)[-1], 1.0)
    np.testing.assert_allclose(found, expected, atol=0.17 * largest)
    assert np.linalg.eigvalsh(found)[-1] == pytest.approx(largest, rel=0.2)
