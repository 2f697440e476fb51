"""The cone of the targets, its coordinates, and the most probable target inside of it."""

import numpy as np
import pytest
from scipy.linalg import logm
from scipy.optimize import minimize

from cpid_drake import InertialParameters
from cpid_drake.dynamics.parameterizations import (
    relative_parameterization,
    standard_to_pseudo_inertia,
)
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.target import LOG_SIZE, WIDENED, TargetCone

MASS = 400.0
FORM = relative_parameterization(MASS)


def psi_of(mass, com, moments):
    return FORM.from_parameters(InertialParameters(mass, com, np.diag(moments)).to_vector())


SOLID = psi_of(40.0, [0.0, 0.0, 0.0], [5.0, 5.0, 5.0])
CONE = TargetCone(SOLID, MASS)
FLAT = psi_of(60.0, [0.4, -0.1, 0.2], [6.0, 4.0, 10.0])


def pseudo_inertia(psi):
    parameters = FORM.to_parameters(psi)
    return standard_to_pseudo_inertia(
        InertialParameters.from_vector(parameters).to_standard_vector()
    )


def told(psi, sigma, axes=None):
    """Return rows about a ψ, of the combinations `axes` (k, 10)."""
    axes = np.eye(10) if axes is None else axes
    return Gaussian.of_rows({"psi": 10}, np.column_stack([axes, axes @ psi]) / sigma)


def value(known, psi):
    xi = CONE.log_size(psi)[0] / LOG_SIZE
    return known.cost(psi) + xi @ xi


def unit(psi):
    """Return how far ψ may go (10, 10) until a log-size changes by about one."""
    return np.linalg.inv(CONE.log_size(psi)[1])


@pytest.mark.parametrize("psi", [SOLID, FLAT, psi_of(2000.0, [3.0, 1.0, 0.0], [3e4, 4e4, 2e4])])
def test_log_sizes_are_matrix_logarithms_about_the_solid(psi):
    """And their derivative is that of central differences."""
    xi, by = CONE.log_size(psi)
    added = WIDENED * pseudo_inertia(SOLID)
    L = np.linalg.cholesky(pseudo_inertia(SOLID) + added)
    inside = np.linalg.solve(L, np.linalg.solve(L, pseudo_inertia(psi) + added).T)
    assert xi @ xi == pytest.approx(np.sum(logm(inside).real ** 2), rel=1e-6, abs=1e-12)
    for k, size in enumerate(1e-6 * np.abs(unit(psi)).max(axis=1)):
        step = size * np.eye(10)[k]
        slope = (CONE.log_size(psi + step)[0] - CONE.log_size(psi - step)[0]) / 2 / size
        np.testing.assert_allclose(by[:, k], slope, atol=1e-5 * np.abs(by[:, k]).max())


def test_the_cone_is_a_little_wider_than_that_of_rigid_bodies():
    """A flat body is inside, and one that noise puts beyond; a body of negative mass is not."""
    assert CONE.contains(FLAT)
    assert CONE.contains(FLAT + [0, 0, 0, 0, 0, 0, 0, 0, 0, 0.05 * SOLID[9]])
    assert not CONE.contains(-SOLID)
    assert not CONE.contains(np.full(10, np.nan))
    assert not CONE.contains(np.append(1.01 * MASS, SOLID[1:]))


@pytest.mark.parametrize("seed", range(4))
def test_the_most_probable_target_is_a_minimum(seed):
    """Of strong rows, of rows of few combinations, and of rows that no rigid body explains."""
    rng = np.random.default_rng(seed)
    psi = psi_of(30.0 * 2.0**seed, 0.4 * rng.standard_normal(3), [4.0, 5.0, 6.0])
    axes = rng.standard_normal((10, 10)) / np.abs(SOLID).max()
    axes = axes[: 3 + seed % 4 * 2]
    noisy = psi + rng.standard_normal(10) * np.abs(SOLID).max() * [0.0, 1.0][seed % 2]
    known = told(noisy, 1e-3, axes)
    found = CONE.most_probable(known)
    assert CONE.contains(found)
    least = value(known, found)
    for start in (found, psi):
        other = minimize(
            lambda x: value(known, x) if CONE.contains(x) else 1e300,
            start,
            method="Nelder-Mead",
            options={"maxiter": 1500, "initial_simplex": start + simplex(start)},
        )
        assert least < other.fun * (1 + 1e-4) + 1e-4


def simplex(psi):
    return np.vstack([np.zeros(10), 0.05 * unit(psi).T])


def test_strong_rows_are_not_moved_by_the_prior():
    """Also of a target that is five hundred times as large as the solid."""
    psi = psi_of(2000.0, [3.0, 1.0, 0.0], [3e4, 4e4, 2e4])
    sigma = 1e-4 * np.abs(unit(psi)).max(axis=1)
    known = Gaussian.of_rows({"psi": 10}, np.column_stack([np.diag(1 / sigma), psi / sigma]))
    np.testing.assert_allclose((CONE.most_probable(known) - psi) / sigma, 0.0, atol=0.01)
    np.testing.assert_allclose((CONE.start(known) - psi) / sigma, 0.0, atol=0.1)


@pytest.mark.parametrize("psi", [FLAT, psi_of(2000.0, [3.0, 1.0, 0.0], [3e4, 4e4, 2e4])])
def test_the_prior_is_that_of_the_log_sizes(psi):
    """To first order, far from the solid; and far outside of the cone it is some prior."""
    prior = CONE.prior("psi", psi)
    step = 1e-4 * unit(psi) @ np.random.default_rng(0).standard_normal(10)
    xi = CONE.log_size(psi + step)[0] / LOG_SIZE
    assert prior.cost(step) == pytest.approx(xi @ xi, rel=1e-6)
    assert np.isfinite(CONE.prior("psi", -psi).covariance()).all()
