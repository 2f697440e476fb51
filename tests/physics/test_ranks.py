"""What the motion can show: the rank of the rows, and what is left open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import TotalMomentum, identify
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import CaptureMotion
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples, target_momentum
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import ROW_FAMILIES

KNOWN_MASS = 1031.0  # what free_samples() pretends
FAMILIES = pytest.mark.parametrize("family", ROW_FAMILIES.values(), ids=ROW_FAMILIES)


def scaled_rank(A, tolerance=1e-9):
    """Rank of rows with their columns scaled to unit length, rounding left at zero."""
    A = A.reshape(-1, A.shape[-1])
    norms = np.linalg.norm(A, axis=0)
    s = np.linalg.svd(A / np.where(norms > 1e-12 * norms.max(), norms, norms.max()))[1]
    return int((s > tolerance * s[0]).sum())


def free_samples(target, w, v, seed=0) -> MomentumSamples:
    """Samples in which the known bodies carry just the momentum that cancels the target's."""
    w, v = np.atleast_2d(w).astype(float), np.atleast_2d(v).astype(float)
    rng = np.random.default_rng(seed)
    R_WC = Rotation.random(len(w), rng).as_matrix()
    p_WC = rng.normal(size=(len(w), 3))
    motion = CaptureMotion(R_WC, p_WC, rotate(R_WC, w), rotate(R_WC, v))
    P, L = target_momentum(target, motion)
    return MomentumSamples(motion, -P, -L, p_WC + rng.normal(size=p_WC.shape), KNOWN_MASS)


@FAMILIES
@pytest.mark.parametrize("n", [1, 2, 3, 4, 10])
def test_rank_of_generic_samples(servicer, skewed_target, zero_momentum_motion, family, n):
    """6, 9 and then 10 with six rows a sample; 3, 6, 9 and then 10 with three."""
    samples = momentum_samples(servicer.tree, zero_momentum_motion(skewed_target, n, seed=14))
    ranks = (6, 9, 10) if family.rows_per_sample == 6 else (3, 6, 9, 10)
    assert scaled_rank(family.rows(samples)[0]) == ranks[min(n, len(ranks)) - 1]


@FAMILIES
def test_rank_of_coplanar_angular_velocities_is_nine(skewed_target, family):
    rng = np.random.default_rng(15)
    w = rng.normal(size=(20, 2)) @ rng.normal(size=(2, 3))
    samples = free_samples(skewed_target, w, rng.normal(size=(20, 3)))
    assert scaled_rank(family.rows(samples)[0]) == 9


@FAMILIES
def test_rank_about_a_constant_axis_is_seven(skewed_target, family):
    rng = np.random.default_rng(16)
    w = rng.normal(size=(20, 1)) * [0.3, -0.5, 0.8]
    samples = free_samples(skewed_target, w, rng.normal(size=(20, 3)))
    assert scaled_rank(family.rows(samples)[0]) == 7


@FAMILIES
def test_rank_of_translation_alone_is_four(skewed_target, family):
    v = np.random.default_rng(18).normal(size=(20, 3))
    samples = free_samples(skewed_target, np.zeros((20, 3)), v)
    assert scaled_rank(family.rows(samples)[0]) == 4


@FAMILIES
def test_at_rest_nothing_is_seen(skewed_target, family):
    A, b = family.rows(free_samples(skewed_target, np.zeros((5, 3)), np.zeros((5, 3))))
    assert not A.any()
    assert not b.any()


@pytest.mark.parametrize(("count", "is_known"), [(2, False), (3, True)])
def test_three_samples_suffice_with_six_more_unknowns(
    servicer, random_motion, skewed_target, count, is_known
):
    """Full rank from three generic samples of one constant momentum; two leave more open."""
    telemetry = random_motion(count, seed=31)
    L_P = np.array([4.0, -2.0, 3.0, 1.0, 2.0, -1.5])  # about W's origin, in W
    known = BodyDynamics.at(servicer.tree, telemetry.q, telemetry.qdot)
    psi = standard_to_relative(skewed_target.to_standard_vector(), known.mass)
    R_BW, mass = np.swapaxes(telemetry.R_WB, -1, -2), known.mass + skewed_target.mass
    p_WScm = telemetry.p_WB + rotate(telemetry.R_WB, known.com(psi))
    L_Scm = L_P[:3] - np.cross(p_WScm, L_P[3:])
    twist = known.base_twist(psi, rotate(R_BW, L_Scm), R_BW @ L_P[3:] / mass)
    w_WB, v_WB = (rotate(telemetry.R_WB, part) for part in twist)
    moving = replace(telemetry, w_WB=w_WB, v_WB=v_WB)
    found = identify(servicer, moving, rows="standard", momentum=TotalMomentum.unknown())
    assert found.is_identifiable is is_known
    if is_known:
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), atol=1e-6)
