"""A spacecraft that is not exactly its model: the errors are as large as the covariance says."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from block_cases import fired, make_case
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    nees,
    sigmas,
)

from cpid_drake import TotalMomentum, identify
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.logs.simulated_noise import add_noise

UNCERTAINTY = BodyUncertainty(mass=0.02, com=0.005, inertia=0.04)


@pytest.fixture(scope="module")
def uncertain(craft, suite, skewed_target):
    """Return a function (duration) -> samples of a spacecraft that errs as `UNCERTAINTY` says."""
    tree = perturbed(craft.tree, UNCERTAINTY, np.random.default_rng(7))

    def make(duration):
        motion = Sines.drawn(4, seed=101, duration=duration, size=0.6)
        return measured(craft, motion, skewed_target, suite, tree=tree)

    return make


def test_an_error_is_as_large_as_its_sigma(craft, suite, skewed_target, uncertain):
    """Of a spacecraft that is not its model, with sensors whose own errors are far smaller."""
    found = identify(craft, uncertain(4.0), sensors=suite, known_bodies=UNCERTAINTY)
    assert found.failures == ()
    assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


def test_half_of_a_share_goes_with_the_sigma_that_matters(craft, suite, skewed_target):
    """Of the mass of the link at the target, of which the samples tell nothing."""
    samples = measured(craft, Sines.drawn(4, 101, 5.0, 0.6), skewed_target, suite)
    given = {"sensors": suite, "momentum": "zero"}
    found = identify(craft, samples, known_bodies=BodyUncertainty(mass=0.01), **given)
    row = max(found.budget[1:], key=lambda row: np.nanmax(row.shares))
    assert row.name == "mass of hand"
    told = BodyUncertainty(mass=0.01 * row.matters)  # the row is in per cent
    told = identify(craft, samples, known_bodies=told, **given)
    k = int(np.nanargmax(row.shares))
    gone = 1 - (sigmas(told)[k] / sigmas(found)[k]) ** 2
    assert gone == pytest.approx(row.shares[k] / 2, abs=0.03)


@pytest.mark.slow
def test_bodies_with_errors_far_above_their_sigma_fail_a_check(craft, suite, uncertain):
    small = BodyUncertainty(mass=0.001, com=0.00025, inertia=0.002)  # a twentieth
    found = identify(craft, uncertain(4.0), sensors=suite, known_bodies=small)
    assert "declared sizes" in [each.name for each in found.checks if not each.passed]


@pytest.mark.parametrize("factor", [0.7, 1.35])
def test_a_body_that_is_much_heavier_or_lighter_than_its_model_is_named(
    craft, suite, skewed_target, factor
):
    base, *others = craft.tree.bodies
    heavy = replace(base, mass=factor * base.mass, I_BBcm=factor * base.I_BBcm)
    tree = replace(craft.tree, bodies=(heavy, *others))
    samples = measured(craft, Sines.drawn(4, 101, 4.0, 0.6), skewed_target, suite, tree=tree)
    found = identify(craft, samples, sensors=suite, known_bodies=UNCERTAINTY)
    said = found.check("declared sizes").sentence
    assert re.search(r"the (mass|inertia) of base(, \w\w)? differs from the model by", said)
    assert (" by -" in said) == (factor < 1)


@pytest.mark.slow
def test_a_model_that_is_taken_for_exact_fails_a_check(craft, suite, skewed_target, uncertain):
    """The sensors' own errors are far smaller than those of the model: the answer is far off."""
    exact = identify(craft, uncertain(6.0), sensors=suite)
    error = (exact.parameters - skewed_target.to_vector()) / sigmas(exact)
    assert np.sqrt(np.mean(error**2)) > 5
    assert exact.failures


@pytest.mark.slow
def test_a_tumble_is_linear_in_the_bodies_errors_about_their_best_values_only(
    craft, suite, skewed_target
):
    """After a turn of 200°, an error of an inertia turns the base much farther than its noise."""
    motion = Sines.drawn(4, seed=101, duration=6.0, size=0.6)
    uncertainty = BodyUncertainty(mass=0.01, com=0.003, inertia=0.02)
    rng = np.random.default_rng(11)
    squares = []
    for _ in range(2):
        tree = perturbed(craft.tree, uncertainty, rng)
        samples = measured(craft, motion, skewed_target, suite, 6 * MOMENTUM, tree=tree)
        found = identify(
            craft,
            samples,
            estimator="trajectory_fit",
            sensors=suite,
            momentum=TotalMomentum.unknown(),
            known_bodies=uncertainty,
        )
        assert found.converged
        assert not found.failures
        squares.append(nees(found, skewed_target))
    assert 1 < np.mean(squares) < 20  # ten parameters


@pytest.mark.slow
def test_a_firing_is_found_although_the_spacecraft_is_uncertain(tmp_path, skewed_target):
    suite, uncertainty = coarse_suite(), BodyUncertainty(mass=0.01, com=0.003, inertia=0.02)
    case = make_case(tmp_path, skewed_target, suite, duration=6.0)
    tree = perturbed(case.craft.tree, uncertainty, np.random.default_rng(13))
    true = SimpleNamespace(tree=tree, joint_names=case.craft.joint_names)
    perfect = fired(replace(case, craft=true), 3.5, np.array([6.0, -4, 5, 3, -2, 2]))
    found = identify(
        case.craft,
        add_noise(suite, perfect, 2),
        sensors=suite,
        momentum=TotalMomentum.zero(),
        known_bodies=uncertainty,
    )
    assert found.converged
    assert not found.failures
    assert len(found.momentum_changes) == 1
    assert abs(max(found.momentum_changes) - 3.5) < 1.0
    assert nees(found, skewed_target) < chi2.isf(1e-3, 10)
