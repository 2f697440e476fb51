"""Joint motion source and controller: the arms move as told, with a known estimate in the model."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import BsplineBasis
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import BsplineTrajectory

from cpid_drake import (
    HalfCosine,
    InputError,
    JointController,
    JointTrajectory,
    MultiSine,
    Spline,
    identify,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.simulation.flexible import CompliantWrist


@pytest.fixture(scope="module", params=[True, False], ids=["informed", "blind"])
def run(request):
    """Return whether the controller knows the target, three seconds of simulation, telemetry."""
    scenario = load_scenario(shipped_scenario("paper"))
    scenario.simulation.duration, scenario.simulation.simulator.accuracy = 3.0, 1e-9
    scenario.controller.has_target_model = request.param
    scenario.controller.nominal_mass = 60.0
    simulation = make_simulation(scenario)
    context = simulation.run()
    return request.param, simulation, simulation.motion(context)


def joint_errors(simulation, telemetry):
    """Return (position, rate) errors of the joints."""
    desired = simulation.joint_motion.evaluate(telemetry.time)
    return telemetry.q - desired[:, 0], telemetry.qdot - desired[:, 1]


KNOTS = np.array([[0.0, 1.0]] * 3 + [[0.4, -0.2]] * 3 + [[0.7, 0.3]] * 3)
MOTIONS = {
    "half cosine": HalfCosine([0.0, 1.0], [2.0, 0.5], 4.0),
    "sines": MultiSine([0.3, -1.0], [[0.5, -0.2]], [0.4], [[0.4, -1.0]], 1.0, 4.0, [0.2, 1.0]),
    "spline": Spline(KNOTS, 4.0),
}


def outputs(source, times):
    """Return positions, rates and accelerations (N, 3, J) of a source."""
    context, values = source.CreateDefaultContext(), []
    for time in times:
        context.SetTime(time)
        values.append(source.get_output_port().Eval(context).reshape(3, -1))
    return np.array(values)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_source_moves_when_it_is_told_and_rests_before_and_after(motion):
    """Rates and accelerations are differences; those of the ends are of the motion between them."""
    source, start, end, h = JointTrajectory(motion, start=5.0).source(), 5.0, 9.0, 1e-4
    for time in (5.4, 7.0, 8.7):
        behind, now, ahead = outputs(source, [time - h, time, time + h])
        np.testing.assert_allclose((ahead - behind)[:2] / (2 * h), now[1:], atol=1e-6)
    for time, step in ((start, h), (end, -h)):
        now, next_, last = outputs(source, [time, time + step, time + 2 * step])
        inwards = (4 * next_ - 3 * now - last)[:2] / (2 * step)
        np.testing.assert_allclose(inwards, now[1:], atol=1e-6)
    first, last = outputs(source, [start, end])[:, 0]
    before, after = outputs(source, [-1.0, start - 1e-9]), outputs(source, [end + 1e-9, 1e3])
    np.testing.assert_array_equal(before[:, 0], [first] * 2)
    np.testing.assert_array_equal(after[:, 0], [last] * 2)
    assert not before[:, 1:].any()
    assert not after[:, 1:].any()


def test_a_spline_and_drakes_have_the_same_layout_and_values():
    """Positions, rates, accelerations: either drives a `JointController`."""
    knots = np.concatenate([np.zeros(5), np.linspace(0.0, 4.0, 5), np.full(5, 4.0)])
    drakes = TrajectorySource(
        BsplineTrajectory(BsplineBasis(6, knots), [*KNOTS[:, :, None]]), output_derivative_order=2
    )
    times = [-1.0, 0.0, 0.7, 1.0, 2.3, 3.9, 4.0, 4.0 + 1e-9, 7.0]
    values = outputs(JointTrajectory(MOTIONS["spline"]).source(), times)
    np.testing.assert_allclose(values, outputs(drakes, times), rtol=0, atol=1e-12)


def test_another_trajectory_can_take_the_place_of_the_first():
    source = JointTrajectory(HalfCosine([0.0], [1.0], 4.0)).source()
    source.UpdateTrajectory(JointTrajectory(HalfCosine([1.0], [-2.0], 3.0), start=20.0))
    [[position, rate, acceleration]] = outputs(source, [21.5])[..., 0]
    np.testing.assert_allclose([position, rate], [-0.5, -np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


def test_the_arms_follow_exactly_or_by_feedback(run):
    """Without the target in the model within four degrees."""
    is_informed, *simulated = run
    largest = np.abs(joint_errors(*simulated)).max()
    assert largest < 1e-6 if is_informed else 1e-5 < largest < np.radians(4.0)


def test_momentum_is_conserved_whatever_the_controller_believes(run):
    _, simulation, telemetry = run
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    assert np.abs(P).max() < 1e-6
    assert np.abs(L).max() < 1e-6
    found = identify(simulation.spacecraft, telemetry, rows="standard")
    np.testing.assert_allclose(found.parameters, simulation.truth.to_vector(), rtol=0, atol=1e-4)


def test_commanded_acceleration_is_what_the_plant_does(servicer, skewed_target, random_motion):
    """M v̇ + C = τ in the full plant: the joints accelerate as asked, to rounding."""
    plant = servicer.make_simulation_plant(skewed_target)
    controller = JointController(
        servicer, target=skewed_target, natural_frequency=3.0, damping_ratio=0.7
    )
    state = servicer.to_states(random_motion(1, seed=52))[0]
    desired = np.random.default_rng(53).normal(size=(3, 12))
    context = controller.CreateDefaultContext()
    controller.GetInputPort("state").FixValue(context, state)
    controller.GetInputPort("desired_motion").FixValue(context, desired.ravel())
    force = controller.GetOutputPort("generalized_force").Eval(context)

    plant_context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(plant_context, state)
    plant.get_applied_generalized_force_input_port().FixValue(plant_context, force)
    vdot = plant.EvalTimeDerivatives(plant_context).CopyToVector()[plant.num_positions() :]
    columns_q, columns_v = (servicer.state_columns[name] for name in ("q", "qdot"))
    expected = (
        desired[2]
        + 2 * 0.7 * 3.0 * (desired[1] - state[columns_v])
        + 9.0 * (desired[0] - state[columns_q])
    )
    np.testing.assert_allclose(vdot[columns_v - plant.num_positions()], expected, atol=1e-9)


def wired(servicer, target, joints=12):
    """Return a builder with a plant and a controller that follows a motion of so many joints."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(servicer.make_simulation_plant(target))
    motion = HalfCosine(np.zeros(joints), np.full(joints, 0.1), 10.0)
    source = builder.AddSystem(JointTrajectory(motion).source())
    JointController.AddToBuilder(
        builder,
        servicer,
        state=plant.get_state_output_port(),
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=target,
        natural_frequency=4.0,
    )
    return builder, plant


def test_a_controller_is_wired_to_the_plant_that_it_drives(servicer, paper_target):
    """Started off its motion by 0.01 rad, every joint comes to it as (1 + ωt) exp(−ωt)."""
    builder, plant = wired(servicer, paper_target)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    q = servicer.state_columns["q"]
    state = plant.GetPositionsAndVelocities(context).copy()
    state[q] += 0.01
    plant.SetPositionsAndVelocities(context, state)
    simulator.AdvanceTo(0.5)
    desired = HalfCosine(np.zeros(12), np.full(12, 0.1), 10.0).evaluate(0.5)[0]
    error = plant.GetPositionsAndVelocities(context)[q] - desired
    np.testing.assert_allclose(error, 0.01 * 3 * np.exp(-2), rtol=1e-5)


def test_wiring_a_motion_of_other_joints_is_refused(servicer, paper_target):
    with pytest.raises(InputError, match="21 entries, but 'desired_motion' of joint"):
        wired(servicer, paper_target, joints=7)


def test_a_model_whose_target_on_springs_has_no_mass_is_refused(servicer, paper_target, inputs):
    """Nothing says how it accelerates."""
    wrist = CompliantWrist(np.full(3, 500.0))
    plant = servicer.make_simulation_plant(paper_target, wrist.connect)
    controller = JointController(servicer, connect=wrist.connect, plant=plant)
    context = controller.CreateDefaultContext()
    state = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    controller.GetInputPort("state").FixValue(context, state)
    controller.GetInputPort("desired_motion").FixValue(context, inputs[1])
    with pytest.raises(InputError, match="the target must have a mass"):
        controller.GetOutputPort("generalized_force").Eval(context)


# -- the estimate in the model ------------------------------------------------------------------

PRECISE = 0.01
"""σ relative to the scale of each parameter: within the tolerance of 0.05."""


@pytest.fixture
def inputs(servicer, random_motion):
    """A state in motion, and a desired motion of the joints."""
    state = servicer.to_states(random_motion(1, seed=4))[0]
    joints = len(servicer.joint_names)
    return state, np.random.default_rng(5).normal(0.0, 0.3, 3 * joints)


def fixed(controller, inputs, estimate=None, sigma=np.nan, passed=True):
    """Return a context of the controller with these inputs and an estimate of relative σ."""
    context = controller.CreateDefaultContext()
    controller.GetInputPort("state").FixValue(context, inputs[0])
    controller.GetInputPort("desired_motion").FixValue(context, inputs[1])
    give(controller, context, estimate, sigma, passed)
    return context


def give(controller, context, estimate, sigma, passed=True):
    inertia, covariance = SpatialInertia.NaN(), np.full((10, 10), np.nan)
    if estimate is not None:
        inertia = estimate.to_spatial_inertia()
        covariance = np.diag((sigma * parameter_scale(estimate.to_vector())) ** 2)
    controller.GetInputPort("covariance").FixValue(context, covariance.ravel())
    controller.GetInputPort("spatial_inertia").FixValue(context, Value(inertia))
    controller.GetInputPort("checks_passed").FixValue(context, [float(passed)])


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


def test_a_known_estimate_becomes_the_models_target_and_stays(
    servicer, inputs, skewed_target, paper_target
):
    """The efforts are those without any target before, then those of a controller that knows it."""
    controller = JointController(servicer, reads_estimate=True)
    context = fixed(controller, inputs)
    expected = dict(rtol=1e-11, atol=1e-11)
    update(controller, context)
    np.testing.assert_allclose(
        force(controller, context), constant_force(servicer, inputs), **expected
    )
    for estimate, sigma, target in (
        (skewed_target, PRECISE, skewed_target),
        (None, np.nan, skewed_target),
        (paper_target, 0.5, skewed_target),
        (paper_target, PRECISE, paper_target),
    ):
        give(controller, context, estimate, sigma)
        update(controller, context)
        found = target_of(controller, context)
        np.testing.assert_allclose(found, target.to_vector(), atol=1e-12)
        np.testing.assert_allclose(
            force(controller, context), constant_force(servicer, inputs, target), **expected
        )


@pytest.mark.parametrize(("entry", "wide"), [(0, 0.06), (3, np.nan), (9, 0.06)])
def test_one_parameter_that_is_not_known_well_enough_keeps_the_model(
    servicer, inputs, skewed_target, entry, wide
):
    controller = JointController(servicer, reads_estimate=True, tolerance=0.05)
    sigma = np.full(10, PRECISE)
    sigma[entry] = wide
    context = fixed(controller, inputs, skewed_target, sigma)
    update(controller, context)
    assert not target_of(controller, context).any()


def test_an_estimate_whose_checks_fail_never_enters_the_model(
    servicer, inputs, skewed_target, paper_target
):
    """However precise it claims to be; what was in the model before stays."""
    controller = JointController(servicer, reads_estimate=True)
    context = fixed(controller, inputs, skewed_target, 1e-6, passed=False)
    update(controller, context)
    assert not target_of(controller, context).any()
    for estimate, passed in ((paper_target, True), (skewed_target, False)):
        give(controller, context, estimate, 1e-6, passed)
        update(controller, context)
        found = target_of(controller, context)
        np.testing.assert_allclose(found, paper_target.to_vector(), atol=1e-12)


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
