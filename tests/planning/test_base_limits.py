"""The base's turn, rate and displacement: against an independent propagation, and gradients."""

import numpy as np
import pytest
from planning_cases import check_gradient, small_objective

from cpid_drake.planning.base_limits import (
    IMPOSED_SHARE,
    BaseAttitude,
    BaseDisplacement,
    BaseRate,
)
from cpid_drake.planning.prediction import MotionSetting

LIMITS = {BaseAttitude: "base_angle", BaseRate: "base_rate", BaseDisplacement: "base_shift"}
MOMENTUM_W = np.array([4.0, -6.0, 3.0, 20.0, -30.0, 10.0])  # [N·m·s, N·s]


@pytest.fixture(scope="module")
def objective(exciting):
    return small_objective(exciting, node_rate=3.2)


@pytest.fixture(scope="module")
def parameters(objective):
    return 0.3 * np.random.default_rng(2).normal(size=(objective.family.count, 4))


@pytest.fixture(scope="module")
def expected(exciting, objective, parameters):
    setting = MotionSetting(exciting.spacecraft, exciting.case.suite, np.zeros(6), False, None)
    return setting.predict(objective.family.make(parameters), exciting.parameters)


@pytest.mark.parametrize("limit", LIMITS)
def test_the_largest_value_is_that_of_the_propagated_motion(limit, objective, parameters, expected):
    share = limit(objective, getattr(expected, LIMITS[limit]), 1.0).demands(parameters[None])
    assert share.shape == (1, 1)
    assert share[0, 0] == pytest.approx(1.0, abs=1 - IMPOSED_SHARE)


@pytest.mark.parametrize("limit", LIMITS)
def test_the_function_is_negative_where_the_limit_is_exceeded(
    limit, objective, parameters, expected
):
    value = getattr(expected, LIMITS[limit])
    assert limit(objective, 0.95 * value).evaluate(parameters)[0].min() < 0
    assert 0 < limit(objective, 1.1 * value).evaluate(parameters)[0].min() < 0.3


@pytest.mark.parametrize("limit", LIMITS)
def test_the_gradient_is_that_of_differences(limit, objective, parameters):
    check_gradient(limit(objective, 0.5), parameters)


@pytest.mark.parametrize("limit", LIMITS)
def test_momentum_moves_the_base_too(limit, exciting, parameters):
    """A spacecraft that turns and drifts; the constraint against the propagation."""
    craft, suite, truth = exciting.spacecraft, exciting.case.suite, exciting.case.truth
    setting = MotionSetting(craft, suite, MOMENTUM_W, False, None)
    start = exciting.case.motion.evaluate(0.0)[0]
    momentum = setting.momentum(truth, start)
    objective = small_objective(exciting, node_rate=8.0, momentum=momentum)
    motion = objective.family.make(parameters)
    times = np.linspace(0.0, motion.duration, 401)
    value, still = (
        limit(objective, 1.0).measured(each.telemetry(motion, exciting.parameters, times))
        for each in (setting, MotionSetting(craft, suite, np.zeros(6), False, None))
    )
    assert abs(value - still) > 0.04 * still
    share = limit(objective, value, 1.0).demands(parameters[None]).max()
    assert share == pytest.approx(1.0, rel=0.01)
