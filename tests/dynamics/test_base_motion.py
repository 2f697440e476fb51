"""The base's motion from momentum alone: the simulation without the dynamics."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from cpid_drake import (
    HalfCosine,
    InputError,
    JointController,
    JointMotionSource,
    Telemetry,
    initial_state,
)
from cpid_drake.dynamics.base_motion import (
    base_twist,
    base_twist_sensitivity,
    known_dynamics,
    propagate_base,
    target_spatial_inertia,
)
from cpid_drake.dynamics.momentum import total_momentum

TUMBLE = np.array([3.0, -2.0, 4.0, 1.5, -0.8, 0.6])  # [L; P] about W's origin, in W


@pytest.fixture(scope="module")
def motion(servicer):
    rng = np.random.default_rng(61)
    joints = len(servicer.joint_names)
    return HalfCosine(rng.uniform(-1, 1, joints), rng.uniform(-1, 1, joints), duration=10.0)


def as_telemetry(servicer, motion, times, base) -> Telemetry:
    return base.to_telemetry(servicer.joint_names, times, motion)


def test_it_agrees_with_the_full_simulation(paper_run):
    """Base pose to 1e-8 over the paper's motion, at the simulation's own accuracy."""
    simulation, telemetry = paper_run.study.simulation, paper_run.study.telemetry
    base = propagate_base(
        simulation.spacecraft.tree,
        simulation.joint_motion,
        simulation.truth.to_standard_vector(),
        telemetry.time,
    )
    for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB"):
        ours, drake = getattr(base, name), getattr(telemetry, name)
        np.testing.assert_allclose(ours, drake, rtol=0, atol=1e-8, err_msg=name)


def test_a_tumbling_capture_agrees_with_the_full_simulation(servicer, skewed_target, motion):
    """With momentum the base's twist depends on its pose: the same in Drake's dynamics."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(servicer.make_simulation_plant(skewed_target))
    source = builder.AddSystem(JointMotionSource(motion))
    model = servicer.make_simulation_plant(skewed_target)
    JointController.AddToBuilder(
        builder,
        servicer,
        state=plant.get_state_output_port(),
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        plant=model,
    )
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = initial_state(servicer, skewed_target, motion, TUMBLE)
    plant.SetPositionsAndVelocities(context, start)
    simulator.AdvanceTo(6.0)
    end = servicer.to_telemetry([6.0], plant.GetPositionsAndVelocities(context))

    phi = skewed_target.to_standard_vector()
    base = propagate_base(servicer.tree, motion, phi, [0.0, 6.0], momentum_W=TUMBLE)
    sign = np.sign(base.quaternion_WB[1] @ end.quaternion_WB[0])
    np.testing.assert_allclose(sign * base.quaternion_WB[1], end.quaternion_WB[0], atol=3e-8)
    np.testing.assert_allclose(base.p_WB[1], end.p_WB[0], atol=3e-8)
    np.testing.assert_allclose(base.w_WB[1], end.w_WB[0], atol=3e-8)


@pytest.mark.parametrize("momentum", [None, TUMBLE], ids=["at rest", "tumbling"])
def test_momentum_is_what_it_should_be_throughout(servicer, skewed_target, motion, momentum):
    times = np.linspace(0.0, 10.0, 21)
    phi = skewed_target.to_standard_vector()
    base = propagate_base(servicer.tree, motion, phi, times, momentum_W=momentum)
    P, L = total_momentum(servicer.tree, skewed_target, as_telemetry(servicer, motion, times, base))
    expected = np.zeros(6) if momentum is None else momentum
    np.testing.assert_allclose(np.hstack([L, P]), np.tile(expected, (21, 1)), atol=1e-10)


def test_velocities_are_the_rates_of_the_pose(servicer, skewed_target, motion):
    """By differences over 1 ms: p and v, and the attitude with ω, belong together."""
    from scipy.spatial.transform import Rotation

    times = np.array([0.0, 3.999, 4.0, 4.001])
    phi = skewed_target.to_standard_vector()
    base = propagate_base(servicer.tree, motion, phi, times, momentum_W=TUMBLE)
    velocity = (base.p_WB[3] - base.p_WB[1]) / 2e-3
    np.testing.assert_allclose(velocity, base.v_WB[2], atol=1e-8)
    before, after = Rotation.from_quat(base.quaternion_WB[[1, 3]], scalar_first=True)
    rate = (after * before.inv()).as_rotvec() / 2e-3
    np.testing.assert_allclose(rate, base.w_WB[2], atol=1e-8)


def test_many_targets_at_once_are_the_same_as_one_by_one(servicer, skewed_target, motion):
    rng, times = np.random.default_rng(62), np.array([0.0, 2.0, 7.0])
    phi = skewed_target.to_standard_vector() * rng.uniform(0.9, 1.1, (4, 1))
    momenta = TUMBLE * rng.uniform(0.0, 1.0, (4, 1))
    together = propagate_base(servicer.tree, motion, phi, times, momentum_W=momenta)
    for k in range(4):
        one = propagate_base(servicer.tree, motion, phi[k], times, momentum_W=momenta[k])
        for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB"):
            np.testing.assert_allclose(getattr(together, name)[k], getattr(one, name), atol=1e-13)


def test_the_error_falls_with_the_fourth_power_of_the_step(servicer, skewed_target, motion):
    phi, times = skewed_target.to_standard_vector(), np.array([0.0, 10.0])
    exact, coarse, fine = (
        propagate_base(servicer.tree, motion, phi, times, max_step=step).p_WB[1]
        for step in (0.02, 0.8, 0.4)
    )
    order = np.log2(np.linalg.norm(coarse - exact) / np.linalg.norm(fine - exact))
    assert 3.5 < order < 5.5


def test_sensitivity_is_the_derivative_by_the_parameters(servicer, skewed_target, motion):
    samples = motion.evaluate(np.linspace(1.0, 9.0, 5))
    known = known_dynamics(servicer.tree, samples[:, 0], samples[:, 1])
    phi = skewed_target.to_standard_vector()
    momentum = np.tile(TUMBLE, (5, 1))
    V = base_twist(known, phi, momentum)
    exact = base_twist_sensitivity(known, phi, V)
    for j, unit in enumerate(np.eye(10)):
        h = 1e-4
        ahead, behind = (base_twist(known, phi + s * h * unit, momentum) for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * h), exact[..., j], atol=1e-9)


def test_target_inertia_is_drakes(skewed_target):
    """G in Drake's order [rotational; translational] about C's origin."""
    G = target_spatial_inertia(skewed_target.to_standard_vector())
    drake = skewed_target.to_spatial_inertia().CopyToFullMatrix6()
    np.testing.assert_allclose(G, drake, rtol=1e-12, atol=1e-12)


def test_without_a_target_it_is_the_spacecraft_alone(servicer, motion):
    """The known bodies' inertia is that of Drake's mass matrix for the base."""
    q, qdot, _ = motion.evaluate(4.0)
    known = known_dynamics(servicer.tree, q[None], qdot[None])
    context = servicer.plant.CreateDefaultContext()
    columns, _ = servicer.joint_state_columns
    positions = servicer.plant.GetPositions(context)
    positions[columns] = q
    servicer.plant.SetPositions(context, positions)
    mass_matrix = servicer.plant.CalcMassMatrix(context)[:6, :6]
    np.testing.assert_allclose(known.M[0], mass_matrix, atol=1e-9)
    np.testing.assert_allclose(
        base_twist(known, np.zeros(10))[0], np.linalg.solve(mass_matrix, -known.h[0]), atol=1e-12
    )


@pytest.mark.parametrize(
    ("times", "step"), [([1.0, 1.0], 0.1), ([], 0.1), ([0.0, 1.0], 0.0), ([0.0, 1.0], -1.0)]
)
def test_bad_times_are_refused(servicer, skewed_target, motion, times, step):
    with pytest.raises(InputError, match=r"times must be increasing|max_step"):
        propagate_base(
            servicer.tree, motion, skewed_target.to_standard_vector(), times, max_step=step
        )
