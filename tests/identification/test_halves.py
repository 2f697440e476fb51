"""Two halves of smoothed samples have the same target, unless the world is not as modelled."""

from dataclasses import replace

import pytest
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import TotalMomentum, identify
from cpid_drake.dynamics.rows import STANDARD_ROWS
from cpid_drake.estimation.momentum_rows import SmoothedRows
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.smoothing import smooth_windows

SEEDS = range(1, 6)


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


@pytest.mark.parametrize(
    "momentum",
    [TotalMomentum.zero(), pytest.param(TotalMomentum.unknown(), marks=pytest.mark.slow)],
)
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


@pytest.mark.parametrize("sensors", ["given", pytest.param("estimated", marks=pytest.mark.slow)])
def test_a_base_heavier_than_its_model_is_doubted(craft, suite, ideal, sensors):
    given = suite if sensors == "given" else None

    def doubts(heavier):
        samples = add_noise(suite, ideal(heavier), seed=3)
        found = identify(craft, samples, estimator="least_squares", sensors=given)
        return [text for text in found.doubts if "two halves of the samples" in text]

    assert not doubts(1.0)
    assert len(doubts(1.3)) == 1
