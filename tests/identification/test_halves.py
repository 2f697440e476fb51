"""Two halves of smoothed samples have the same target, unless the world is not as modelled."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import TotalMomentum, identify
from cpid_drake.dynamics.rows import STANDARD_ROWS
from cpid_drake.estimation.combination import SourceRows, agreement
from cpid_drake.estimation.momentum_rows import SmoothedRows, solve_smoothed_rows
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.smoothing import smooth_windows

SEEDS = range(1, 13)


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()


@pytest.fixture(scope="module")
def ideal(craft, suite, skewed_target):
    """Returns samples without noise of a true spacecraft whose base is heavier by a factor."""

    def samples(heavier=1.0):
        tree = craft.tree
        base, *others = tree.bodies
        base = replace(base, mass=heavier * base.mass, I_BBcm=heavier * base.I_BBcm)
        motion = Sines.drawn(4, seed=101, duration=12.0, size=0.6)
        true = replace(tree, bodies=(base, *others))
        return measured(craft, motion, skewed_target, suite, tree=true)

    return samples


def windows(craft, suite, samples):
    return list(smooth_windows([samples], suite, with_position=True, normal_B=None))


def agreement_of_halves(craft, suite, samples, momentum):
    smoothed = SmoothedRows(craft.tree, STANDARD_ROWS, momentum)
    for window in windows(craft, suite, samples):
        smoothed.add(window)
    return smoothed.agreement()


@pytest.mark.parametrize("momentum", [TotalMomentum.zero(), TotalMomentum.unknown()])
def test_chi_squared_of_clean_samples_has_its_distribution(craft, suite, ideal, momentum):
    samples = ideal()
    found = [
        agreement_of_halves(craft, suite, add_noise(suite, samples, seed=seed), momentum)
        for seed in SEEDS
    ]
    assert {each.freedom for each in found} == {16 if momentum.is_unknown else 10}
    total, freedom = sum(each.chi_squared for each in found), sum(each.freedom for each in found)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], freedom)
    assert low < total < high
    assert min(each.probability for each in found) > 1e-3


@pytest.mark.parametrize("heavier", [1.0, 1.1])
def test_it_agrees_with_the_comparison_of_two_estimates(craft, suite, ideal, heavier):
    """Independent route: the χ² of two estimates, each from one half of the smoothed motion."""
    samples = add_noise(suite, ideal(heavier), seed=2)
    zero = TotalMomentum.zero()
    (window,) = windows(craft, suite, samples)
    middle = len(window.telemetry) // 2
    solutions = []
    for half in (slice(0, middle), slice(middle, None)):
        errors = tuple(
            replace(each, support=each.support[half], basis=each.basis[half])
            for each in window.errors
        )
        part = replace(window, telemetry=window.telemetry.select(half), errors=errors)
        solutions.append(solve_smoothed_rows(craft.tree, part, STANDARD_ROWS, zero))
    assert all(each.is_observable for each in solutions)
    unit = np.abs(solutions[0].values)
    rows = [SourceRows.of_solution(each) for each in solutions]
    compared = agreement(rows, solutions[0].values, 1e3 * unit)
    assert compared.freedom == 10
    score = agreement_of_halves(craft, suite, samples, zero)
    assert score.chi_squared == pytest.approx(compared.chi_squared, rel=0.35)


@pytest.mark.parametrize("sensors", ["given", "estimated"])
def test_a_base_heavier_than_its_model_is_doubted(craft, suite, ideal, sensors):
    given = suite if sensors == "given" else None

    def doubts(heavier):
        samples = add_noise(suite, ideal(heavier), seed=3)
        found = identify(craft, samples, estimator="least_squares", sensors=given)
        return [text for text in found.doubts if "two halves of the samples" in text]

    assert not doubts(1.0)
    assert len(doubts(1.3)) == 1
