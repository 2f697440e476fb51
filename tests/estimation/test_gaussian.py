"""Gaussians of named unknowns against covariances, which they never form."""

import numpy as np
import pytest

from cpid_drake.estimation.gaussian import Gaussian

SIZES = {"a": 2, "b": 3, "c": 1}


@pytest.fixture
def rows():
    return np.random.default_rng(3).normal(size=(11, 7))


@pytest.fixture
def gaussian(rows):
    return Gaussian.of_rows(SIZES, rows)


def dense(rows):
    """Return mean and covariance of the rows' least-squares problem."""
    A, b = rows[:, :-1], rows[:, -1]
    P = np.linalg.inv(A.T @ A)
    return P @ A.T @ b, P


def test_rows_are_a_least_squares_problem(rows, gaussian):
    mean, covariance = dense(rows)
    np.testing.assert_allclose(gaussian.solve(), mean)
    np.testing.assert_allclose(gaussian.covariance(), covariance)
    x = np.arange(6.0)
    assert gaussian.cost(x) == pytest.approx(np.sum((rows[:, :-1] @ x - rows[:, -1]) ** 2))


def test_two_gaussians_are_their_rows_together(rows):
    """Unknowns of one name are one unknown, whatever the order."""
    other = np.random.default_rng(4).normal(size=(9, 5))  # about c, d, a
    both = Gaussian.of_rows(SIZES, rows).add(Gaussian.of_rows({"c": 1, "d": 1, "a": 2}, other))
    A = np.zeros((20, 8))
    A[:11, :6], A[:11, 7] = rows[:, :6], rows[:, 6]
    A[11:, [5, 6, 0, 1]], A[11:, 7] = other[:, :4], other[:, 4]
    mean, covariance = dense(A)
    np.testing.assert_allclose(both.solve(), mean)
    np.testing.assert_allclose(both.covariance(), covariance)
    assert both.cost(mean) == pytest.approx(np.sum((A[:, :7] @ mean - A[:, 7]) ** 2))


def test_a_marginal_keeps_mean_and_covariance(gaussian):
    kept = [5, 0, 1]
    marginal = gaussian.marginal(["c", "a"])
    np.testing.assert_allclose(marginal.solve(), gaussian.solve()[kept])
    np.testing.assert_allclose(marginal.covariance(), gaussian.covariance()[np.ix_(kept, kept)])
    assert marginal.rho2 == pytest.approx(gaussian.rho2)


def test_conditioning_is_that_of_covariances(gaussian):
    mean, P = gaussian.solve(), gaussian.covariance()
    given, b = np.array([0.3, -1.0, 2.0]), slice(2, 5)
    found = gaussian.condition({"b": given})
    others = [0, 1, 5]
    gain = P[others, b] @ np.linalg.inv(P[b, b])
    np.testing.assert_allclose(found.solve(), mean[others] + gain @ (given - mean[b]))
    np.testing.assert_allclose(
        found.covariance(), P[np.ix_(others, others)] - gain @ P[b, others], atol=1e-12
    )


def test_what_nothing_determines_is_zero():
    gaussian = Gaussian.of_rows({"x": 2}, np.array([[1.0, 1.0, 2.0]]))
    np.testing.assert_allclose(gaussian.solve(), [1.0, 1.0])
    with pytest.raises(np.linalg.LinAlgError):
        gaussian.covariance()
