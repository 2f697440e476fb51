"""Candidates, their ranking, and the gradient method."""

import numpy as np
import pytest
from planning_cases import small_objective

from cpid_drake.planning.limits import LimitedFamily, MotionLimits
from cpid_drake.planning.search import Candidate, candidates, ranked, refined


@pytest.fixture(scope="module")
def objective(exciting):
    return small_objective(exciting)


@pytest.fixture(scope="module")
def limited(exciting, objective):
    return LimitedFamily(objective.family, MotionLimits.of_model(exciting.spacecraft.limits))


def test_candidates_are_within_the_limits_and_use_a_part_of_each_joints_room(limited):
    usage = limited.usage(candidates(limited, 200, 5)).max(axis=0)
    assert usage.max() <= 1 + 1e-12
    assert usage.min() >= 0.2 - 1e-12
    assert usage.std() > 0.1


def test_the_seed_determines_the_candidates(limited):
    first, again, other = (candidates(limited, 50, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(candidates(limited, 30, 5), first[:30])


@pytest.mark.slow
def test_processes_change_nothing(objective, limited):
    """Up to rounding: sums may run in another order, and a poor motion's matrices amplify it."""
    drawn = candidates(limited, 100, 5)
    alone, together = ranked(objective, drawn, 1), ranked(objective, drawn, 2)
    scores = [each.score for each in alone]
    assert scores == sorted(scores)
    np.testing.assert_allclose(scores, [each.score for each in together], rtol=1e-10)
    np.testing.assert_array_equal(alone[0].parameters, together[0].parameters)


@pytest.mark.slow
def test_the_gradient_method_improves_a_candidate_within_the_limits(objective, limited):
    start = ranked(objective, candidates(limited, 64, 5), 1)[0]
    seen: list[Candidate] = []
    found = refined(objective, limited, [], start, 25, seen.append)
    assert found[0].score < 0.6 * start.score
    assert found[-1] is start
    assert seen[-1] is found[0]
    assert [each.score for each in found] == sorted(each.score for each in found)
    for each in found:
        assert limited.usage(each.parameters).max() < 1 + 1e-5
        assert objective.scores(each.parameters[None])[0] == pytest.approx(each.score)


class Small:
    """A constraint that allows the first parameter to be small only."""

    name = "small"

    def values(self, parameters):
        return np.array([0.05 - parameters.flat[0]])

    def evaluate(self, parameters):
        gradient = np.zeros((1, parameters.size))
        gradient[0, 0] = -1.0
        return self.values(parameters), gradient


def test_a_constraint_is_kept(objective, limited):
    start = ranked(objective, candidates(limited, 64, 5), 1)[0]
    start.parameters.flat[0] = 0.0
    start = Candidate(start.parameters, objective.scores(start.parameters[None])[0])
    for each in refined(objective, limited, [Small()], start, 10):
        assert each.parameters.flat[0] <= 0.05 + 0.02
