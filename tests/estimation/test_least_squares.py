"""Batch and recursive least squares: one answer by two roads, and honest words on its quality."""

import numpy as np
import pytest

from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.gaussian import Gaussian, solution_of, solution_of_rows
from cpid_drake.estimation.least_squares import updated_information

FAMILIES = pytest.mark.parametrize("family", ROW_FAMILIES.values(), ids=ROW_FAMILIES)


def batch_solution(A, b):
    A, b = A.reshape(-1, A.shape[-1]), b.ravel()
    count = int(np.count_nonzero(A.any(axis=1) | (b != 0)))
    return solution_of_rows(np.column_stack([A, b]), count)


def recursive_solution(A, b, block=6):
    augmented = np.hstack([A, b[:, None]])
    root = np.zeros(2 * [A.shape[1] + 1])
    for k in range(0, len(b), block):
        root = updated_information(root, augmented[k : k + block])
    return solution_of_rows(root, len(b))


@pytest.fixture(scope="module")
def noisy_rows():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(600, 10)) * 10.0 ** np.linspace(-3, 2, 10)
    x = rng.normal(size=10) / 10.0 ** np.linspace(-3, 2, 10)
    return A, A @ x + 0.01 * rng.normal(size=600), x


@FAMILIES
def test_recursive_equals_batch_on_momentum_rows(
    servicer, skewed_target, zero_momentum_motion, family
):
    """To 1e-9 relative, in estimate, covariance and residual."""
    telemetry = zero_momentum_motion(skewed_target, 40, seed=2).rounded(4)
    A, b = family.rows(momentum_samples(servicer.tree, telemetry))
    batch = batch_solution(A, b)
    recursive = recursive_solution(A.reshape(-1, 10), b.ravel())
    np.testing.assert_allclose(recursive.estimate, batch.estimate, rtol=1e-9)
    np.testing.assert_allclose(
        recursive.covariance, batch.covariance, rtol=1e-9, atol=1e-9 * batch.covariance.max()
    )
    assert recursive.residual_rms == pytest.approx(batch.residual_rms, rel=1e-9)
    assert recursive.rank == batch.rank == 10


def test_the_order_of_samples_does_not_matter(noisy_rows):
    A, b, _ = noisy_rows
    order = np.random.default_rng(3).permutation(len(b))
    one, other = recursive_solution(A, b), recursive_solution(A[order], b[order], block=13)
    np.testing.assert_allclose(one.estimate, other.estimate, rtol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-20)


def test_covariance_predicts_the_scatter_of_estimates():
    """Monte Carlo: the sample covariance over 4000 draws agrees with the reported one."""
    rng = np.random.default_rng(4)
    A, x, sigma = rng.normal(size=(60, 10)), rng.normal(size=10), 0.3
    estimates, reported = [], []
    for _ in range(4000):
        solution = batch_solution(A, A @ x + sigma * rng.normal(size=60))
        estimates.append(solution.estimate)
        reported.append(solution.covariance)
    scatter, mean = np.cov(np.array(estimates).T), np.mean(reported, axis=0)
    ratio = np.diag(scatter) / np.diag(mean)
    assert np.abs(ratio - 1).max() < 0.1
    assert np.abs(np.mean(estimates, axis=0) - x).max() < 5 * np.sqrt(mean.max() / 4000)


def test_units_do_not_change_the_answer(noisy_rows):
    """Grams instead of kilograms: the same solution, rank and scaled condition."""
    A, b, _ = noisy_rows
    units = 10.0 ** np.array([3, 0, 0, 0, -3, 6, 0, 2, -2, 1.0])
    one, other = batch_solution(A, b), batch_solution(A * units, b)
    np.testing.assert_allclose(other.estimate * units, one.estimate, rtol=1e-9)
    assert other.condition_number == pytest.approx(one.condition_number, rel=1e-9)


def test_open_unknowns_are_nan_and_the_others_right():
    rng = np.random.default_rng(6)
    A, x = rng.normal(size=(50, 10)), rng.normal(size=10)
    A[:, 7] = 2 * A[:, 3]  # only x3 + 2 x7 matters
    A[:, 9] = 0.0
    solution = batch_solution(A, A @ x)
    assert solution.rank == 8
    assert not solution.is_identifiable
    assert np.isnan(solution.estimate[[3, 7, 9]]).all()
    closed = [0, 1, 2, 4, 5, 6, 8]
    np.testing.assert_allclose(solution.estimate[closed], x[closed], rtol=1e-10)
    assert np.isnan(solution.covariance[3]).all()
    assert np.isfinite(solution.covariance[np.ix_(closed, closed)]).all()
    assert solution.condition_number == np.inf
    assert (
        np.abs((A / np.linalg.norm(A, axis=0).clip(1e-9)) @ solution.unidentifiable.T).max() < 1e-9
    )


@pytest.mark.parametrize("rows", [0, 1, 5, 9])
def test_fewer_rows_than_unknowns(rows):
    rng = np.random.default_rng(7)
    A, b = rng.normal(size=(rows, 10)), rng.normal(size=rows)
    for solution in (batch_solution(A, b), recursive_solution(A, b)):
        assert solution.rank == rows
        assert solution.row_count == rows
        assert np.isnan(solution.estimate).all()


def test_rows_of_zeros_add_nothing(noisy_rows):
    """Samples at rest must not make the estimate look better than it is."""
    A, b, _ = noisy_rows
    plain = batch_solution(A, b)
    padded = batch_solution(np.vstack([A, np.zeros((600, 10))]), np.append(b, np.zeros(600)))
    np.testing.assert_allclose(padded.estimate, plain.estimate, rtol=1e-12)
    np.testing.assert_allclose(padded.covariance, plain.covariance, rtol=1e-9)
    assert padded.row_count == len(b)


def test_eliminated_unknowns_reduce_the_degrees_of_freedom():
    """The covariance is that of the solution for all unknowns, by the textbook formula."""
    rng = np.random.default_rng(5)
    A, b = rng.normal(size=(20, 16)), rng.normal(size=20)
    x, *_ = np.linalg.lstsq(A, b, rcond=None)
    variance = np.sum((A @ x - b) ** 2) / (20 - 16)
    expected = variance * np.linalg.inv(A.T @ A)
    information = updated_information(np.zeros((17, 17)), np.column_stack([A, b]))
    for eliminated in (0, 6):
        found = solution_of_rows(information[eliminated:, eliminated:], 20 - eliminated)
        np.testing.assert_allclose(found.estimate, x[eliminated:], rtol=1e-9)
        rest = expected[eliminated:, eliminated:]
        np.testing.assert_allclose(found.covariance, rest, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("share", "is_known"), [(0.3, True), (0.36, False)])
def test_an_entry_is_known_to_a_third_of_its_plausible_size(share, is_known):
    """Its σ is that of the information; an unknown entry and its σ are NaN, the others are not."""
    scale = np.array([50.0, 3.0, 0.2])
    sigma = scale * [1e-3, share, 1e-2]
    told = Gaussian.of_rows({"x": 3}, np.column_stack([np.diag(1 / sigma), 1 / sigma]))
    solution = solution_of(told, np.ones(3), scale)
    assert solution.rank == 2 + is_known
    assert np.isfinite(solution.estimate).tolist() == [True, is_known, True]
    np.testing.assert_allclose(np.sqrt(np.diag(solution.covariance))[[0, 2]], sigma[[0, 2]])
