"""Rows with errors inside: the bias is removed, and a combination that only noise shows is open."""

import numpy as np

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.rows_fit import without_bias

COUNT, SIGMA = 400, 0.1


def solved(rows, E):
    return Gaussian.of_rows({"x": rows.shape[1] - 1}, without_bias(rows, E)[0])


def test_the_bias_of_noisy_regressors_is_removed_and_within_the_covariance():
    rng = np.random.default_rng(2)
    A, x = rng.normal(size=(COUNT, 4)), rng.normal(size=4)
    E = COUNT * np.diag([*4 * [SIGMA**2], 0.0])
    size = SIGMA * np.linalg.norm(x)  # of the residuals, that of A's errors times x
    plain, better, sigmas = [], [], []
    for _ in range(200):
        rows = np.column_stack([A + SIGMA * rng.normal(size=A.shape), A @ x]) / size
        plain.append(solved(rows, 0 * E).solve() - x)
        found = solved(rows, E / size**2)
        better.append(found.solve() - x)
        sigmas.append(np.sqrt(np.diag(found.covariance())))
    bias, left = np.mean(plain, axis=0), np.mean(better, axis=0)
    scatter = np.std(better, axis=0)
    assert np.abs(bias / scatter).max() > 1.0
    assert np.all(np.abs(left) < 5 * scatter / np.sqrt(200) + 0.1 * np.abs(bias))
    assert np.all(np.mean(sigmas, axis=0) > 0.9 * np.hypot(scatter, bias))


def test_a_combination_that_only_noise_shows_is_open():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(COUNT, 3)) * [1.0, 1.0, 0.0]
    rows = np.column_stack([A + SIGMA * rng.normal(size=A.shape), A @ np.ones(3)])
    E = COUNT * np.diag([*3 * [SIGMA**2], 0.0])
    assert np.linalg.matrix_rank(without_bias(rows, 0 * E)[0][:, :-1]) == 3
    found = without_bias(rows, E)[0]
    assert np.linalg.matrix_rank(found[:, :-1]) == 2
    assert np.abs(found[:, 2]).max() < 0.1 * np.abs(found[:, :2]).max()
