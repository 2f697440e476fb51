"""Flexible joints and a flexible grasp: their loads, and what they do to the base."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import joints_of, make_case
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite, true_telemetry

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import momentum_samples, target_momentum
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.kinematic_changes import with_changes
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion_change import MotionChange
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

START, END = 1.0, 2.5
SIZE = 1e-6
"""Compliance [rad/(N·m) or m/N]."""


@pytest.fixture(scope="module", params=[False, True], ids=["arm", "gripper"])
def case(tmp_path_factory, skewed_target, request):
    each = 1e6 * SIZE
    forces = Disturbances(
        joint_compliance_urad=each, compliance_urad=each, translational_compliance_um=each
    )
    suite = coarse_suite(disturbances=forces, encoders=JointSensor(100.0, 1e-8))
    folder = tmp_path_factory.mktemp("craft")
    return make_case(folder, skewed_target, suite, MOMENTUM, gripper=request.param)


@pytest.fixture(scope="module")
def loads(case):
    """True efforts of the joints by Drake, and moment and force on the target, in C, by time."""
    craft, times = case.craft, np.arange(START - 0.1, END + 0.1, 0.005)
    truth = true_telemetry(
        craft.tree, craft.joint_names, case.motion, case.target, times, case.momentum_W
    )
    plant = craft.make_simulation_plant(case.target)
    qddot = case.motion.evaluate(times)[:, 2]
    efforts = FreeFloatingDynamics(craft, plant).joint_efforts(
        plant.CreateDefaultContext(), craft.to_states(truth), qddot
    )
    known = momentum_samples(craft.tree, truth)
    P, L = target_momentum(case.target, known.motion)
    force, moment = (CubicSpline(times, each).derivative()(times) for each in (P, L))
    moment = moment + np.cross(known.motion.v_WC, P)
    R_CW = Rotation.from_matrix(known.motion.R_WC).inv()
    load = np.hstack([efforts, R_CW.apply(moment), R_CW.apply(force)])
    return {
        "joint_compliance": CubicSpline(times, load[:, :-6]),
        "compliance": CubicSpline(times, load[:, -6:-3]),
        "translational_compliance": CubicSpline(times, load[:, -3:]),
    }


@pytest.mark.parametrize("kind", ["joint_compliance", "compliance", "translational_compliance"])
def test_what_yields_moves_the_base_as_joints_do_that_have_moved(case, loads, kind):
    """A joint, or one more joint at C, is at −(compliance) times its load by an independent way."""
    samples = case.block(START, END).samples
    joints = joints_of(Block(START, END, samples), case.suite)
    model = BlockModel(case.craft.tree, joints, samples, case.suite, None, 0.0125)
    motion, load = model.motion, loads[kind]
    [trajectory] = with_changes([motion.trajectory(case.state(START))])
    times = motion.times
    q, qdot = np.moveaxis(motion.joint_motion(times), 1, 0)
    width = load(0.0).size
    change = MotionChange.zeros(trajectory, width)
    model.effects[kind](trajectory, change)
    L_B = np.einsum("nji,nj->ni", trajectory.R, trajectory.L)
    tree = case.craft.tree.with_target(case.target.to_standard_vector())
    for axis in range(width):
        joints = q.shape[1]
        last = replace(tree.bodies[-1], joint=joints, axis_F=np.eye(3)[axis % 3])
        last = replace(last, prismatic=kind == "translational_compliance")
        at_joint = kind == "joint_compliance"
        flexible = tree if at_joint else replace(tree, bodies=(*tree.bodies[:-1], last))
        moved = []
        for s in (SIZE, -SIZE):
            at = []
            for k, x in enumerate((q, qdot)):
                bend = -s * load(times, k)[:, axis]
                bent = x + np.eye(joints)[axis] * bend[:, None] if at_joint else np.c_[x, bend]
                at.append(bent)
            relative = BodyDynamics.at(flexible, *at)
            w, _ = relative.base_twist(np.zeros(10), L_B)
            moved.append((w, relative.p_BK, relative.v_BK))
        found = change.w[..., axis], change.com[..., axis], change.com_rate[..., axis]
        for exact, ahead, behind in zip(found, *moved, strict=True):
            expected = ((ahead - behind) / 2)[: len(exact)]  # ω at the nodes
            error = np.abs(exact - expected) / np.abs(expected).max()
            is_inside = np.abs(times[: len(exact)] - (START + END) / 2) < 0.5
            assert error[is_inside].max() < 1e-3
            assert error.max() < 0.03  # the samples of one block tell little about its ends
