"""Adaptive control by passivity: the arms follow, and the parameters come if they are excited."""

import numpy as np
import pytest
from techniques.adaptive import simulate_adaptation
from techniques.passivity_controller import PassivityController

from cpid_drake import InputError, load_scenario, shipped_scenario
from cpid_drake.dynamics.parameterizations import parameter_scale


@pytest.fixture(scope="module")
def case():
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    craft = scenario.spacecraft.make()
    return craft, scenario.target_truth(), scenario.make_joint_motion(craft)


def error(parameters, target):
    return np.abs((parameters - target.to_vector()) / parameter_scale(target.to_vector())).max()


def test_composite_adaptation_knows_the_target_after_a_second(case):
    craft, target, motion = case
    found, tracking = simulate_adaptation(craft, target, motion, 1.0, is_composite=True)
    assert np.isnan(found[0]).all()  # nothing at first
    assert error(found[-1], target) < 1e-3
    assert tracking.max() < 1e-3


def test_tracking_does_not_wait_for_the_parameters(case):
    """Without momentum the joints follow within three degrees while the target is still unknown."""
    craft, target, motion = case
    found, tracking = simulate_adaptation(craft, target, motion, 4.0, is_composite=False)
    assert tracking.max() < np.radians(3.0)
    assert tracking[-1] < 0.5 * tracking.max()
    assert 0.02 < error(found[-1], target) < 0.5 * error(found[5], target)


def test_all_state_is_in_the_context(case):
    """A clone keeps its estimate while the first goes on."""
    craft, _, _ = case
    controller = PassivityController(craft, is_composite=True)
    context = controller.CreateDefaultContext()
    names = {"state": craft.plant.num_multibody_states(), "desired_motion": 36}
    for name, size in names.items():
        value = np.zeros(size)
        value[0] = name == "state"
        controller.GetInputPort(name).FixValue(context, value)
    clone = context.Clone()
    context.SetContinuousState(np.append([20.0, *np.zeros(3), 1, 0, 0, 1, 0, 1.0], np.zeros(6)))
    port = controller.GetOutputPort("parameters")
    np.testing.assert_allclose(port.Eval(context)[:8], [20, 0, 0, 0, 1, 1, 1, 0], atol=1e-12)
    assert np.isnan(port.Eval(clone)).all()


@pytest.mark.parametrize("gain", ["adaptation", "stiffness", "damping", "period"])
def test_a_gain_that_is_not_positive_is_refused(case, gain):
    with pytest.raises(InputError, match=f"{gain} must be > 0"):
        PassivityController(case[0], **{gain: -1.0})
