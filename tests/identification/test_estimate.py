"""What a fit's Gaussian says in a result's terms: target, constant errors and momentum."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from sensing_cases import MOMENTUM, coarse_suite, momentum_about_com, true_psi

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.estimate import at_momentum, effects_of, momentum_of, solution_of
from cpid_drake.logs.simulated_noise import add_noise

SUITE = replace(coarse_suite(), gyro=replace(coarse_suite().gyro, scale_ppm=300.0))

SCALE = np.array([300.0, -200.0, 100.0])  # of the gyro, too much [ppm]


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, MOMENTUM, 4.0)


@pytest.fixture(scope="module")
def found(case):
    model = Model(case.craft.tree, SUITE)
    samples = add_noise(coarse_suite(), case.samples, 0)
    gyro = samples["gyro"]
    gyro = replace(gyro, value=gyro.value * (1 + 1e-6 * SCALE))
    return fit(model, [LogState.of(model, samples.updated({"gyro": gyro}))])


def test_a_vague_prior_is_no_information(found):
    """Of the samples' information and the prior's, only that of the samples is in the solution."""
    solution = solution_of(found.model, found.values, found.gaussian)
    prior = next(each for each in found.model.table if each.name == PSI)
    both = np.linalg.inv(found.gaussian.marginal([PSI]).covariance())
    expected = both - np.diag(prior.sigma**-2.0)
    scale = found.model.plausible
    np.testing.assert_allclose(
        solution.information * scale * scale[:, None],
        expected * scale * scale[:, None],
        atol=1e-6 * np.abs(expected * scale * scale[:, None]).max(),
    )
    assert solution.is_observable


def test_a_guess_remains_in_the_solution(case, found):
    """With a guess of the true target, ten times as exact as the samples know it."""
    psi = true_psi(case.craft, case.target)
    sigma = np.sqrt(np.diag(found.gaussian.marginal([PSI]).covariance())) / 10
    model = found.model.with_prior(PSI, psi, sigma)
    guessed = fit(model, found.logs, values=found.values)
    solution = solution_of(model, guessed.values, guessed.gaussian)
    width = np.sqrt(np.diag(solution.covariance))
    assert (width < 1.01 * sigma).all()
    assert (np.abs(solution.estimate - psi) < 4 * sigma).all()


def test_the_momentum_is_estimated_or_a_condition(case, found):
    """The estimate is within its σ of the truth; with the true one, the target is known better."""
    true = momentum_about_com(case.craft, case.motion, case.target, MOMENTUM)
    free = momentum_of(found.model, found.values, found.gaussian, "log")
    error = free.value - np.concatenate([true.L_WScm_W, true.v_WScm_W])
    assert error @ np.linalg.solve(free.covariance, error) < 22.5  # 99.9 % of χ² with 6
    known = at_momentum(found.gaussian, found.values, true, "log")
    assert momentum_of(found.model, found.values, known, "log") is None
    both = [solution_of(found.model, found.values, each) for each in (found.gaussian, known)]
    assert (np.diag(both[1].covariance) < np.diag(both[0].covariance)).all()
    error = both[1].estimate - true_psi(case.craft, case.target)
    assert error @ np.linalg.solve(both[1].covariance, error) < 29.6  # 99.9 % of χ² with 10
    same = at_momentum(found.gaussian, found.values, TotalMomentum.unknown(), "log")
    assert same is found.gaussian


def test_a_constant_error_has_its_unit(found):
    """A gyro that shows up to 300 ppm too much: found within its σ, in ppm."""
    (effect,) = effects_of(found.model, found.values, found.gaussian, "log")
    assert (effect.name, effect.unit, effect.prior_sigma) == ("gyro.scale", "ppm", 300.0)
    assert (effect.sigma < 60.0).all()
    assert (np.abs(effect.value - SCALE) < 4 * effect.sigma).all()
