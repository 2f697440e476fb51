"""A target that is right agrees with other logs within its uncertainty; a wrong one does not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, measured, true_psi

from cpid_drake import InputError, TargetPrior, identify, write_result
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.result import Combinations
from cpid_drake.identification.validation import validate
from cpid_drake.logs.simulated_noise import add_noise

SIGMA = np.array([0.3, *3 * [2e-3], *6 * [0.1]])
"""σ of an identified target that a log of 5 s determines better."""

SEEDS = 4


@pytest.fixture(scope="module")
def log(craft, suite, skewed_target):
    return measured(craft, Sines.drawn(4, 105, 5.0, 0.5), skewed_target, suite)


def target_of(parameters, sigma=SIGMA) -> TargetPrior:
    return TargetPrior("the result", parameters, np.diag(sigma**2))


@pytest.mark.parametrize("momentum_W", [None, MOMENTUM])
def test_the_right_target_is_valid(craft, suite, skewed_target, momentum_W):
    motion = Sines.drawn(4, 106, 5.0, 0.5)
    exact = measured(craft, motion, skewed_target, suite, momentum_W=momentum_W)
    target = target_of(skewed_target.to_vector(), 0.01 * SIGMA)
    found = validate(craft, target, add_noise(suite, exact, seed=2), sensors=suite)
    assert found.momentum == ("zero" if momentum_W is None else "unknown")
    assert found.in_sigma < 2
    for error in found.errors if momentum_W is None else ():  # else it is extrapolated as well
        assert error.rms < 5 * error.noise


@pytest.mark.parametrize(
    ("gap", "part", "close"),
    [((5.5, 6.7), (1.0, 5.5), ("attitude", "position")), ((2.0, 4.2), (5.2, 9.0), ("attitude",))],
    ids=["first", "later"],
)
def test_the_longest_part_without_a_gap_is_predicted(craft, suite, skewed_target, gap, part, close):
    """Behind the gap with a momentum of its own, so that a velocity is extrapolated."""
    exact = measured(craft, Sines.drawn(4, 105, 9.0, 0.5), skewed_target, suite)
    noisy, times = add_noise(suite, exact, seed=1), exact.encoders.time
    seen = (times < gap[0]) | (times > gap[1])
    log = noisy.updated({"encoders": noisy.encoders.where(seen)})
    found = validate(craft, target_of(skewed_target.to_vector(), 0.01 * SIGMA), log, sensors=suite)
    assert (found.start, found.end) == pytest.approx(part, abs=0.1)
    assert found.in_sigma < 2
    for error in found.errors:
        assert error.sensor not in close or error.rms < 3 * error.noise


def test_a_wrong_target_is_valid_only_if_it_is_uncertain(craft, suite, log, skewed_target):
    noisy = add_noise(suite, log, seed=1)
    heavier = skewed_target.to_vector() * np.array([1.05, *np.ones(9)])
    sure = validate(craft, target_of(heavier, 0.05 * SIGMA), noisy, sensors=suite)
    assert not sure.is_target_right
    assert sure.errors[0].rms > 5 * sure.errors[0].noise
    modest = validate(craft, target_of(heavier, 10 * SIGMA), noisy, sensors=suite)
    assert modest.is_target_right
    assert modest.heavier > 0.1 > 10 * sure.heavier


def test_what_is_noticed_is_as_uncertain_as_target_and_log_together(
    craft, suite, log, skewed_target
):
    """Targets that are nearly exact, and as uncertain as the log or more: variances add."""
    noisy, truth = add_noise(suite, log, seed=1), skewed_target.to_vector()
    of_log, *squares = (
        validate(craft, target_of(truth, factor * SIGMA), noisy, sensors=suite).heavier ** 2
        for factor in (1e-4, 0.1, 0.2)
    )
    assert of_log > 0.01 * squares[0]
    assert squares[1] - of_log == pytest.approx(4 * (squares[0] - of_log), rel=0.05)


@pytest.mark.parametrize("sigmas", [5, 40])
def test_a_mass_wrong_by_some_sigma_is_not_valid(craft, suite, log, skewed_target, sigmas):
    """The log is explained, by another target, and its prediction has hardly larger errors."""
    sigma = SIGMA * np.array([0.1, *np.ones(9)])
    heavier = skewed_target.to_vector() + sigmas * sigma * (np.arange(10) == 0)
    found = validate(craft, target_of(heavier, sigma), add_noise(suite, log, seed=1), sensors=suite)
    assert found.in_sigma < 2
    assert not found.is_target_right
    assert found.probability < 10.0 ** -(sigmas / 2.5)


@pytest.mark.slow
def test_right_targets_pass_and_heavier_ones_are_noticed_as_often_as_stated(
    craft, suite, log, skewed_target
):
    sigma, rng, heavier = 0.1 * SIGMA, np.random.default_rng(5), 0.0
    chi_squared, noticed = 0.0, {0.3: 0, 1.0: 0}
    for seed in range(SEEDS):
        target = skewed_target.to_vector() + sigma * rng.normal(size=10)
        noisy = add_noise(suite, log, seed=seed)
        found = checked(craft, target_of(target, sigma), noisy, suite)
        assert found.is_target_right
        assert found.freedom == 10
        chi_squared += found.chi_squared
        heavier = found.heavier
        for share in noticed:
            wrong = target * np.where(np.arange(10) == 0, 1 + share * heavier, 1.0)
            wrong = checked(craft, target_of(wrong, sigma), noisy, suite)
            noticed[share] += not wrong.is_target_right
    low, high = chi2.ppf([0.001, 0.999], 10 * SEEDS)
    assert low < chi_squared < high
    assert 0.001 < heavier < 0.01
    assert noticed[1.0] >= SEEDS - 1
    assert noticed[0.3] <= 1


def checked(craft, target, log, suite):
    return validate(craft, target, log, sensors=suite, momentum=TotalMomentum.zero())


def test_an_error_of_the_logs_sensors_does_not_reject_the_right_target(
    craft, suite, log, skewed_target
):
    """A gyro scale that nobody states is estimated, as in any identification."""
    noisy = add_noise(suite, log, seed=1)
    silent = replace(suite, unstated=None)
    scaled = replace(noisy.gyro, value=(1 + 3e-4) * noisy.gyro.value)
    target = target_of(skewed_target.to_vector(), 0.05 * SIGMA)
    found = validate(craft, target, noisy.updated({"gyro": scaled}), sensors=silent)
    assert found.is_target_right


@pytest.mark.slow
def test_a_result_is_a_target_and_its_file_needs_a_spacecraft(
    craft, suite, log, skewed_target, tmp_path
):
    """What `identify` returns has no spacecraft by name: in a file its capture frame is lost."""
    exact = measured(craft, Sines.drawn(4, 107, 5.0, 0.5), skewed_target, suite)
    found = identify(craft, add_noise(suite, exact, seed=3), sensors=suite)
    other = add_noise(suite, log, seed=4)
    assert validate(craft, found, other, sensors=suite).is_target_right
    heavier = found.parameters + 8 * np.sqrt(found.covariance[0, 0]) * np.eye(10)[0]
    wrong = replace(found, parameters=heavier, combinations=None)
    assert not validate(craft, wrong, other, sensors=suite).is_target_right
    write_result(tmp_path / "found.json", found)
    with pytest.raises(InputError, match=r"found\.json: the result names no spacecraft"):
        validate(craft, tmp_path / "found.json", other, sensors=suite)


def test_only_the_combinations_that_are_known_are_tested(craft, suite, log, skewed_target):
    """A target that is wrong in one combination fails, and passes if that combination is open."""
    psi, is_one = true_psi(craft, skewed_target), np.arange(10) == 4
    information = np.diag((1e-3 * (np.abs(psi) + 1.0)) ** -2.0)
    nothing = np.full(10, np.nan), np.full((10, 10), np.nan)
    noisy = add_noise(suite, log, seed=1)
    found = []
    for known in (information, information * ~is_one * ~is_one[:, None]):
        values = Combinations("relative", psi * np.where(is_one, 1.1, 1.0), known, craft.mass)
        found.append(checked(craft, TargetPrior("p", *nothing, values), noisy, suite))
    assert [each.is_target_right for each in found] == [False, True]


def test_a_log_that_cannot_be_predicted_is_refused(craft, suite, log, skewed_target):
    target = target_of(skewed_target.to_vector())
    with pytest.raises(InputError, match="too short"):
        validate(craft, target, log.between(0.0, 1.2), sensors=suite)
    blind = replace(log, samples={n: s for n, s in log.samples.items() if n != "attitude"})
    with pytest.raises(InputError, match="no samples of"):
        validate(craft, target, blind, sensors=suite)
