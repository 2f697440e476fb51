"""Motions that turn the base less and less."""

import numpy as np
import pytest

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.planning.pareto import FrontPoint, front, undominated
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.search import Candidate


def test_no_motion_of_a_front_beats_another():
    values = [(5.0, 1.0), (4.0, 2.0), (3.0, 1.5), (2.0, 4.0), (2.0, 3.0), (6.0, 1.0)]
    points = [FrontPoint(Candidate(np.zeros((1, 1)), score), angle) for angle, score in values]
    found = [(point.angle, point.candidate.score) for point in undominated(points)]
    assert found == [(5.0, 1.0), (3.0, 1.5), (2.0, 3.0)]


@pytest.mark.slow
def test_each_motion_turns_the_base_less_and_keeps_all_constraints():
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    options = PlanOptions(frequency=0.3, candidates=64, starts=1, iterations=15, targets=1, jobs=1)
    problem = PlanProblem(scenario, load_sensors("flight"), options)
    best = Planner(problem).run()
    points = front(problem, best, 3, 0.3)
    assert len(points) >= 3
    angles = [point.angle for point in points]
    scores = [point.candidate.score for point in points]
    first = problem.setting.predict(problem.motion(best), problem.targets[0])
    assert angles[-1] <= 0.3 * first.base_angle
    assert angles == sorted(angles, reverse=True)
    assert scores == sorted(scores)
    assert scores[0] <= best.score
    for point in points:
        assert problem.is_kept(point.candidate)
        prediction = problem.setting.predict(problem.motion(point.candidate), problem.targets[0])
        np.testing.assert_allclose(prediction.base_angle, point.angle, rtol=0.03)
        np.testing.assert_allclose(prediction.worst, point.candidate.score, rtol=0.3)
