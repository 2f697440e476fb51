"""The momentum is conserved: in Drake's dynamics, and in the motion that follows from it alone."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from sensing_cases import MOMENTUM, Sines, small_craft, true_psi, true_telemetry

from cpid_drake import (
    HalfCosine,
    JointController,
    JointTrajectory,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.rotations import rotate

TUMBLE = np.array([3.0, -2.0, 4.0, 1.5, -0.8, 0.6])  # [L; P] about W's origin, in W


@pytest.fixture(scope="module")
def motion(servicer):
    rng = np.random.default_rng(61)
    joints = len(servicer.joint_names)
    return HalfCosine(rng.uniform(-1, 1, joints), rng.uniform(-1, 1, joints), duration=10.0)


@pytest.fixture(scope="module")
def drake(servicer, skewed_target, motion):
    """Return ten seconds of a tumbling capture in Drake: the plant, the states, the telemetry."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(servicer.make_simulation_plant(skewed_target))
    source = builder.AddSystem(JointTrajectory(motion).source())
    JointController.AddToBuilder(
        builder,
        servicer,
        state=plant.get_state_output_port(),
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=skewed_target,
    )
    logger = LogVectorOutput(plant.get_state_output_port(), builder, 1.0)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = servicer.initial_state(skewed_target, motion, TUMBLE)
    plant.SetPositionsAndVelocities(context, start)
    simulator.AdvanceTo(10.0)
    log = logger.FindLog(simulator.get_context())
    states = log.data().T
    return plant, states, servicer.to_motion(log.sample_times(), states)


def test_drake_conserves_the_momentum(drake):
    """As Drake itself computes it, about W's origin."""
    plant, states, _ = drake
    context = plant.CreateDefaultContext()
    for state in states:
        plant.SetPositionsAndVelocities(context, state)
        found = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
        np.testing.assert_allclose(found, TUMBLE, rtol=0, atol=1e-6)


def test_the_motion_that_follows_from_the_momentum_is_drakes(
    servicer, skewed_target, motion, drake
):
    """`propagate` knows no forces: with momentum, the base's twist depends on its pose."""
    _, _, telemetry = drake
    phi = skewed_target.to_standard_vector()
    base = propagate(servicer.tree, motion, phi, telemetry.time, momentum_W=TUMBLE)
    sign = np.sign(np.sum(base.quaternion_WB * telemetry.quaternion_WB, axis=1, keepdims=True))
    np.testing.assert_allclose(sign * base.quaternion_WB, telemetry.quaternion_WB, atol=1e-6)
    for name in ("p_WB", "v_WB", "w_WB"):
        ours, drakes = getattr(base, name), getattr(telemetry, name)
        np.testing.assert_allclose(ours, drakes, rtol=0, atol=1e-6, err_msg=name)


def test_angular_momentum_is_constant_and_the_centre_of_mass_goes_straight(servicer, skewed_target):
    rng = np.random.default_rng(73)
    ends = rng.uniform(-1, 1, (2, len(servicer.joint_names)))
    motion, times = HalfCosine(*ends, duration=10.0), np.linspace(0.0, 10.0, 11)
    telemetry = true_telemetry(
        servicer.tree, servicer.joint_names, motion, skewed_target, times, MOMENTUM
    )
    dynamics = BodyDynamics.at(servicer.tree, telemetry.q, telemetry.qdot)
    psi, R = true_psi(servicer, skewed_target), telemetry.R_WB
    w = rotate(np.swapaxes(R, -1, -2), telemetry.w_WB)
    L = rotate(R, rotate(dynamics.inertia(psi), w) + dynamics.momentum_at_rest(psi))
    p_Wcm = telemetry.p_WB + rotate(R, dynamics.com(psi))
    mass = servicer.mass + skewed_target.mass
    straight = p_Wcm[0] + times[:, None] * MOMENTUM[3:] / mass
    about_com = MOMENTUM[:3] - np.cross(p_Wcm[0], MOMENTUM[3:])
    np.testing.assert_allclose(p_Wcm, straight, rtol=0, atol=1e-9)
    np.testing.assert_allclose(L, np.tile(about_com, (11, 1)), rtol=0, atol=1e-7)


@pytest.mark.parametrize("wheels", [False, True])
def test_a_sliding_joint_and_wheels_conserve_it_too(tmp_path, skewed_target, wheels):
    craft = small_craft(tmp_path, wheels=wheels)
    motion, times = Sines.drawn(len(craft.joint_names), 5, 4.0), np.linspace(0, 4, 9)
    telemetry = true_telemetry(
        craft.tree, craft.joint_names, motion, skewed_target, times, MOMENTUM
    )
    P, L = system_momentum(craft.tree, skewed_target, telemetry)
    np.testing.assert_allclose(np.hstack([L, P]), np.tile(MOMENTUM, (9, 1)), atol=1e-6)
