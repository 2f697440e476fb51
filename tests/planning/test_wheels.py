"""The momentum that wheels store, against Drake's plant."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InertialParameters, InputError, load_scenario, load_sensors, shipped_scenario
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.search import candidates
from cpid_drake.planning.wheels import wheel_rates

LARGEST = 0.15  # [N·m·s]
WHEELS = tuple(f"wheel{k}_spin" for k in range(1, 5))
OPTIONS = PlanOptions(
    frequency=0.2, joints=("arm_joint1", *WHEELS), wheel_momentum=LARGEST, targets=1
)


@pytest.fixture(scope="module")
def scenario():
    """The arm moves to another place; the wheels start and end at rest."""
    found = load_scenario(shipped_scenario("single_arm_wheels"))
    still = {name: np.zeros(3) for name in WHEELS}
    amplitudes = {**found.joint_motion.amplitudes, **still}
    return replace(found, joint_motion=replace(found.joint_motion, amplitudes=amplitudes))


def problem_of(scenario, **changes) -> PlanProblem:
    return PlanProblem(scenario, load_sensors("servicer"), replace(OPTIONS, **changes))


def test_drakes_plant_has_the_momentum_that_a_wheel_stores_at_its_largest_rate(scenario):
    """The base is at rest, and one wheel turns."""
    craft = scenario.spacecraft.make()
    names = craft.joint_names
    rates = wheel_rates(craft.tree, names, np.ones(len(names), dtype=bool), LARGEST)
    assert {names[k] for k in np.flatnonzero(np.isfinite(rates))} == set(WHEELS)
    target = InertialParameters(180.0, np.zeros(3), 20.0 * np.eye(3))
    plant = craft.make_simulation_plant(target)
    context = plant.CreateDefaultContext()
    for wheel in WHEELS:
        plant.SetVelocities(context, np.zeros(plant.num_velocities()))
        plant.GetJointByName(wheel).set_angular_rate(context, rates[names.index(wheel)])
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
        assert np.linalg.norm(momentum.rotational()) == pytest.approx(LARGEST, rel=1e-9)
        np.testing.assert_allclose(momentum.translational(), 0.0, atol=1e-9)


def test_no_motion_of_the_search_stores_more(scenario):
    problem = problem_of(scenario)
    tree, names = problem.spacecraft.tree, problem.spacecraft.joint_names
    largest = wheel_rates(tree, names, np.ones(len(names), dtype=bool), LARGEST)
    times, shares = np.linspace(0.0, 12.0, 1001), []
    for parameters in candidates(problem.limited, 16, 1):
        rates = problem.family.make(parameters).evaluate(times)[:, 1]
        shares.append((np.abs(rates) / largest).max())
    assert 0.9 < max(shares) <= 1.0


def test_where_no_wheel_moves_the_limit_is_refused(scenario):
    with pytest.raises(InputError, match=r"no wheel moves.*--joint.*wheel1_spin, wheel2_spin"):
        _ = problem_of(scenario, joints=()).limited
    paper = load_scenario(shipped_scenario("paper"))
    with pytest.raises(InputError, match="the spacecraft has no wheels"):
        _ = problem_of(paper, joints=()).limited
    with pytest.raises(InputError, match="wheel_momentum must be > 0"):
        problem_of(scenario, wheel_momentum=0.0)
