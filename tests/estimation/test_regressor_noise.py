"""Noise inside the regressors: rounding is recognized, and the covariance contains the bias."""

import numpy as np
import pytest

from cpid_drake.estimation.regressor_noise import rounding, with_bias
from cpid_drake.estimation.square_root import solve_information, triangle


@pytest.mark.parametrize("size", [1e-5, 1e-4, 1.0, 3e3])
@pytest.mark.parametrize("decimals", [1, 3, 6, 9])
def test_the_last_decimal_of_rounded_numbers_is_found(size, decimals):
    values = size * np.random.default_rng(1).normal(size=(200, 3))
    assert rounding(values) < 1e-9  # all digits, however small the numbers are
    rounded = np.round(values, decimals)
    assert rounding(rounded) == (10.0**-decimals if rounded.any() else 0.0)


def test_the_covariance_contains_the_square_of_the_bias_of_noisy_regressors():
    rng, sigma, count = np.random.default_rng(2), 0.1, 400
    A, x = rng.normal(size=(count, 10)), rng.normal(size=10)
    noise = np.zeros((11, 11))
    noise[:10, :10] = count * sigma**2 * np.eye(10)
    errors, added = [], []
    for _ in range(50):
        rows = np.column_stack([A + sigma * rng.normal(size=A.shape), A @ x])
        root = triangle(rows)
        solution = solve_information(root, count)
        errors.append(solution.estimate - x)
        added.append(with_bias(solution, root, noise).covariance - solution.covariance)
    bias = np.mean(errors, axis=0)
    np.testing.assert_allclose(np.mean(added, axis=0), np.outer(bias, bias), atol=1e-4)
    assert np.abs(bias).max() > 0.01
