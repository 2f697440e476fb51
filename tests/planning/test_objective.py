"""The criterion of a motion, and its exact gradients."""

import numpy as np
import pytest

from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.limits import LimitedFamily, MotionLimits
from cpid_drake.planning.objective import Objective, PlausibleTarget


def objective(case, targets=None, joints=4) -> Objective:
    craft, motion = case.spacecraft, case.case.motion
    start = motion.evaluate(0.0)[0]
    family = MotionFamily(
        craft.joint_names, start, start, np.arange(joints), case.case.duration, 0.4
    )
    targets = targets or (PlausibleTarget(case.parameters),)
    return Objective(case.model, family, targets)


def parameters(objective, *shape, seed=3) -> np.ndarray:
    family = objective.family
    size = np.random.default_rng(seed).normal(size=(*shape, family.count, len(family.moving)))
    return 0.2 * size


def other_target(case) -> PlausibleTarget:
    return PlausibleTarget(case.parameters * np.array([0.5, *3 * [0.8], *6 * [0.7]]))


def check_gradient(goal, x, h, tolerance) -> None:
    """Compare the gradient along random directions with differences of sixth order."""
    values, gradient = goal.evaluate(x)
    for seed in range(3):
        d = parameters(goal, seed=seed)
        d /= np.linalg.norm(d)
        slopes = [
            (goal.evaluate(x + s * h * d)[0] - goal.evaluate(x - s * h * d)[0]) / (2 * s * h)
            for s in (1, 2, 3)
        ]
        found = gradient @ d.ravel()
        limit = tolerance * np.abs(found).max()
        np.testing.assert_allclose(found, np.dot([1.5, -0.6, 0.1], slopes), atol=limit)
    assert len(values) == len(gradient)


def test_gradients_are_those_of_differences(exciting):
    goal = objective(exciting)
    check_gradient(goal, parameters(goal), 2e-3, 1e-6)


@pytest.mark.slow
def test_gradients_with_an_uncertain_spacecraft_and_two_targets(uncertain):
    targets = PlausibleTarget(uncertain.parameters), other_target(uncertain)
    goal = objective(uncertain, targets, joints=2)
    check_gradient(goal, parameters(goal), 4e-2, 1e-3)


def test_the_criterion_is_the_largest_sigma(exciting):
    goal = objective(exciting)
    x = parameters(goal, 1)
    [[C]] = goal.covariances(goal.samples(x))
    assert goal.scores(x)[0] == pytest.approx(np.sqrt(np.diag(C)).max())
    assert np.exp(goal.values(x[0]).max()) == pytest.approx(goal.scores(x)[0])


def test_the_least_favourable_target_decides(exciting):
    targets = PlausibleTarget(exciting.parameters), other_target(exciting)
    x = parameters(objective(exciting), 3)
    each = [objective(exciting, targets=(target,)).scores(x) for target in targets]
    both = objective(exciting, targets=targets).scores(x)
    np.testing.assert_allclose(both, np.max(each, axis=0))


def test_what_is_known_before_bounds_the_result(exciting):
    """With a prior of 1e-6 of the scale, the motion can only add to that."""
    scale = parameter_scale(exciting.parameters, SCALE_LENGTH)
    known = PlausibleTarget(exciting.parameters, np.diag((1e-6 * scale) ** -2))
    goal = objective(exciting, targets=(known,))
    assert goal.scores(parameters(goal, 1))[0] < 1e-6
    without = objective(exciting)
    assert without.scores(parameters(without, 1))[0] > 1e-6


def test_moving_less_teaches_less(exciting):
    """Limits decide the precision: a tenth of the motion is much less certain."""
    goal = objective(exciting)
    limits = MotionLimits.of_model(exciting.spacecraft.limits)
    limited = LimitedFamily(goal.family, limits)
    x = parameters(goal)
    x /= limited.usage(x).max()
    full, tenth = goal.scores(np.stack([x, x / 10]))
    assert tenth > 5 * full
