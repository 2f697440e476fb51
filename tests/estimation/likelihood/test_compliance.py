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
from cpid_drake.estimation.likelihood.effect_terms import MotionChange
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

START, END = 1.0, 2.5
STIFFEST = 300.0
"""Compliances in units of `SIZE` at which errors of the joints' acceleration matter."""

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
    trajectory, times = motion.trajectory(case.state(START)), motion.times
    q, qdot = np.moveaxis(motion.joint_motion(times), 1, 0)
    width = load(0.0).size
    change = MotionChange.zeros(motion, width)
    model.effects[kind](motion, trajectory, change)
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


def test_the_joints_errors_change_the_loads_too(case):
    """The derivatives by the joints' splines are those of the predictions, with what yields."""
    samples = case.block(START, END).samples
    joints = joints_of(Block(START, END, samples), case.suite)
    state, rng = case.state(START), np.random.default_rng(7)
    bends = STIFFEST * rng.uniform(0.5, 1.0, len(state.constants))
    state = replace(state, constants=bends)

    def predicted(coefficients):
        part = joints.about(coefficients)
        model = BlockModel(case.craft.tree, part, samples, case.suite, None, 0.0125)
        trajectory = model.motion.trajectory(state)
        bent = model.bent(trajectory)[0]
        own = {n: bent.get(n, 0.0) - s.residuals(trajectory) for n, s in model.sensors.items()}
        return model, trajectory, np.concatenate([each.ravel() for each in own.values()])

    model, trajectory, _ = predicted(joints.coefficients)
    step = rng.normal(size=joints.coefficients.shape) * 1e-6
    ahead, behind = (predicted(joints.coefficients + s * step)[2] for s in (1, -1))
    expected = (ahead - behind) / 2
    J, _ = model.jacobian(trajectory)
    rigid, _ = model.jacobian(replace(trajectory, state=replace(state, constants=0 * bends)))
    place = model.columns["joints"]
    found, without = (each[:, place] @ step.T.ravel() for each in (J, rigid))
    error, bent = (np.linalg.norm(each - expected) for each in (found, without))
    assert bent > 0.1 * np.linalg.norm(expected)
    assert error < 0.1 * bent
