"""A target that is right predicts other logs within its uncertainty; a wrong one does not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, true_psi

from cpid_drake import InputError, TargetPrior
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.prediction import predicted
from cpid_drake.identification.fit_setup import recursive_fit
from cpid_drake.identification.target_prior import Combinations
from cpid_drake.identification.validation import validate
from cpid_drake.sensing.noise import add_noise

SIGMA = np.array([0.3, *3 * [2e-3], *6 * [0.1]])
"""σ of an identified target whose uncertainty dominates the errors of predictions."""

SEEDS = 8


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()


@pytest.fixture(scope="module")
def log(craft, suite, skewed_target):
    return measured(craft, Sines.drawn(4, 105, 5.0, 0.5), skewed_target, suite)


def target_of(parameters, sigma=SIGMA) -> TargetPrior:
    return TargetPrior("the result", parameters, np.diag(sigma**2))


@pytest.mark.slow
def test_errors_of_the_right_target_are_chi_squared(craft, suite, log, skewed_target):
    """Targets that err as their covariance says predict with errors as their covariance says."""
    form, psi = relative_parameterization(craft.mass), true_psi(craft, skewed_target)
    fit = recursive_fit(craft, suite)
    rng = np.random.default_rng(3)
    last = {"attitude": [], "position": [], "gyro": []}
    for seed in range(60):
        target = target_of(skewed_target.to_vector() + SIGMA * rng.normal(size=10))
        guess = form.from_parameters(target.parameters)
        noisy = add_noise(suite, log, seed=seed)
        blocks = blocks_of(BlockQueue.of(suite), [noisy])
        rows = target.rows(form, guess, np.abs(psi) + 1.0)
        found = predicted(fit, guess, rows, blocks, 1.5, tested=False)
        assert found.is_complete
        for name, squares in last.items():
            squares.append(found.sensors[name].squares[-1])
    for squares in last.values():
        assert kstest(squares, "chi2", args=(3,)).pvalue > 0.01 / len(last)
        assert np.mean(squares) == pytest.approx(3, rel=0.3)


@pytest.mark.parametrize("momentum_W", [None, MOMENTUM])
def test_the_right_target_is_valid(craft, suite, skewed_target, momentum_W):
    motion = Sines.drawn(4, 106, 5.0, 0.5)
    exact = measured(craft, motion, skewed_target, suite, momentum_W=momentum_W)
    target = target_of(skewed_target.to_vector(), 0.01 * SIGMA)
    found = validate(craft, target, add_noise(suite, exact, seed=2), sensors=suite)
    assert found.momentum == ("zero" if momentum_W is None else "unknown")
    assert found.in_sigma < 2
    assert found.warnings == ()
    for error in found.errors:
        assert error.rms < 0.2 * error.without_target


def test_a_wrong_target_is_not_valid(craft, suite, log, skewed_target):
    noisy = add_noise(suite, log, seed=1)
    heavier = skewed_target.to_vector() * np.array([1.05, *np.ones(9)])
    sure = validate(craft, target_of(heavier, 0.05 * SIGMA), noisy, sensors=suite)
    assert sure.in_sigma > 5
    modest = validate(craft, target_of(heavier, 10 * SIGMA), noisy, sensors=suite)
    assert modest.in_sigma < 2


def test_a_mass_wrong_by_forty_sigma_is_not_valid(craft, suite, log, skewed_target):
    """The usual error of so many samples remains below 3 σ, and χ² of the target does not."""
    sigma = SIGMA * np.array([0.1, *np.ones(9)])
    heavier = skewed_target.to_vector() + 40 * sigma * (np.arange(10) == 0)
    found = validate(craft, target_of(heavier, sigma), add_noise(suite, log, seed=1), sensors=suite)
    assert found.in_sigma < 3
    assert not found.is_target_right
    assert found.probability < 1e-6


@pytest.mark.slow
def test_right_targets_pass_and_heavier_ones_are_noticed_as_often_as_stated(
    craft, suite, log, skewed_target
):
    sigma, rng, heavier = 0.1 * SIGMA, np.random.default_rng(5), 0.0
    chi_squared, noticed = [], {0.3: 0, 1.0: 0}
    for seed in range(SEEDS):
        target = skewed_target.to_vector() + sigma * rng.normal(size=10)
        noisy = add_noise(suite, log, seed=seed)
        found = checked(craft, target_of(target, sigma), noisy, suite)
        assert found.is_target_right
        chi_squared.append([test.chi_squared for test in all_tests(found)])
        heavier = found.test.heavier
        for share in noticed:
            wrong = target * np.where(np.arange(10) == 0, 1 + share * heavier, 1.0)
            wrong = checked(craft, target_of(wrong, sigma), noisy, suite)
            noticed[share] += not wrong.is_target_right
    freedom = np.array([test.freedom for test in all_tests(found)])
    low, high = chi2.ppf([[0.001], [0.999]], SEEDS * freedom)
    assert (low < np.sum(chi_squared, axis=0)).all()
    assert (np.sum(chi_squared, axis=0) < high).all()
    assert 0.001 < heavier < 0.01
    assert noticed[1.0] >= SEEDS - 2
    assert noticed[0.3] <= 2


def checked(craft, target, log, suite):
    return validate(craft, target, log, sensors=suite, momentum=TotalMomentum.zero())


def all_tests(found):
    return [found.test, *(error.test for error in found.errors)]


def test_noise_that_is_larger_than_declared_does_not_reject_the_right_target(
    craft, suite, log, skewed_target
):
    """The beginning shows the noise; the test of the target is less sharp, and says so."""
    target = target_of(skewed_target.to_vector(), 1e-3 * SIGMA)
    noisy = add_noise(suite, log, seed=1)
    samples = dict(noisy.samples)
    for name in ("attitude", "gyro", "position"):
        ideal, seen = log.samples[name].value, noisy.samples[name].value
        samples[name] = replace(samples[name], value=ideal + 2 * (seen - ideal))
    louder = checked(craft, target, replace(noisy, samples=samples), suite)
    assert louder.is_target_right
    assert louder.test.heavier > checked(craft, target, noisy, suite).test.heavier


def test_combinations_alone_predict_what_they_determine(craft, suite, log, skewed_target):
    """A target of which one combination is open predicts with a larger expected error."""
    psi = true_psi(craft, skewed_target)
    information = np.diag((1e-4 * (np.abs(psi) + 1.0)) ** -2.0)
    nothing = np.full(10, np.nan), np.full((10, 10), np.nan)
    noisy = add_noise(suite, log, seed=1)
    expected = []
    for known in (information, information * (np.arange(10)[:, None] != 4) * (np.arange(10) != 4)):
        target = TargetPrior("p", *nothing, Combinations("relative", psi, known))
        found = validate(craft, target, noisy, sensors=suite)
        assert found.in_sigma < 2
        expected.append(found.errors[0].expected)
    assert expected[1] > 1.5 * expected[0]


def test_a_log_that_cannot_be_predicted_is_refused(craft, suite, log, skewed_target):
    target = target_of(skewed_target.to_vector())
    with pytest.raises(InputError, match="too short"):
        validate(craft, target, log.between(0.0, 1.2), sensors=suite)
    blind = replace(log, samples={n: s for n, s in log.samples.items() if n != "attitude"})
    with pytest.raises(InputError, match="no samples of"):
        validate(craft, target, blind, sensors=suite)
