"""What nothing depends on: the axes of W, the zero of the clock, the frames of the spacecraft."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, small_craft, true_telemetry

from cpid_drake import InertialParameters, Spacecraft, TotalMomentum, identify
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.rows import RELATIVE_ROWS, ROW_FAMILIES
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise

FAMILIES = pytest.mark.parametrize("family", ROW_FAMILIES.values(), ids=ROW_FAMILIES)


@FAMILIES
def test_rows_do_not_depend_on_the_world_frame(servicer, random_motion, family):
    """Turning and shifting the world leaves every row as it is: they are expressed in C."""
    telemetry, Q = random_motion(6, seed=6), Rotation.from_rotvec([0.3, 1.2, -0.5])
    attitude = Rotation.from_quat(telemetry.quaternion_WB, scalar_first=True)
    moved = replace(
        telemetry,
        quaternion_WB=(Q * attitude).as_quat(scalar_first=True),
        p_WB=Q.apply(telemetry.p_WB) + [5.0, -3.0, 2.0],
        w_WB=Q.apply(telemetry.w_WB),
        v_WB=Q.apply(telemetry.v_WB),
    )
    for ours, theirs in zip(
        family.rows(momentum_samples(servicer.tree, telemetry)),
        family.rows(momentum_samples(servicer.tree, moved)),
        strict=True,
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)


def test_relative_rows_do_not_see_the_bases_position_and_velocity(servicer, random_motion):
    telemetry = random_motion(6, seed=21)
    rng = np.random.default_rng(22)
    moved = replace(
        telemetry,
        p_WB=telemetry.p_WB + rng.normal(size=(6, 3)),
        v_WB=telemetry.v_WB + rng.normal(size=(6, 3)),
    )
    for ours, theirs in zip(
        RELATIVE_ROWS.rows(momentum_samples(servicer.tree, telemetry)),
        RELATIVE_ROWS.rows(momentum_samples(servicer.tree, moved)),
        strict=True,
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


# -- the fits --------------------------------------------------------------------------------------

FITS = pytest.mark.parametrize("estimator", ["trajectory_fit", "recursive_fit", "standard"])
SUITE = coarse_suite()
TURN = Rotation.from_rotvec([1.4, -1.1, 0.8])
SHIFT = 256.0
"""Added to every stamp [s]; a power of two, so that stamps keep nearly all their digits."""


@pytest.fixture(scope="module")
def found(craft, skewed_target):
    """Return a function (estimator, change) -> what is identified from a changed log."""
    motion = Sines.drawn(4, seed=101, duration=5.0, size=0.6)
    ideal = measured(craft, motion, skewed_target, SUITE, MOMENTUM)
    samples, known = add_noise(SUITE, ideal, seed=2), {}

    def make(estimator, change=None):
        options = {"estimator": estimator, "momentum": TotalMomentum.unknown()}
        if estimator not in known:
            known[estimator] = identify(craft, samples, sensors=SUITE, **options)
        if change is None:
            return known[estimator]
        return identify(craft, samples.updated(change(samples)), sensors=SUITE, **options)

    return make


def turned(samples):
    """Seen from a world that is turned."""
    attitude = TURN * Rotation.from_quat(samples.attitude.value, scalar_first=True)
    return {
        "attitude": Samples(samples.attitude.time, attitude.as_quat(scalar_first=True)),
        "position": Samples(samples.position.time, TURN.apply(samples.position.value)),
    }


def later(samples):
    return {name: Samples(s.time + SHIFT, s.value) for name, s in samples.items()}


def of_other_sign(samples):
    """A quaternion and its negative are one attitude."""
    attitude = samples.attitude
    signs = np.random.default_rng(92).choice([-1.0, 1.0], (len(attitude), 1))
    return {"attitude": Samples(attitude.time, signs * attitude.value)}


@FITS
@pytest.mark.parametrize("change", [turned, later, of_other_sign])
def test_the_estimate_and_its_covariance_stay(found, estimator, change):
    first, second = found(estimator), found(estimator, change)
    sigma = np.sqrt(np.diag(first.covariance))
    assert np.isfinite(sigma).all()
    np.testing.assert_array_less(np.abs(second.parameters - first.parameters), 0.01 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(second.covariance)), sigma, rtol=0.01)


# -- frames of the spacecraft ----------------------------------------------------------------------


@pytest.mark.parametrize("rows", ROW_FAMILIES)
def test_another_capture_frame_shows_the_same_body(
    servicer, zero_momentum_motion, skewed_target, rows
):
    """The parameters in the last link's frame G are those in C, shifted and turned."""
    other = Spacecraft(servicer.model, base="bus", capture_frame="capture_arm_link6")
    plant = servicer.plant
    context, link = plant.CreateDefaultContext(), plant.GetFrameByName("capture_arm_link6")
    X_GC = servicer.capture_frame.CalcPose(context, link)
    M_TC_C = skewed_target.to_spatial_inertia()
    M_TG_G = M_TC_C.ReExpress(X_GC.rotation()).Shift(-X_GC.translation())
    expected = InertialParameters.from_spatial_inertia(M_TG_G)
    assert np.abs(expected.p_CTcm_C - skewed_target.p_CTcm_C).max() > 0.1
    found = identify(other, zero_momentum_motion(skewed_target, 12, 4), rows=rows)
    np.testing.assert_allclose(found.parameters, expected.to_vector(), rtol=0, atol=1e-8)


@pytest.mark.parametrize("rows", ["standard", "relative"])
def test_another_frame_of_the_base_shows_the_same_body(tmp_path, skewed_target, rows):
    """The base's frame is moved and turned in the file, and so is what its sensors show."""
    craft = small_craft(tmp_path)
    motion, times = Sines.drawn(4, 7, 6.0, 0.6), np.arange(0.0, 6.0, 0.2)
    truth = true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times)
    R_AB, p_AB = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.array([0.3, -0.2, 0.5])
    x, y, z = p_AB
    roll, pitch, yaw = R_AB.as_euler("xyz")
    text = craft.path.read_text().replace(
        "</robot>",
        '<link name="a"/><joint name="shift" type="fixed"><parent link="a"/><child link="base"/>'
        f'<origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/></joint></robot>',
    )
    (tmp_path / "other.urdf").write_text(text)
    other = Spacecraft(tmp_path / "other.urdf", base="a", capture_frame="hand")
    R_WA = Rotation.from_quat(truth.quaternion_WB, scalar_first=True) * R_AB.inv()
    arm = R_WA.apply(-p_AB)  # from B's origin to A's is -R_WA p_AB
    seen = replace(
        truth,
        quaternion_WB=R_WA.as_quat(scalar_first=True),
        p_WB=truth.p_WB + arm,
        v_WB=truth.v_WB + np.cross(truth.w_WB, arm),
    )
    found = identify(other, seen, rows=rows)
    np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=0, atol=1e-7)
