"""The checks: of halves of the samples, and of noise."""

import numpy as np
from scipy.stats import chi2

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.identification.checks import fit_checks
from cpid_drake.identification.chosen_fit import halves_check
from cpid_drake.identification.observed import Observed


def of_halves(rng, change):
    """Return the check of a linear model of six unknowns that change in the second half [σ]."""
    A, x = rng.standard_normal((40, 6)) * 10.0 ** np.arange(6), 10.0 ** -np.arange(6)
    sigma = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    truth = np.where(np.arange(40)[:, None] < 20, x, x + change * sigma)
    b = np.sum(A * truth, axis=1) + rng.standard_normal(40)
    first, whole = (Gaussian.of_rows({"x": 6}, np.column_stack([A[:n], b[:n]])) for n in (20, 40))
    return halves_check(first, whole, 10 * x, "something slips")


def test_halves_differ_as_their_covariances_say():
    """By least squares in units of the noise, the statistic is χ² of six."""
    rng = np.random.default_rng(3)
    found = np.array([of_halves(rng, 0.0).statistic for _ in range(300)])
    assert chi2.ppf(1e-3, 1800) < found.sum() < chi2.isf(1e-3, 1800)
    assert np.mean(found > chi2.isf(0.05, 6)) < 0.1


def test_another_target_in_the_second_half_fails():
    rng = np.random.default_rng(4)
    found = [of_halves(rng, 12.0) for _ in range(20)]
    assert not any(check.passed for check in found)
    assert "something slips" in found[0].sentence


def test_each_noise_that_is_too_large_is_in_one_check():
    """A sensor whose residuals are correlated, too, is in the check of their correlation alone."""
    tests = {
        "gyro": Whiteness(0.9, 0.1, 20.0, 1000, 58.0),
        "attitude": Whiteness(0.0, 0.1, 1.0, 1000, 7.0),
    }
    noise = {"gyro": 58.0, "attitude": 7.0}
    checks = {each.name: each for each in fit_checks(True, Observed(tests, noise=noise))}
    assert not checks["correlation of gyro"].passed
    assert checks["noise"].statistic == 7.0
    assert "58" in checks["correlation of gyro"].sentence
    assert "58" not in checks["noise"].sentence
