"""Distances and joint efforts: against Drake, and their gradients."""

import numpy as np
import pytest
from planning_cases import check_gradient, small_objective

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.planning.constraints import Distances
from cpid_drake.planning.efforts import SHARE, JointEfforts
from cpid_drake.planning.prediction import MotionSetting
from cpid_drake.spacecraft.clearance import Clearance


@pytest.fixture(scope="module")
def objective(exciting):
    return small_objective(exciting)


@pytest.fixture(scope="module")
def parameters(objective):
    return 0.3 * np.random.default_rng(2).normal(size=(objective.family.count, 4))


@pytest.fixture(scope="module")
def clearance(exciting):
    return Clearance(exciting.spacecraft, exciting.case.truth, exciting.visual_model)


def test_efforts_are_those_of_drakes_inverse_dynamics(exciting, parameters):
    """On a fine grid; the momentum's rate against the mass matrix of the plant."""
    objective = small_objective(exciting, node_rate=20.0)
    largest = np.ones(12)
    efforts = JointEfforts(objective, np.arange(12), largest)
    found = SHARE * efforts.shares(parameters[None])[0, :, :, 0]
    setting = MotionSetting(exciting.spacecraft, exciting.case.suite, np.zeros(6), False, None)
    motion = objective.family.make(parameters)
    expected = setting.largest_efforts(motion, exciting.parameters[None])[0]
    np.testing.assert_allclose(np.abs(found).max(axis=0), expected, rtol=0.02, atol=0.02)


def test_the_gradient_of_efforts(objective, parameters, exciting):
    limits = exciting.spacecraft.limits.efforts
    check_gradient(JointEfforts(objective, np.array([0, 2]), limits), parameters)


def test_distances_are_kept_where_the_function_is_not_negative(objective, clearance):
    distances = Distances(clearance, objective.family, 0.05)
    rng, seen = np.random.default_rng(3), set()
    for scale in np.repeat([0.2, 0.6, 1.5], 4):
        x = scale * rng.normal(size=(objective.family.count, 4))
        kept = distances.evaluate(x)[0].min() >= 0
        seen.add(kept)
        if kept:
            assert distances.is_kept(x, 0.15)
    assert seen == {True, False}


def test_the_gradient_of_distances(objective, clearance):
    distances = Distances(clearance, objective.family, 0.3)
    drawn = 1.5 * np.random.default_rng(4).normal(size=(20, objective.family.count, 4))
    x = next(each for each in drawn if distances.evaluate(each)[0].min() < 0)
    check_gradient(distances, x, 1e-6, 1e-3)


def test_a_heavier_target_needs_more(exciting, parameters):
    body = exciting.case.truth
    heavy = InertialParameters(3 * body.mass, body.p_CTcm_C, 3 * body.I_TTcm_C)
    shares = [
        np.abs(
            JointEfforts(
                small_objective(exciting, target=target.to_vector()),
                np.arange(2),
                exciting.spacecraft.limits.efforts,
            ).shares(parameters[None])
        ).max()
        for target in (body, heavy)
    ]
    assert shares[1] > 1.3 * shares[0]
