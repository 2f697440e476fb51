"""The targets for which a plan's limits are imposed, and the check of a finished motion."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planning_cases import small_objective

from cpid_drake import InertialParameters
from cpid_drake.planning.base_limits import BaseRate
from cpid_drake.planning.demands import Needed, TargetDemands
from cpid_drake.planning.efforts import SHARE, JointEfforts
from cpid_drake.planning.objective import PlausibleTarget
from cpid_drake.planning.prediction import MotionSetting


def scaled(body: InertialParameters, factor: float) -> PlausibleTarget:
    heavier = InertialParameters(factor * body.mass, body.p_CTcm_C, factor * body.I_TTcm_C)
    return PlausibleTarget(heavier.to_vector())


@pytest.fixture(scope="module")
def many(exciting):
    objective = small_objective(exciting, node_rate=3.2)
    factors = (1.0, 0.1, 5.0, 0.5, 4.0, 3.0)
    targets = tuple(scaled(exciting.case.truth, factor) for factor in factors)
    return replace(objective, targets=targets)


@pytest.fixture(scope="module")
def parameters(many):
    return 0.3 * np.random.default_rng(2).normal(size=(many.family.count, 4))


@pytest.fixture
def demands(exciting, many):
    setting = MotionSetting(exciting.spacecraft, exciting.case.suite, np.zeros(6), False, None)
    return TargetDemands(setting, many, [BaseRate(many, 0.2)])


def test_the_heaviest_targets_move_the_base_most(demands, many, parameters):
    demands.begin(parameters[None])
    assert {id(each) for each in demands.targets} == {id(many.targets[k]) for k in (2, 4, 5)}
    for each in demands.constraints:
        assert each.objective.targets == demands.targets


def test_a_motion_that_exceeds_a_limit_needs_more_than_is_allowed(demands, many, parameters):
    motion, heavy = many.family.make(0.4 * parameters), many.targets[2].parameters
    reached = demands.setting.predict(motion, heavy).base_rate
    for limit in (0.98 * reached, 1.02 * reached):
        demands.base_limits = [BaseRate(many, limit)]
        needed = demands.needed(motion, [heavy])
        assert needed.efforts.max() < 1
        assert (needed.largest > 1) == (limit < reached)
        assert needed.base[0] == pytest.approx(reached / limit, rel=1e-3)


def test_less_is_imposed_where_the_motion_needs_more_between_the_nodes(demands, many, parameters):
    demands.begin(parameters[None])
    motion, heavy = many.family.make(parameters), many.targets[2].parameters
    needed = demands.needed(motion, [heavy])
    worse = replace(needed, base=1.2 * needed.base)
    before = demands.base_limits[0].imposed
    demands.tighten(parameters, needed)
    assert demands.base_limits[0].imposed > 0.97 * before
    demands.tighten(parameters, worse)
    assert demands.base_limits[0].imposed == pytest.approx(before / 1.2, rel=0.03)


@pytest.fixture
def weak(demands, many, parameters):
    """Demands in which a motion needs twice the torque of one joint, which is not imposed yet."""
    plain = JointEfforts(many, np.arange(4), demands.setting.spacecraft.limits.efforts)
    largest = plain.largest.copy()
    share = SHARE * plain.demands(parameters[None]).max(axis=0)
    joint = int(share.argmax())
    largest[joint] *= share[joint] / 2
    limits = replace(demands.setting.spacecraft.limits, efforts=largest)
    craft = SimpleNamespace(limits=limits)
    demands.setting = SimpleNamespace(spacecraft=craft)
    demands.efforts = replace(plain, largest=largest)
    return demands, joint


def test_a_torque_that_was_not_imposed_does_not_lower_its_limit(weak, many, parameters):
    """The motion needs twice the torque at the nodes, too: what is imposed there is enough."""
    demands, joint = weak
    before = demands.efforts.largest
    at_nodes = SHARE * demands.efforts.demands(parameters[None]).max(axis=0)
    assert at_nodes[joint] == pytest.approx(2)
    needed = np.append(1.1 * at_nodes, np.zeros(before.size - 4))
    demands.tighten(parameters, Needed(needed, np.zeros(1)))
    np.testing.assert_allclose(demands.efforts.largest, before)


def test_a_torque_that_peaks_between_the_nodes_lowers_its_limit(weak, many, parameters):
    """The peak is then within the joint's limit; other joints keep theirs."""
    demands, joint = weak
    before = demands.efforts.largest
    at_nodes = SHARE * demands.efforts.demands(parameters[None]).max(axis=0)
    peaks = np.zeros(before.size)
    peaks[joint] = 1.4 * at_nodes[joint]
    demands.tighten(parameters, Needed(peaks, np.zeros(1)))
    after = demands.efforts.largest
    assert SHARE * after[joint] * 1.4 == pytest.approx(before[joint] / 1.02)
    np.testing.assert_allclose(np.delete(after, joint), np.delete(before, joint))
