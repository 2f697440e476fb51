"""The load on a flexible grasp, against the target's momentum."""

import numpy as np
from block_cases import make_case
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite, true_telemetry

from cpid_drake.dynamics.momentum import momentum_samples, target_momentum
from cpid_drake.estimation.likelihood.compliance import wrist_load
from cpid_drake.estimation.likelihood.joint_motion import joint_block
from cpid_drake.estimation.likelihood.model import BlockModel

START, END = 1.0, 2.5


def test_the_load_is_what_changes_the_targets_momentum(tmp_path, skewed_target):
    """Moment about C's origin and force, in C: by differences of the true motion."""
    case = make_case(tmp_path, skewed_target, coarse_suite(), MOMENTUM)
    samples = case.block(START, END).samples
    joints = joint_block(START, END, samples, case.suite, None)
    motion = BlockModel(case.craft.tree, joints, samples, case.suite, None, 0.0125).motion
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
