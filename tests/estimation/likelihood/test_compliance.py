"""A flexible grasp: its load, and what it does to the base."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import joints_of, make_case
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite, true_telemetry

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import momentum_samples, target_momentum
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.compliance import wrist_load, write_shifts, write_turns
from cpid_drake.estimation.likelihood.effects import MotionChange
from cpid_drake.estimation.likelihood.model import BlockModel

START, END = 1.0, 2.5


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, coarse_suite(), MOMENTUM)


@pytest.fixture(scope="module")
def motion(case):
    samples = case.block(START, END).samples
    joints = joints_of(Block(START, END, samples), case.suite)
    return BlockModel(case.craft.tree, joints, samples, case.suite, None, 0.0125).motion


def test_the_load_is_what_changes_the_targets_momentum(case, motion):
    """Moment about C's origin and force, in C: by differences of the true motion."""
    load = wrist_load(motion, motion.trajectory(case.state(START)))
    times, h = np.array([1.3, 1.7, 2.2]), 1e-3
    truth = true_telemetry(
        case.craft.tree,
        case.craft.joint_names,
        case.motion,
        case.target,
        np.sort(np.concatenate([times - h, times, times + h])),
        MOMENTUM,
    )
    known = momentum_samples(case.craft.tree, truth)
    P, L = target_momentum(case.target, known.motion)
    force = (P[2::3] - P[::3]) / (2 * h)
    moment = (L[2::3] - L[::3]) / (2 * h) + np.cross(known.motion.v_WC[1::3], P[1::3])
    R_CW = Rotation.from_matrix(known.motion.R_WC[1::3]).inv()
    expected = np.hstack([R_CW.apply(moment), R_CW.apply(force)])
    np.testing.assert_allclose(load(times), expected, rtol=0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("prismatic", [False, True], ids=["turns", "shifts"])
def test_a_flexible_grasp_moves_the_base_as_one_more_joint_does(case, motion, prismatic):
    """A joint at C whose position is −(compliance) times the load about or along one axis."""
    trajectory, size = motion.trajectory(case.state(START)), 1e-4
    times, (q, qdot) = (
        motion.times,
        np.moveaxis(motion.joint_motion(motion.times), 1, 0),
    )
    change = MotionChange.zeros(motion, 3)
    write = write_shifts if prismatic else write_turns
    write(motion, trajectory, size, change)
    load = wrist_load(motion, trajectory)
    L_B = np.einsum("nji,nj->ni", trajectory.R, trajectory.L)
    tree = case.craft.tree.with_target(case.target.to_standard_vector())
    for axis in range(3):
        place = 3 * prismatic + axis
        joint = replace(tree.bodies[-1], joint=4, prismatic=prismatic, axis_F=np.eye(3)[axis])
        flexible = replace(tree, bodies=(*tree.bodies[:-1], joint))
        moved = []
        for s in (size, -size):
            at = [
                np.column_stack([x, -s * load(times, k)[:, place]]) for k, x in enumerate((q, qdot))
            ]
            relative = BodyDynamics.at(flexible, *at)
            w, _ = relative.base_twist(np.zeros(10), L_B)
            moved.append((w, relative.p_BK, relative.v_BK))
        found = change.w[..., axis], change.com[..., axis], change.com_rate[..., axis]
        for exact, ahead, behind in zip(found, *moved, strict=True):
            expected = ((ahead - behind) / 2)[: len(exact)]  # ω at the nodes
            tolerance = 1e-3 * np.abs(expected).max()
            np.testing.assert_allclose(exact, expected, rtol=0, atol=tolerance)
