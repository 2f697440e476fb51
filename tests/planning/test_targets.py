"""Plausible targets: rigid bodies of the right size, around a prior if there is one."""

import numpy as np
import pytest

from cpid_drake import InertialParameters, InputError, TargetPrior
from cpid_drake.identification.result import Combinations
from cpid_drake.planning.targets import MASSES, plausible_targets, prior_information

BODY = InertialParameters(50.0, [0.3, 0.0, -0.1], np.diag([4.0, 5.0, 6.0])).to_vector()


def prior(sigma, known=slice(0, 10), **more) -> TargetPrior:
    parameters, covariance = np.full(10, np.nan), np.full((10, 10), np.nan)
    parameters[known] = BODY[known]
    at = np.arange(10)[known]
    size = np.array([50.0, 0.3, 0.3, 0.3, *6 * [15.0]])[known]
    covariance[np.ix_(at, at)] = np.diag((sigma * size) ** 2)
    return TargetPrior("the prior", parameters, covariance, **more)


@pytest.mark.parametrize("given", [None, prior(0.3), prior(0.05, slice(0, 4))])
def test_they_are_rigid_bodies_that_the_seed_determines(given):
    first, again, other = (plausible_targets(700.0, 1.2, 5, seed, given) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        assert InertialParameters.from_vector(a).is_physically_consistent()
        np.testing.assert_array_equal(a, b)
    assert not np.allclose(first[-1], other[-1])


def test_nothing_known_means_a_range_of_masses():
    masses = plausible_targets(700.0, 1.2, 200, 1)[:, 0]
    assert 700 * MASSES[0] <= min(masses) < 1.2 * 700 * MASSES[0]
    assert 0.8 * 700 * MASSES[1] < max(masses) <= 700 * MASSES[1]


def test_the_heaviest_are_among_the_most_demanding():
    drawn = plausible_targets(700.0, 1.2, 200, 1)
    heavy = plausible_targets(700.0, 1.2, 5, 1, heaviest=True)
    for each in heavy:
        assert each[0] >= max(other[0] for other in drawn)
        assert each[4:7].sum() >= np.quantile([other[4:7].sum() for other in drawn], 0.9)
        distance = np.linalg.norm(each[1:4])
        assert distance >= np.quantile([np.linalg.norm(other[1:4]) for other in drawn], 0.9)


def test_a_prior_comes_first_with_its_information():
    targets = plausible_targets(700.0, 1.2, 3, 1, prior(0.1))
    np.testing.assert_allclose(targets[0], BODY)
    np.testing.assert_allclose(1 / prior_information(prior(0.1))[0, 0], (0.1 * 50) ** 2)
    spread = abs(targets[1, 0] - 50.0)
    assert 0 < spread < 25


def test_a_prior_that_knows_nothing_is_none():
    """A log may determine not one parameter, and a next motion is planned all the same."""
    nothing = plausible_targets(700.0, 1.2, 3, 1, prior(0.1, slice(0, 0)))
    for each, other in zip(nothing, plausible_targets(700.0, 1.2, 3, 1), strict=True):
        np.testing.assert_array_equal(each, other)
    assert not prior_information(prior(0.1, slice(0, 0))).any()


def test_combinations_are_refused():
    known = Combinations("relative", BODY, np.eye(10), 1.0)
    with pytest.raises(InputError, match="only combinations"):
        plausible_targets(700.0, 1.2, 1, 1, prior(0.1, slice(0, 4), combinations=known))
