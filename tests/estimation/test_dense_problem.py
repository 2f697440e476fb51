"""The fit and the Cramér-Rao bound, against one dense least-squares problem of the whole log.

The dense problem knows no blocks and no derivatives: readings are predicted by `propagate_base`
with the true joint motion, and differentiated by differences. Encoders are as good as perfect.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    momentum_about_com,
    small_craft,
    true_psi,
)

from cpid_drake import identify
from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.dynamics.parameterizations import parameters_to_standard
from cpid_drake.dynamics.sensitivity import perturbed, with_errors
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.fit_setup import cramer_rao_bound
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import Gyro, JointSensor

SUITE = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0), encoders=JointSensor(50.0, 0.0))
BODIES = BodyUncertainty(mass=0.02)
STEPS = np.array([1e-2, *3 * [1e-4], *6 * [1e-2], *3 * [1e-5], *3 * [1e-3], *3 * [1e-5]])


class Dense:
    """All unknowns of a log: π, attitude and position at the start, gyro bias, [L; P], bodies."""

    def __init__(self, craft, motion, samples, momentum_W, bodies=None):
        self.craft, self.motion, self.samples, self.bodies = craft, motion, samples, bodies
        self.momentum_W = momentum_W
        count = 0 if bodies is None else len(craft.tree.bodies)
        momentum = [] if momentum_W is None else 6 * [1e-2]
        self.steps = np.concatenate([STEPS, momentum, count * [0.1]])
        self.of_bodies = slice(len(self.steps) - count, None)
        times = [samples[n].time for n in ("attitude", "gyro", "position")]
        self.times = np.unique(np.round(np.concatenate([[0.0], *times]), 9))
        self.index = [np.searchsorted(self.times, np.round(t, 9)) for t in times]

    def residuals(self, x):
        """Return measured minus predicted (N, M) in σ for unknowns (N, K), then the prior's."""
        errors, group = np.unique(x[:, self.of_bodies], axis=0, return_inverse=True)
        readings = [self.of_tree(x[group == k]) for k in range(len(errors))]
        order = np.argsort(np.argsort(group, kind="stable"))
        prior = [x[:, 16:19] / SUITE.gyro.bias_sigma, x[:, self.of_bodies]]
        return np.hstack([np.concatenate(readings)[order], *(-part for part in prior)])

    def of_tree(self, x):
        tree, momentum_W = self.craft.tree, self.momentum_W
        if self.bodies is not None:
            tree = with_errors(tree, self.bodies, x[0, self.of_bodies])
        if momentum_W is not None:
            momentum_W = momentum_W + x[:, 19:25]
        base = propagate_base(
            tree,
            self.motion,
            np.stack([parameters_to_standard(pi) for pi in x[:, :10]]),
            self.times,
            quaternion_WB=Rotation.from_rotvec(x[:, 10:13]).as_quat(scalar_first=True),
            p_WB=x[:, 13:16],
            momentum_W=momentum_W,
            max_step=0.1,
        )
        rows = []
        for k in range(len(x)):
            R, log = Rotation.from_quat(base.quaternion_WB[k], scalar_first=True), self.samples
            measured_R = Rotation.from_quat(log.attitude.value, scalar_first=True)
            turn = (R[self.index[0]].inv() * measured_R).as_rotvec() @ SUITE.attitude.R_BS
            w = R[self.index[1]].inv().apply(base.w_WB[k, self.index[1]]) + x[k, 16:19]
            p = base.p_WB[k, self.index[2]]
            parts = [
                turn / SUITE.sigmas("attitude"),
                (log.gyro.value - w) / SUITE.sigmas("gyro"),
                (log.position.value - p) / SUITE.sigmas("position"),
            ]
            rows.append(np.concatenate([part.ravel() for part in parts]))
        return np.array(rows)

    def jacobian(self, x):
        moves = np.diag(self.steps)
        values = self.residuals(np.concatenate([x + moves, x - moves]))
        ahead, behind = np.split(values, 2)
        return ((behind - ahead) / (2 * self.steps[:, None])).T

    def solved(self, x, steps=2):
        """Return the minimum, the covariance there and χ², by Gauss-Newton steps."""
        for _ in range(steps):
            J, r = self.jacobian(x), self.residuals(x[None])[0]
            scale = np.linalg.norm(J, axis=0)
            x = x + np.linalg.lstsq(J / scale, r, rcond=None)[0] / scale
        J = J / scale
        chi_squared = np.sum(self.residuals(x[None]) ** 2)
        return x, np.linalg.inv(J.T @ J) / scale / scale[:, None], chi_squared


def close(covariance, expected, rtol):
    """Assert that σ and correlations agree."""
    sigma, right = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(expected))
    np.testing.assert_allclose(sigma, right, rtol=rtol)
    one, other = covariance / np.outer(sigma, sigma), expected / np.outer(right, right)
    np.testing.assert_allclose(one, other, rtol=0, atol=rtol)


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


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
    dense = Dense(craft, motion, samples, momentum_W)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector()
    J = dense.jacobian(x)
    expected = np.linalg.inv(J.T @ J)[:10, :10]
    psi = true_psi(craft, skewed_target)
    bound = cramer_rao_bound(craft.tree, psi, samples, SUITE, momentum=told)
    close(bound, expected, 1e-3)


@pytest.mark.parametrize("case", [MOMENTUM], indirect=True, ids=["tumbling"])
def test_the_fit_is_the_minimum_of_the_dense_problem(craft, case, skewed_target):
    """Estimate, covariance and χ², from another start."""
    motion, samples, momentum_W, told = case
    noisy = add_noise(SUITE, samples, 1)
    dense = Dense(craft, motion, noisy, momentum_W)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector() * 1.01
    x, covariance, chi_squared = dense.solved(x)
    sigma = np.sqrt(np.diag(covariance))[:10]
    found = identify(craft, noisy, sensors=SUITE, momentum=told, is_final=False)
    assert np.abs((found.parameters - x[:10]) / sigma).max() < 0.05
    close(found.covariance, covariance[:10, :10], 0.02)
    freedom = sum(3 * len(noisy[n]) for n in ("attitude", "gyro", "position")) + 3 - len(x)
    assert chi2.ppf(1e-4, freedom) < chi_squared < chi2.isf(1e-4, freedom)
    assert found.misfit == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("case", [MOMENTUM], indirect=True, ids=["tumbling"])
def test_errors_of_the_known_bodies_are_unknowns_with_a_prior(craft, case, skewed_target):
    """Masses of all bodies, of a spacecraft that is not its model: σ is never too small."""
    motion, _, momentum_W, told = case
    tree = perturbed(craft.tree, BODIES, np.random.default_rng(3))
    exact = measured(craft, motion, skewed_target, SUITE, momentum_W, tree=tree)
    noisy = add_noise(SUITE, exact, 1)
    dense = Dense(craft, motion, noisy, momentum_W, BODIES)
    x = np.zeros(len(dense.steps))
    x[:10] = skewed_target.to_vector()
    x, covariance, _ = dense.solved(x)
    sigma = np.sqrt(np.diag(covariance))[:10]
    found = identify(
        craft, noisy, sensors=SUITE, momentum=told, known_bodies=BODIES, is_final=False
    )
    ratio = np.sqrt(np.diag(found.covariance)) / sigma
    assert (ratio > 0.97).all()
    assert (ratio < 1.6).all()
    assert np.abs((found.parameters - x[:10]) / sigma).max() < 0.5
