"""Least squares on momentum rows: a known momentum enters as an unknown one would be estimated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters, TotalMomentum, identify
from cpid_drake.dynamics.momentum import momentum_samples, system_momentum
from cpid_drake.dynamics.rows import RELATIVE_ROWS, ROW_FAMILIES, STANDARD_ROWS
from cpid_drake.estimation.momentum_rows import changed_motion, momentum_rows
from cpid_drake.estimation.rows_fit import LogRows


@pytest.fixture(scope="module")
def drifting(servicer, skewed_target, zero_momentum_motion):
    """Samples of zero angular momentum in a frame that drifts past: P is not zero in W."""
    motion = zero_momentum_motion(skewed_target, 12, 5)
    velocity = np.array([0.02, -0.01, 0.03])
    return replace(motion, v_WB=motion.v_WB + velocity), velocity


@pytest.mark.parametrize("rows", ["standard", "eq18", "relative"])
def test_a_known_momentum_gives_the_target(servicer, skewed_target, drifting, rows):
    telemetry, velocity = drifting
    known = TotalMomentum(np.zeros(3), velocity)
    found = identify(servicer, telemetry, rows=rows, momentum=known)
    np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-8, atol=1e-8)
    if rows != "relative":  # relative rows depend on no constant linear momentum
        ignored = identify(servicer, telemetry, rows=rows)
        assert not abs(ignored.parameters[0] - skewed_target.mass) < 1.0  # wrong, or no answer
        assert ignored.failures


@pytest.mark.parametrize("family", ROW_FAMILIES.values(), ids=ROW_FAMILIES)
def test_a_known_angular_momentum_is_that_of_the_samples(
    servicer, skewed_target, random_motion, family
):
    """At the true target every row is fulfilled, sample by sample, whatever the momentum."""
    motion = random_motion(5, 8)
    P, L = system_momentum(servicer.tree, skewed_target, motion)
    samples = momentum_samples(servicer.tree, motion)
    mass = servicer.mass + skewed_target.mass
    p_WTcm = samples.motion.p_WC + samples.motion.R_WC @ skewed_target.p_CTcm_C
    p_WScm = (servicer.mass * samples.p_WKcm + skewed_target.mass * p_WTcm) / mass
    theta = family.parameterization(servicer.mass).from_parameters(skewed_target.to_vector())
    for k in range(5):
        known = TotalMomentum(L[k] - np.cross(p_WScm[k], P[k]), P[k] / mass)
        rows = momentum_rows(servicer.tree, motion.select([k]), family, known)
        np.testing.assert_allclose(rows[:, :-1] @ theta, rows[:, -1], atol=1e-9)


@pytest.mark.parametrize("family", [STANDARD_ROWS, RELATIVE_ROWS], ids=["standard", "relative"])
def test_samples_at_rest_are_not_counted(servicer, skewed_target, zero_momentum_motion, family):
    """Rows of zeros would make the residuals look smaller than they are."""
    motion = zero_momentum_motion(skewed_target, 6, 2)
    zero = {name: 0 * getattr(motion, name) for name in ("w_WB", "v_WB", "qdot")}
    still = replace(motion, **zero)
    counts = []
    for each in (motion, still):
        rows = LogRows(servicer.tree, family, TotalMomentum.zero())
        rows.add(each, np.zeros((1, 1, 1)))
        counts.append(rows.row_count)
    assert counts == [6 * family.rows_per_sample, 0]


def test_changes_of_a_motion_are_in_the_frames_of_its_sensors(servicer, random_motion):
    """Of attitude and rate in B, as a tracker and a gyro err; of position and velocity in W."""
    motion, J = random_motion(4, 3), len(servicer.joint_names)
    changes = np.random.default_rng(1).normal(size=(4, 12 + 2 * J))
    found = changed_motion(motion, changes)
    R_BA = np.swapaxes(motion.R_WB, 1, 2) @ found.R_WB
    turn = Rotation.from_rotvec(changes[:, :3]).as_matrix()
    np.testing.assert_allclose(R_BA, turn, atol=1e-12)
    rates = [np.einsum("nji,nj->ni", each.R_WB, each.w_WB) for each in (motion, found)]
    np.testing.assert_allclose(rates[1], rates[0] + changes[:, 3:6], atol=1e-12)
    np.testing.assert_allclose(found.p_WB - motion.p_WB, changes[:, 6:9], atol=1e-12)
    np.testing.assert_allclose(found.v_WB - motion.v_WB, changes[:, 9:12], atol=1e-12)


def test_all_rows_of_a_long_log_count(servicer, zero_momentum_motion, skewed_target):
    """More samples than are made rows of at once: every one leaves its degrees of freedom."""
    found = identify(servicer, zero_momentum_motion(skewed_target, 2500, 3), rows="standard")
    assert found.solution.row_count == 6 * 2500


@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_no_rigid_body_is_nearer_than_the_consistent_one(
    servicer, zero_momentum_motion, paper_target, rows
):
    """The distance is that of the covariance of what is reported, to first order."""
    samples = zero_momentum_motion(paper_target, 12, 7).rounded(4)
    found = identify(servicer, samples, rows=rows)
    assert found.raw().inconsistencies()
    information = np.linalg.inv(found.covariance)

    def distance(vector) -> float:
        error = vector - found.parameters
        return error @ information @ error

    nearest = found.consistent.to_vector()
    sigma = np.sqrt(np.diag(found.covariance))
    rng = np.random.default_rng(1)
    for size in (0.01, 0.1, 1.0):
        for _ in range(10):
            other = nearest + size * sigma * rng.normal(size=10)
            body = InertialParameters.from_vector(other).nearest_consistent()
            assert distance(body.to_vector()) > 0.98 * distance(nearest)
