"""A plan of a scenario: better than the scenario's motion, within all limits, reproducible."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InertialParameters, InputError, load_scenario, load_sensors, shipped_scenario
from cpid_drake.planning.export import motion_table
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.planner import FIRST_TARGETS, Planner
from cpid_drake.planning.search import candidates
from cpid_drake.scenario.limits import check_limits
from cpid_drake.scenario.simulation import make_simulation

SMALL = PlanOptions(
    frequency=0.3,
    candidates=32,
    starts=1,
    iterations=4,
    targets=4,
    joints=tuple(f"capture_arm_joint{k}" for k in range(1, 7)),
    jobs=1,
)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("paper"))


@pytest.fixture(scope="module")
def planner(scenario):
    planner = Planner(PlanProblem(scenario, load_sensors("flight"), SMALL))
    planner.left_by_interrupts = []
    planner.run(lambda what, best: planner.left_by_interrupts.append(planner.best))
    return planner


def test_it_is_much_better_than_the_scenarios_motion_for_the_true_target(planner, scenario):
    """The planner does not know the true target."""
    truth = scenario.target_truth().to_vector()
    assert all(not np.allclose(target, truth, rtol=0.1) for target in planner.problem.targets)
    own = planner.problem.setting.predict(planner.problem.own_motion, truth)
    plan = planner.problem.setting.predict(planner.problem.motion(planner.best), truth)
    assert own.worst > 30 * plan.worst


def test_it_keeps_the_ends_and_all_limits_of_drakes_plant(planner, scenario):
    motion, own = planner.problem.motion(planner.best), planner.problem.own_motion
    np.testing.assert_allclose(motion.evaluate([0.0, 10.0])[:, 0], own.evaluate([0.0, 10.0])[:, 0])
    declared = replace(
        scenario, joint_motion=planner.problem.family.declare(planner.best.parameters)
    )
    for target in planner.problem.targets:
        body = InertialParameters.from_vector(target)
        found = check_limits(make_simulation(declared, target=body))
        assert found.exceeded == ()
        assert found.closest


@pytest.mark.slow
def test_it_suits_all_targets_better_than_any_random_motion(planner):
    """More targets than the gradient method begins with; none is given up for another."""
    problem = planner.problem
    assert len(problem.targets) > FIRST_TARGETS
    drawn = candidates(problem.limited, SMALL.candidates, SMALL.seed)
    random = problem.objective.target_scores(drawn)
    found = problem.objective.target_scores(planner.best.parameters[None])[:, 0]
    assert found.max() == pytest.approx(planner.best.score)
    assert found.max() < 0.7 * random.max(axis=0).min()
    assert found.max() < 2 * found.min()


def test_an_interrupt_leaves_what_keeps_all_limits_and_the_plan_is_the_best_of_that(planner):
    left = [each for each in planner.left_by_interrupts if each is not None]
    assert planner.problem.is_kept(left[-1])
    assert planner.problem.is_kept(planner.best)
    better = [each for each in left if each.score < planner.best.score]
    assert not any(planner.problem.is_kept(each) for each in better)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_plan(planner, scenario):
    again = Planner(PlanProblem(scenario, load_sensors("flight"), SMALL)).run()
    np.testing.assert_array_equal(again.parameters, planner.best.parameters)


def test_active_limits_are_named(planner):
    assert any(each.startswith("rate of ") for each in planner.active(planner.best))


@pytest.mark.slow
def test_little_motion_of_the_base_can_be_required(scenario):
    options = replace(
        SMALL,
        base_attitude=np.radians(60.0),
        base_rate=np.radians(16.0),
        base_displacement=0.2,
        targets=1,
    )
    planner = Planner(PlanProblem(scenario, load_sensors("flight"), options))
    best = planner.run()
    assert len(planner.problem.checked_targets) > 1  # also the heaviest, which move the base most
    for target in planner.problem.checked_targets:
        found = planner.problem.setting.predict(planner.problem.motion(best), target)
        assert found.base_angle <= np.radians(60.0)
        assert found.base_rate <= np.radians(16.0)
        assert found.base_shift <= 0.2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": ("elbow",)}, "no joint 'elbow'"),
        ({"candidates": 0}, "candidates must be at least 1"),
        ({"rate_share": 0.0}, "rate_share must be > 0"),
        ({"duration": 4.0}, "exceeds the limit of its rate"),
        pytest.param(
            {"base_attitude": 1e-3}, "no motion keeps the constraints", marks=pytest.mark.slow
        ),
        ({"base_displacement": -1.0}, "base_displacement must be > 0"),
    ],
)
def test_impossible_choices_are_refused(changes, message, scenario):
    with pytest.raises(InputError, match=message):
        Planner(PlanProblem(scenario, load_sensors("flight"), replace(SMALL, **changes))).run()


def test_a_table_for_a_controller_has_the_whole_motion(planner):
    motion, names = planner.problem.motion(planner.best), planner.problem.spacecraft.joint_names
    lines = motion_table(motion, names, 30.0).splitlines()
    assert lines[0].startswith("time,q:capture_arm_joint1,")
    assert len(lines[0].split(",")) == 1 + 3 * len(names)
    values = np.array([line.split(",") for line in lines[1:]], dtype=float)
    assert len(values) == 301
    assert values[-1, 0] == 10.0
    expected = motion.evaluate(values[:, 0]).reshape(len(values), -1)
    np.testing.assert_allclose(values[:, 1:], expected, atol=1e-9)
