"""Errata of Ning et al. 2016: the equations hold as corrected, and not as printed."""

from dataclasses import replace

import numpy as np
import pytest
from paper.study import sampling_times
from paper.values import PAPER_TABLE_1
from paper_equations import instantaneous_rows, linear_rows
from pydrake.multibody.tree import RotationalInertia, SpatialInertia

from cpid_drake import HalfCosine, InputError, identify, load_scenario, shipped_scenario
from cpid_drake.dynamics.kinematics import CaptureMotion, forward_kinematics
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples, target_momentum
from cpid_drake.dynamics.parameterizations import EQ18, tensor_to_vector
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import EQ18_ROWS


@pytest.fixture(scope="module")
def case(servicer, skewed_target, zero_momentum_motion):
    telemetry = zero_momentum_motion(skewed_target, 12, seed=9)
    return telemetry, momentum_samples(servicer.tree, telemetry)


@pytest.fixture(scope="module")
def papers():
    """Return the telemetry of the paper's case at t = 1, …, 10 s, from its motion and momentum."""
    scenario = load_scenario(shipped_scenario("paper"))
    spacecraft, times = scenario.spacecraft.make(), sampling_times(scenario)
    motion, phi = scenario.make_joint_motion(spacecraft), scenario.target_truth()
    base = propagate(spacecraft.tree, motion, phi.to_standard_vector(), [0.0, *times])
    whole = base.to_motion(spacecraft.joint_names, [0.0, *times], motion)
    return whole.select(slice(1, None))


def unknowns_in_world(target, R_WC):
    """Return (1/m, c) in W."""
    mass = np.full((len(R_WC), 1), 1 / target.mass)
    return np.hstack([mass, rotate(R_WC, target.p_CTcm_C)])


def without_base(servicer, telemetry) -> MomentumSamples:
    """The paper's sums taken literally: i = 1, the base left out."""
    bodies, capture = forward_kinematics(servicer.tree, **telemetry.states)
    P, L = np.zeros_like(capture.p_WC), np.zeros_like(capture.p_WC)
    for k, body in enumerate(servicer.tree.bodies):
        if k == 0:
            continue
        v, r, R = bodies.v[k], bodies.r[k], bodies.R[k]
        I_W = R @ body.I_BBcm @ np.swapaxes(R, -1, -2)
        P += body.mass * v
        L += rotate(I_W, bodies.w[k]) + body.mass * np.cross(r - capture.p_WC, v)
    return MomentumSamples(capture, P, L, bodies.r[0], servicer.mass)


def test_erratum_sums_from_one_give_a_negative_mass(servicer, papers):
    """Errata 1: without the base, the paper's own case has a negative mass."""
    masses = []
    for samples in (without_base(servicer, papers), momentum_samples(servicer.tree, papers)):
        A, b = EQ18_ROWS.rows(samples)
        theta = np.linalg.lstsq(A.reshape(-1, 10), b.ravel(), rcond=None)[0]
        masses.append(1 / theta[0])
    assert masses[0] < 0
    assert masses[1] == pytest.approx(100.0, rel=1e-6)


def test_erratum_right_hand_side_is_the_capture_points_velocity(case, skewed_target):
    """Errata 2: with the target's own v_n, ω_n and b_n = −c_n, Eq. 14 does not hold."""
    _, samples = case
    motion = samples.motion
    A, _ = linear_rows(samples)
    unknowns = unknowns_in_world(skewed_target, motion.R_WC)
    c_W = rotate(motion.R_WC, skewed_target.p_CTcm_C)
    v_n = motion.v_WC + np.cross(motion.w_WC, c_W)
    assert np.abs(rotate(A, unknowns) + v_n).max() > 1e-2


def test_erratum_angular_momentum_is_about_the_capture_point(servicer, case, skewed_target):
    """Errata 3: about a link's centroid instead of the capture point the rows fail."""
    telemetry, samples = case
    bodies, capture = forward_kinematics(servicer.tree, **telemetry.states)
    names = [body.name for body in servicer.tree.bodies]
    centroid = bodies.r[names.index("capture_arm_gripper")]
    L = samples.L + np.cross(capture.p_WC - centroid, samples.P)
    A, b = EQ18_ROWS.rows(replace(samples, L=L))
    assert np.abs(A @ EQ18.from_parameters(skewed_target.to_vector()) - b).max() > 1e-2


def test_erratum_rigid_grasp_is_assumed(servicer, case, skewed_target):
    """Errata 4: a target that turns in the grasp violates the rows."""
    _, samples = case
    motion = samples.motion
    slipping = CaptureMotion(motion.R_WC, motion.p_WC, motion.w_WC + [0.1, 0, 0], motion.v_WC)
    P, L = target_momentum(skewed_target, slipping)
    A, b = EQ18_ROWS.rows(replace(samples, P=-P, L=-L))
    assert np.abs(A @ EQ18.from_parameters(skewed_target.to_vector()) - b).max() > 1e-2


def test_erratum_world_frame_rows_cannot_be_stacked(case, skewed_target):
    """Errata 5: c and I change in W; stacked over time Eq. 14 finds a wrong target."""
    _, samples = case
    A, b = instantaneous_rows(samples)
    stacked = np.linalg.lstsq(A.reshape(-1, 10), b.ravel(), rcond=None)[0]
    assert abs(1 / stacked[0] - skewed_target.mass) > 1.0
    A, b = EQ18_ROWS.rows(samples)
    stacked = np.linalg.lstsq(A.reshape(-1, 10), b.ravel(), rcond=None)[0]
    assert 1 / stacked[0] == pytest.approx(skewed_target.mass, rel=1e-9)


def test_erratum_two_samples_leave_one_combination_open(case):
    """Errata 6: with n = ω1 × ω2, the inertia n nᵀ can be added without any row noticing."""
    _, samples = case
    A = EQ18_ROWS.rows(samples)[0][:2].reshape(-1, 10)
    w_C = rotate(np.swapaxes(samples.motion.R_WC, -1, -2), samples.motion.w_WC)
    n = np.cross(w_C[0], w_C[1])
    null = np.concatenate([np.zeros(4), tensor_to_vector(np.outer(n, n))])
    assert np.abs(A @ null).max() < 1e-12 * np.abs(A).max() * np.abs(null).max()


def test_erratum_the_error_falls_with_every_digit(servicer, papers):
    """Errata 7: no plateau from 4 to 9 digits, where the paper's Table 2 has one of 0.1 kg."""
    errors = []
    for digits in (4, 6, 8):
        found = identify(servicer, papers.rounded(digits), rows="eq18")
        errors.append(abs(found.parameters[0] - 100.0))
    assert errors[0] > 20 * errors[1] > 400 * errors[2]
    assert errors[2] < 1e-3


def test_erratum_the_papers_identified_inertia_is_no_rigid_body():
    """Erratum 8: Table 1's inertia violates the triangle inequality; Drake refuses it."""
    assert not PAPER_TABLE_1.is_physically_consistent()
    assert "triangle inequality" in PAPER_TABLE_1.inconsistencies()[0]
    with pytest.raises(InputError, match="nearest_consistent"):
        PAPER_TABLE_1.to_spatial_inertia()
    I = PAPER_TABLE_1.I_TTcm_C  # noqa: E741
    with pytest.raises(RuntimeError):
        SpatialInertia.MakeFromCentralInertia(
            PAPER_TABLE_1.mass,
            PAPER_TABLE_1.p_CTcm_C,
            RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]),
        )


def test_erratum_the_papers_motion_is_at_rest_at_both_ends():
    """Errata 9: q(t) = q0 + Δ/2 (1 − cos(π t/T)), whose rates vanish at 0 and T."""
    first, last = np.array([0.0, 1.0, -0.5]), np.array([2.0, 1.0, 0.5])
    motion, t = HalfCosine(first, last, duration=10.0), np.linspace(0, 10, 41)
    expected = first + (last - first) / 2 * (1 - np.cos(np.pi * t / 10)).reshape(-1, 1)
    np.testing.assert_allclose(motion.evaluate(t)[:, 0], expected, atol=1e-14)
    np.testing.assert_allclose(motion.evaluate([0.0, 10.0])[:, 1], 0.0, atol=1e-15)
