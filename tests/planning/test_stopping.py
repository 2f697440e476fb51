"""Stops at any instant: against integrated motions, their gradients, and what they may hit."""

import numpy as np
import pytest
from planning_cases import check_gradient, small_objective

from cpid_drake import InputError, load_scenario, load_sensors, shipped_scenario
from cpid_drake.planning.constraints import Distances
from cpid_drake.planning.limits import MotionLimits
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.prediction import MotionSetting
from cpid_drake.planning.stopping import Stops, braked, needed_torque
from cpid_drake.spacecraft.clearance import Clearance


@pytest.fixture(scope="module")
def family(exciting):
    return small_objective(exciting).family


@pytest.fixture(scope="module")
def limits(exciting):
    return MotionLimits.of_model(exciting.spacecraft.limits)


@pytest.fixture(scope="module")
def distances(exciting, family):
    clearance = Clearance(exciting.spacecraft, exciting.case.truth, exciting.visual_model)
    return Distances(clearance, family, 0.05)


def drawn(family, count, scale):
    return scale * np.random.default_rng(3).normal(size=(count, family.count, 4))


def test_joints_brake_as_in_an_integration_of_their_equations():
    q, qdot, a, h = np.array([0.3, -1.0, 0.5]), np.array([0.4, -0.25, 0.0]), 0.2, 1e-4
    position, rate = q.copy(), qdot.copy()
    for step in range(25001):
        if step % 5000 == 0:
            np.testing.assert_allclose(braked(q, qdot, a, step * h), position, atol=1e-4)
        rate = np.where(np.abs(rate) > a * h, rate - np.sign(rate) * a * h, 0.0)
        position = position + rate * h
    np.testing.assert_allclose(braked(q, qdot, a), position, atol=1e-4)


def test_a_motion_within_its_acceleration_never_stops_outside_its_own_range(family):
    """It ends at rest, so it passes every position in which it could stop."""
    times = np.linspace(0.0, family.duration, 4001)
    for parameters in drawn(family, 20, 0.5):
        q, qdot, qddot = np.moveaxis(family.make(parameters).evaluate(times), 1, 0)
        rest = braked(q, qdot, np.abs(qddot).max())
        assert (rest <= q.max(axis=0) + 1e-5).all()
        assert (rest >= q.min(axis=0) - 1e-5).all()
    weak = braked(q, qdot, 0.3 * np.abs(qddot[:, family.moving]).max(axis=0).min())
    assert (weak > q.max(axis=0)).any()


def test_the_gradient_of_positions_at_rest(family, limits):
    check_gradient(Stops(family, limits, 0.2, None), drawn(family, 1, 0.3)[0])


@pytest.mark.slow
def test_a_plan_may_be_stopped_at_any_instant():
    scenario = load_scenario(shipped_scenario("paper"))
    options = PlanOptions(
        frequency=0.3,
        candidates=64,
        starts=1,
        iterations=6,
        targets=1,
        joints=tuple(f"capture_arm_joint{k}" for k in range(1, 7)),
        duration=16.0,
        acceleration=0.12,
        is_stoppable=True,
    )
    problem = PlanProblem(scenario, load_sensors("flight"), options)
    motion = problem.motion(Planner(problem).run())
    limits, clearance = problem.spacecraft.limits, problem.distances.clearance
    poses = []
    for start in np.linspace(0.0, 16.0, 65):
        q, qdot = motion.evaluate(start)[:2]
        poses += [braked(q, qdot, 0.12, t) for t in np.linspace(0.0, 4.0, 17)]
    assert (np.array(poses) <= limits.highest).all()
    assert (np.array(poses) >= limits.lowest).all()
    assert clearance.approaches(np.array(poses))[0].distance > 0.9 * 0.05
    assert needed_torque(problem.setting, motion, problem.checked_targets, 0.12) <= 1


def test_stops_need_an_acceleration():
    scenario = load_scenario(shipped_scenario("paper"))
    with pytest.raises(InputError, match="give --acceleration"):
        PlanProblem(scenario, load_sensors("flight"), PlanOptions(is_stoppable=True))


def test_the_torque_of_a_stop_grows_with_the_deceleration(exciting, family):
    """The joints move slowly, so only their inertia counts."""
    setting = MotionSetting(exciting.spacecraft, exciting.case.suite, np.zeros(6), False, None)
    motion = family.make(drawn(family, 1, 0.02)[0])
    target = exciting.parameters[None]
    weak, strong = (needed_torque(setting, motion, target, a) for a in (0.1, 0.2))
    assert strong == pytest.approx(2 * weak, rel=0.1)
    gentle = setting.largest_efforts(motion, target)
    assert weak > (gentle / exciting.spacecraft.limits.efforts).max()
