"""The fit and the Cramér-Rao bound, against one dense least-squares problem of the whole log."""

from dataclasses import replace

import numpy as np
import pytest
from dense_problem import Dense
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    momentum_about_com,
    true_psi,
)

from cpid_drake import identify
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import Gyro, JointSensor

SUITE = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0), encoders=JointSensor(50.0, 0.0))
BODIES = BodyUncertainty(mass=0.02)


def close(covariance, expected, rtol):
    """Assert that σ and correlations agree."""
    sigma, right = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(expected))
    np.testing.assert_allclose(sigma, right, rtol=rtol)
    one, other = covariance / np.outer(sigma, sigma), expected / np.outer(right, right)
    np.testing.assert_allclose(one, other, rtol=0, atol=rtol)


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def case(request, craft, skewed_target):
    """Return motion, samples without noise, momentum and what is told of it."""
    motion, momentum_W = Sines.drawn(4, seed=101, duration=5.0, size=0.6), request.param
    told = TotalMomentum.zero()
    if momentum_W is not None:
        about_com = momentum_about_com(craft, motion, skewed_target, momentum_W)
        told = TotalMomentum.unknown(about_com)
    return motion, measured(craft, motion, skewed_target, SUITE, momentum_W), momentum_W, told


def test_the_bound_is_that_of_the_dense_problem(craft, case, skewed_target):
    motion, samples, momentum_W, told = case
    dense = Dense(craft, motion, SUITE, samples, momentum_W)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector()
    J = dense.jacobian(x)
    expected = np.linalg.inv(J.T @ J)[:10, :10]
    psi = true_psi(craft, skewed_target)
    bound = cramer_rao_bound(craft.tree, psi, samples, SUITE, momentum=told)
    close(bound, expected, 1e-3)


def with_noise(suite, noise):
    """Return sensors with the noise that a fit found."""
    a, g, p = suite.attitude, suite.gyro, suite.position
    arcsec = noise["attitude"] * np.array([a.cross_boresight_arcsec, a.boresight_arcsec])
    return replace(
        suite,
        attitude=replace(a, cross_boresight_arcsec=arcsec[0], boresight_arcsec=arcsec[1]),
        gyro=replace(g, angle_random_walk=noise["gyro"] * g.angle_random_walk),
        position=replace(p, sigma=noise["position"] * p.sigma),
    )


@pytest.mark.parametrize("case", [MOMENTUM], indirect=True, ids=["tumbling"])
def test_the_fit_is_the_minimum_of_the_dense_problem(craft, case, skewed_target):
    """Estimate, covariance and χ², from another start."""
    motion, samples, momentum_W, told = case
    noisy = add_noise(SUITE, samples, 1)
    found = identify(craft, noisy, sensors=SUITE, momentum=told)
    dense = Dense(craft, motion, with_noise(SUITE, found.noise), noisy, momentum_W)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector() * 1.01
    x, covariance, chi_squared = dense.solved(x)
    sigma = np.sqrt(np.diag(covariance))[:10]
    assert np.abs((found.parameters - x[:10]) / sigma).max() < 0.05
    close(found.covariance, covariance[:10, :10], 0.02)
    freedom = sum(3 * len(noisy[n]) for n in ("attitude", "gyro", "position")) + 3 - len(x)
    assert chi2.ppf(1e-4, freedom) < chi_squared < chi2.isf(1e-4, freedom)
    assert found.failures == ()


@pytest.mark.slow
@pytest.mark.parametrize("case", [MOMENTUM], indirect=True, ids=["tumbling"])
def test_errors_of_the_known_bodies_are_unknowns_with_a_prior(craft, case, skewed_target):
    """Masses of all bodies, of a spacecraft that is not its model: σ is never too small."""
    motion, _, momentum_W, told = case
    tree = perturbed(craft.tree, BODIES, np.random.default_rng(3))
    exact = measured(craft, motion, skewed_target, SUITE, momentum_W, tree=tree)
    noisy = add_noise(SUITE, exact, 1)
    found = identify(craft, noisy, sensors=SUITE, momentum=told, known_bodies=BODIES)
    dense = Dense(craft, motion, with_noise(SUITE, found.noise), noisy, momentum_W, BODIES)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector()
    x, covariance, _ = dense.solved(x)
    sigma = np.sqrt(np.diag(covariance))[:10]
    ratio = np.sqrt(np.diag(found.covariance)) / sigma
    assert (ratio > 0.97).all()
    assert (ratio < 1.6).all()
    assert np.abs((found.parameters - x[:10]) / sigma).max() < 0.5
