"""The next motion: from the end of the last one, for what is least known about the target."""

import numpy as np
import pytest

from cpid_drake import TargetPrior, load_scenario, load_sensors, shipped_scenario
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.replanning import next_problem

SMALL = PlanOptions(frequency=0.3, candidates=32, starts=1, iterations=1, targets=1)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("paper"))


@pytest.fixture(scope="module")
def problem(scenario):
    return PlanProblem(scenario, load_sensors("coarse"), SMALL)


def prior_of(scenario, sigma) -> TargetPrior:
    truth = scenario.target_truth().to_vector()
    return TargetPrior("estimate", truth, np.diag(np.broadcast_to(sigma, 10) ** 2.0))


@pytest.mark.slow
def test_it_starts_where_the_last_motion_ended_and_returns_to_its_start(problem, scenario):
    following = next_problem(problem, prior_of(scenario, 0.1))
    np.testing.assert_allclose(following.family.start, problem.family.end)
    np.testing.assert_allclose(following.family.end, problem.family.start)
    best = Planner(following).run()
    motion = following.motion(best)
    rest = np.zeros_like(problem.family.end)
    expected = np.stack([problem.family.end, rest, rest])
    np.testing.assert_allclose(motion.evaluate(0.0), expected, atol=1e-9)
    assert following.is_kept(best)


def test_another_end_can_be_required(problem, scenario):
    end = problem.family.end + 0.1
    following = next_problem(problem, prior_of(scenario, 0.1), end)
    np.testing.assert_allclose(following.family.end, end)


@pytest.mark.slow
def test_what_is_known_already_does_not_count(problem, scenario):
    """A motion adds to the prior: the predicted σ is below both, and exact for a strong prior."""
    still = np.zeros((1, problem.family.count, len(problem.family.moving)))
    truth = scenario.target_truth().to_vector()
    alone = next_problem(problem, prior_of(scenario, 1e6)).objective
    without = alone.covariances(alone.samples(still))[0, 0]
    scale = problem.setting.predict(problem.own_motion, truth).scale
    for sigma in (1e-6, 1e-3, 1e3):
        following = next_problem(problem, prior_of(scenario, sigma))
        objective = following.objective
        covariance = objective.covariances(objective.samples(still))[0, 0]
        expected = np.linalg.inv(np.linalg.inv(without) + np.diag((scale / sigma) ** 2))
        np.testing.assert_allclose(covariance, expected, rtol=1e-3, atol=1e-3 * sigma**2 / 60)
