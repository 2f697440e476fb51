"""The covariance of the target from an information matrix, and its derivative."""

import numpy as np
import pytest

from cpid_drake.planning.covariance import TargetCovariance

UNKNOWNS, BODIES = 14, 6


def information(seed=1, bodies=BODIES) -> np.ndarray:
    """Two random information matrices (2, n, n)."""
    n = UNKNOWNS + bodies
    H = np.random.default_rng(seed).normal(size=(2, 30, n))
    return np.swapaxes(H, 1, 2) @ H


def test_without_uncertain_bodies_it_is_the_inverse():
    F = information(bodies=0)
    expected = np.linalg.inv(F)[:, -10:, -10:]
    np.testing.assert_allclose(TargetCovariance(F, UNKNOWNS).psi, expected, rtol=1e-9)


def test_bodies_estimated_to_first_order_have_a_prior_of_one():
    F = information()
    joint = F + np.diag([0.0] * UNKNOWNS + [1.0] * BODIES)
    expected = np.linalg.inv(joint)[:, UNKNOWNS - 10 : UNKNOWNS, UNKNOWNS - 10 : UNKNOWNS]
    np.testing.assert_allclose(TargetCovariance(F, UNKNOWNS).psi, expected, rtol=1e-9)


def test_curvature_bounds_what_the_samples_tell_about_the_bodies():
    """As `BlockState.with_estimated_bodies`: the variance is 1/(1 + λ/(1 + c²λ)) for each λ."""
    F, c = information()[:1], 0.5
    A, B, D = F[0, :UNKNOWNS, :UNKNOWNS], F[0, :UNKNOWNS, UNKNOWNS:], F[0, UNKNOWNS:, UNKNOWNS:]
    gain = np.linalg.solve(A, B)
    size, axes = np.linalg.eigh(D - B.T @ gain)
    variances = 1 / (1 + size / (1 + c**2 * size))
    expected = np.linalg.inv(A) + gain @ (axes * variances) @ axes.T @ gain.T
    found = TargetCovariance(F, UNKNOWNS, c).psi[0]
    np.testing.assert_allclose(found, expected[-10:, -10:], rtol=1e-9)


@pytest.mark.parametrize(("bodies", "curvature"), [(0, 0.0), (BODIES, 0.0), (BODIES, 0.5)])
def test_weights_are_the_derivative(bodies, curvature):
    F, change = information(1, bodies), information(2, bodies)
    directions = np.random.default_rng(3).normal(size=(4, 10))
    left, right = TargetCovariance(F, UNKNOWNS, curvature).weights(1, directions)
    found = np.einsum("vri,ij,vrj->v", left, change[1], right)
    h = 1e-5

    def variances(step: float) -> np.ndarray:
        covariance = TargetCovariance(F + step * change, UNKNOWNS, curvature).psi[1]
        return np.einsum("vi,ij,vj->v", directions, covariance, directions)

    expected = (variances(h) - variances(-h)) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
