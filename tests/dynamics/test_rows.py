"""Eqs. 6-18: the rows hold at the truth, the errata matter, and the ranks are what theory says."""

import numpy as np
import pytest
from paper_equations import (
    eq18_to_world,
    instantaneous_rows,
)
from sensing_cases import true_telemetry

from cpid_drake import HalfCosine
from cpid_drake.dynamics.momentum import momentum_samples, system_momentum
from cpid_drake.dynamics.parameterizations import EQ18
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import (
    EQ18_ROWS,
    RELATIVE_ROWS,
    ROW_FAMILIES,
    STANDARD_ROWS,
    conserved,
)

KNOWN_MASS = 1031.0  # of the servicer, and what free_samples() pretends
FAMILIES = pytest.mark.parametrize("family", ROW_FAMILIES.values(), ids=ROW_FAMILIES)


# -- operators ---------------------------------------------------------------------------------


# -- the rows hold at the truth ----------------------------------------------------------------


@FAMILIES
def test_rows_hold_at_the_truth(servicer, skewed_target, zero_momentum_motion, family):
    """Eq. 18 and the standard form, on random states of zero momentum, to 1e-12 of their size."""
    samples = momentum_samples(servicer.tree, zero_momentum_motion(skewed_target, 50, seed=3))
    A, b = family.rows(samples)
    truth = family.parameterization(KNOWN_MASS).from_parameters(skewed_target.to_vector())
    size = (np.abs(A) @ np.abs(truth)).max()
    assert np.abs(A @ truth - b).max() < 1e-12 * size


def test_both_families_are_the_same_physics(servicer, skewed_target, random_motion):
    """m times the top eq18 rows is the top standard row at any momentum, and they differ below by
    the same top row crossed with c: residuals vanish together, with or without momentum."""
    samples = momentum_samples(servicer.tree, random_motion(8, seed=8))
    (A, b), (S, d) = EQ18_ROWS.rows(samples), STANDARD_ROWS.rows(samples)
    theta = EQ18.from_parameters(skewed_target.to_vector())
    phi = skewed_target.to_standard_vector()
    eq18, standard = A @ theta - b, S @ phi - d
    top = skewed_target.mass * eq18[:, :3]
    np.testing.assert_allclose(standard[:, :3], top, rtol=0, atol=1e-10)
    crossed = np.cross(skewed_target.p_CTcm_C, standard[:, :3])
    np.testing.assert_allclose(standard[:, 3:], eq18[:, 3:] + crossed, rtol=0, atol=1e-9)


def test_conserved_rows_are_momentum_and_centre_of_mass_of_the_system(
    servicer, skewed_target, random_motion
):
    """At the truth, of any motion: against sums over the bodies about W's origin."""
    motion = random_motion(8, seed=4)
    samples = momentum_samples(servicer.tree, motion)
    psi = RELATIVE_ROWS.parameterization(KNOWN_MASS).from_parameters(skewed_target.to_vector())
    H, v, p = conserved(samples) @ np.append(psi, -1.0)
    P_W, L_W = system_momentum(servicer.tree, skewed_target, motion)
    mass = KNOWN_MASS + skewed_target.mass
    p_WTcm = samples.motion.p_WC + rotate(samples.motion.R_WC, skewed_target.p_CTcm_C)
    p_WScm = (KNOWN_MASS * samples.p_WKcm + skewed_target.mass * p_WTcm) / mass
    np.testing.assert_allclose(p, p_WScm, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(v, P_W / mass, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(H, L_W - np.cross(p_WScm, P_W), rtol=1e-11, atol=1e-9)


# -- the paper's equations one by one ----------------------------------------------------------


@pytest.fixture(scope="module")
def case(servicer, skewed_target, zero_momentum_motion):
    telemetry = zero_momentum_motion(skewed_target, 12, seed=9)
    return telemetry, momentum_samples(servicer.tree, telemetry)


def test_eq18_is_eq14_with_the_unknowns_turned_into_C(case):
    """Eqs. 15-17 carry Eq. 14 over to Eq. 18."""
    _, samples = case
    A_W, b_W = instantaneous_rows(samples)
    R_WC = samples.motion.R_WC
    to_C = np.zeros((len(samples), 6, 6))
    to_C[:, :3, :3] = to_C[:, 3:, 3:] = np.swapaxes(R_WC, -1, -2)
    A, b = EQ18_ROWS.rows(samples)
    expected = to_C @ A_W @ eq18_to_world(R_WC)
    np.testing.assert_allclose(A, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(b, rotate(to_C, b_W), rtol=0, atol=1e-11)


# -- unknown momentum, position and attitude -----------------------------------------------------


@pytest.fixture(scope="module")
def tumbling(servicer, skewed_target):
    """Samples of a motion of all joints with momentum [L0; P0] about W's origin."""
    rng = np.random.default_rng(20)
    joints = len(servicer.joint_names)
    motion = HalfCosine(rng.uniform(-1, 1, joints), rng.uniform(-1, 1, joints), duration=10.0)
    times, momentum = np.linspace(0.5, 9.5, 12), np.array([4.0, -2.0, 3.0, 1.0, 2.0, -1.5])
    telemetry = true_telemetry(
        servicer.tree, servicer.joint_names, motion, skewed_target, times, momentum
    )
    return telemetry, momentum_samples(servicer.tree, telemetry), momentum


def test_standard_rows_hold_with_the_momentums_columns(tumbling, skewed_target):
    _, samples, momentum = tumbling
    rows = STANDARD_ROWS.full_rows(samples, True)
    truth = np.concatenate([momentum, skewed_target.to_standard_vector(), [-1.0]])
    np.testing.assert_allclose(rows @ truth, 0.0, atol=1e-10)


def test_relative_rows_hold_with_the_angular_momentum_about_the_centre_of_mass(
    tumbling, skewed_target
):
    """L0 about W's origin, less what the moving centre of mass carries: constant."""
    _, samples, momentum = tumbling
    total = samples.mass + skewed_target.mass
    c_W = rotate(samples.motion.R_WC, skewed_target.p_CTcm_C)
    target = skewed_target.mass * (samples.motion.p_WC + c_W)
    com = (samples.mass * samples.p_WKcm + target) / total
    about_com = momentum[:3] - np.cross(com, momentum[3:])
    np.testing.assert_allclose(about_com, np.tile(about_com[0], (12, 1)), atol=1e-9)

    rows = RELATIVE_ROWS.full_rows(samples, True)
    psi = RELATIVE_ROWS.parameterization(samples.mass).from_parameters(skewed_target.to_vector())
    np.testing.assert_allclose(rows @ np.concatenate([about_com[0], psi, [-1.0]]), 0, atol=1e-9)
