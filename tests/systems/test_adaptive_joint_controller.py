"""The adaptive joint controller: it uses an estimate that is known, and no other."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from cpid_drake import (
    JointController,
    JointMotionSource,
    MomentumIdentifier,
    load_scenario,
    shipped_scenario,
)
from cpid_drake.dynamics.parameterizations import parameter_scale

PRECISE = 0.01
"""σ relative to the scale of each parameter: within the tolerance of 0.05."""


@pytest.fixture
def inputs(servicer, random_motion):
    """A state in motion, and a desired motion of the joints."""
    state = servicer.to_states(random_motion(1, seed=4))[0]
    joints = len(servicer.joint_names)
    return state, np.random.default_rng(5).normal(0.0, 0.3, 3 * joints)


def fixed(controller, inputs, estimate=None, sigma=np.nan):
    """Return a context of the controller with these inputs and an estimate of relative σ."""
    context = controller.CreateDefaultContext()
    controller.GetInputPort("state").FixValue(context, inputs[0])
    controller.GetInputPort("desired_motion").FixValue(context, inputs[1])
    give(controller, context, estimate, sigma)
    return context


def give(controller, context, estimate, sigma):
    inertia, covariance = SpatialInertia.NaN(), np.full((10, 10), np.nan)
    if estimate is not None:
        inertia = estimate.to_spatial_inertia()
        covariance = np.diag((sigma * parameter_scale(estimate.to_vector())) ** 2)
    controller.GetInputPort("covariance").FixValue(context, covariance.ravel())
    controller.GetInputPort("spatial_inertia").FixValue(context, Value(inertia))


def update(controller, context):
    """Let the controller read the estimate, as it does at the start of each period."""
    simulator = Simulator(controller, context.Clone())
    simulator.AdvancePendingEvents()
    context.SetTimeStateAndParametersFrom(simulator.get_context())


def force(controller, context):
    return controller.GetOutputPort("generalized_force").Eval(context)


def target_of(controller, context):
    return controller.GetOutputPort("model_target").Eval(context)


def constant_force(servicer, inputs, target=None):
    """Return the force of a controller with this model."""
    controller = JointController(servicer, target=target)
    context = controller.CreateDefaultContext()
    for name, value in zip(("state", "desired_motion"), inputs, strict=True):
        controller.GetInputPort(name).FixValue(context, value)
    return controller.GetOutputPort("generalized_force").Eval(context)


def test_before_the_estimate_the_model_is_the_spacecraft_alone(servicer, inputs):
    controller = JointController(servicer, reads_estimate=True)
    context = fixed(controller, inputs)
    update(controller, context)
    assert not target_of(controller, context).any()
    expected = constant_force(servicer, inputs)
    np.testing.assert_allclose(force(controller, context), expected, rtol=1e-11, atol=1e-11)


def test_a_known_estimate_becomes_the_models_target(servicer, inputs, skewed_target):
    """The efforts are then those of a controller that knows the target."""
    controller = JointController(servicer, reads_estimate=True)
    context = fixed(controller, inputs, skewed_target, PRECISE)
    update(controller, context)
    np.testing.assert_allclose(
        target_of(controller, context), skewed_target.to_vector(), atol=1e-12
    )
    expected = constant_force(servicer, inputs, skewed_target)
    np.testing.assert_allclose(force(controller, context), expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("entry", [0, 3, 9])
def test_one_parameter_that_is_not_known_well_enough_keeps_the_model(
    servicer, inputs, skewed_target, entry
):
    controller = JointController(servicer, reads_estimate=True, tolerance=0.05)
    sigma = np.full(10, PRECISE)
    sigma[entry] = 0.06
    context = fixed(controller, inputs, skewed_target, sigma)
    update(controller, context)
    assert not target_of(controller, context).any()
    sigma[entry] = np.nan
    give(controller, context, skewed_target, sigma)
    update(controller, context)
    assert not target_of(controller, context).any()


def test_an_estimate_that_is_lost_stays_in_use(servicer, inputs, skewed_target, paper_target):
    controller = JointController(servicer, reads_estimate=True)
    context = fixed(controller, inputs, skewed_target, PRECISE)
    update(controller, context)
    for estimate, sigma in ((None, np.nan), (paper_target, 0.5)):
        give(controller, context, estimate, sigma)
        update(controller, context)
        assert target_of(controller, context)[0] == pytest.approx(skewed_target.mass)
    give(controller, context, paper_target, PRECISE)
    update(controller, context)
    assert target_of(controller, context)[0] == pytest.approx(paper_target.mass)


def test_the_model_is_state_of_the_context(servicer, inputs, skewed_target):
    """Two contexts of one controller have each their own model, evaluated in turn."""
    controller = JointController(servicer, reads_estimate=True)
    before = fixed(controller, inputs, skewed_target, PRECISE)
    after = before.Clone()
    update(controller, after)
    first, second = force(controller, before), force(controller, after)
    assert np.abs(first - second).max() > 1.0
    for context in (before, after):
        context.SetTime(1.0)
    np.testing.assert_array_equal(force(controller, before), first)
    np.testing.assert_array_equal(force(controller, after), second)


def test_an_estimate_with_the_wrong_momentum_is_not_used():
    """A target that tumbles, identified as if the momentum were zero, is not known well enough."""
    scenario = load_scenario(shipped_scenario("tumbling_capture"))
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    motion = scenario.make_joint_motion(spacecraft)
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    spacecraft.add_to(plant, target)
    state = plant.get_state_output_port()
    identifier = MomentumIdentifier.AddToBuilder(
        builder, spacecraft, state=state, rows="standard", period=0.25, offset=0.25
    )
    controller = JointController.AddToBuilder(
        builder,
        spacecraft,
        state=state,
        desired_motion=builder.AddSystem(JointMotionSource(motion)).get_output_port(),
        covariance=identifier.GetOutputPort("covariance"),
        spatial_inertia=identifier.GetOutputPort("spatial_inertia"),
        generalized_force=plant.get_applied_generalized_force_input_port(),
    )
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    root_context = simulator.get_mutable_context()
    start = spacecraft.initial_state(target, motion, scenario.simulation.momentum_W)
    plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(root_context), start)
    simulator.AdvanceTo(3.0)
    found = identifier.identification(identifier.GetMyContextFromRoot(root_context))
    assert found.is_observable
    assert not target_of(controller, controller.GetMyContextFromRoot(root_context)).any()
