"""Signs, frames and terms, each by hand: a base, and an arm of one metre that turns about z.

The base is at W's origin and has its centre of mass there. The arm's joint is at (1, 0, 0); the
arm's centre of mass is 0.5 m along its x axis, and C is at its end, parallel to the arm.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import (
    InertialParameters,
    Motion,
    Spacecraft,
    TotalMomentum,
    identify,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import CaptureMotion, forward_kinematics
from cpid_drake.dynamics.momentum import momentum_samples, target_momentum
from cpid_drake.dynamics.parameterizations import (
    EQ18,
    relative_parameterization,
    tensor_to_vector,
)
from cpid_drake.sensors.sensors import SENSORS

X, Y, Z = np.eye(3)
BASE_MASS, ARM_MASS, ARM_IZZ, BASE_IZZ = 10.0, 2.0, 0.3, 4.0
TARGET = InertialParameters(5.0, [0.2, 0.1, -0.3], [[2, 0.1, 0.2], [0.1, 3, 0.3], [0.2, 0.3, 4]])


def arm_craft(folder, kind="revolute", axis="0 0 1", rpy="0 0 0") -> Spacecraft:
    def link(name, mass, x, izz):
        return (
            f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia '
            f'ixx="{izz}" iyy="{izz}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    parts = [
        link("base", BASE_MASS, 0, BASE_IZZ),
        link("arm", ARM_MASS, 0.5, ARM_IZZ),
        '<link name="tip"/>',
        f'<joint name="j" type="{kind}"><parent link="base"/><child link="arm"/>'
        f'<origin xyz="1 0 0" rpy="{rpy}"/><axis xyz="{axis}"/>'
        '<limit lower="-9" upper="9" effort="9" velocity="9"/></joint>',
        '<joint name="f" type="fixed"><parent link="arm"/><child link="tip"/>'
        '<origin xyz="1 0 0"/></joint>',
    ]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    return Spacecraft(path, base="base", capture_frame="tip")


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return arm_craft(tmp_path_factory.mktemp("craft"))


def seen(*, q=0.0, qdot=0.0, R_WB=None, p_WB=(0, 0, 0), w_WB=(0, 0, 0), v_WB=(0, 0, 0)):
    """Return the telemetry of one instant."""
    R_WB = Rotation.identity() if R_WB is None else R_WB
    quaternion = R_WB.as_quat(scalar_first=True)[None]
    vectors = (np.array([each], dtype=float) for each in (p_WB, w_WB, v_WB))
    return Motion(("j",), [0.0], quaternion, *vectors, [[q]], [[qdot]])


QUARTER = Rotation.from_rotvec(np.pi / 2 * Z)


# -- kinematics: Eqs. 1-3 --------------------------------------------------------------------------


def test_a_positive_rate_turns_the_arm_from_x_to_y(craft):
    _, capture = forward_kinematics(craft.tree, **seen(qdot=0.4).states)
    np.testing.assert_allclose(capture.p_WC[0], 2 * X)
    np.testing.assert_allclose(capture.w_WC[0], 0.4 * Z)
    np.testing.assert_allclose(capture.v_WC[0], 0.4 * Y)
    _, capture = forward_kinematics(craft.tree, **seen(q=np.pi / 2).states)
    np.testing.assert_allclose(capture.p_WC[0], X + Y)
    np.testing.assert_allclose(capture.R_WC[0] @ X, Y, atol=1e-15)


def test_velocities_of_the_base_are_those_of_its_origin_in_W(craft):
    """v_C = v_B + ω × (p_C − p_B)."""
    _, capture = forward_kinematics(
        craft.tree, **seen(R_WB=QUARTER, p_WB=3 * Z, w_WB=0.5 * X, v_WB=2 * Y).states
    )
    np.testing.assert_allclose(capture.p_WC[0], [0, 2, 3], atol=1e-15)
    np.testing.assert_allclose(capture.v_WC[0], [0, 2, 1.0], atol=1e-15)  # 0.5 X × 2 Y = Z


# -- momentum: Eqs. 4-9 ----------------------------------------------------------------------------


def test_the_known_momentum_is_about_C(craft):
    """A base that moves along y at 2 m from C, and an arm that is carried along."""
    samples = momentum_samples(craft.tree, seen(v_WB=0.5 * Y))
    np.testing.assert_allclose(samples.P[0], 0.5 * 12 * Y)
    # Σ (r − p_C) × m v = (−2 X) × 5 Y + (−0.5 X) × 1 Y
    np.testing.assert_allclose(samples.L[0], (-10.0 - 0.5) * Z)


def test_the_targets_momentum_has_all_its_terms():
    """P = m (v + ω × c), L about C = m c × v + (I + m (|c|² 1 − c cᵀ)) ω, c turned into W."""
    w, v, R = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -1.0]), QUARTER.as_matrix()
    P, L = target_momentum(TARGET, CaptureMotion(R[None], np.zeros((1, 3)), w[None], v[None]))
    m, c, inertia = TARGET.mass, R @ TARGET.p_CTcm_C, R @ TARGET.I_TTcm_C @ R.T
    np.testing.assert_allclose(P[0], m * (v + np.cross(w, c)))
    J = inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(L[0], m * np.cross(c, v) + J @ w)


def test_a_known_momentum_about_the_origin_is_less_about_the_centre_of_mass(craft):
    """L about Scm = L about Wo − p × P, v = P / m: the arm is at 1.5 X, the target at 2 X + c."""
    known = TotalMomentum.with_base_at_origin(craft.tree, TARGET, [0.0], [0, 0, 5.0, 0, 2.0, 0])
    mass = BASE_MASS + ARM_MASS + TARGET.mass
    p = (ARM_MASS * 1.5 * X + TARGET.mass * (2 * X + TARGET.p_CTcm_C)) / mass
    np.testing.assert_allclose(known.L_WScm_W, 5.0 * Z - np.cross(p, 2 * Y), atol=1e-15)
    np.testing.assert_allclose(known.v_WScm_W, 2 / mass * Y)


def test_the_base_turns_and_moves_against_the_arm(craft):
    """At rest in sum: by hand, from the two bodies' motion about their common centre of mass."""
    known = BodyDynamics.at(craft.tree, np.zeros((1, 1)), np.array([[0.4]]))
    w_B, v_B = known.base_twist(np.zeros(10))
    mu, d = BASE_MASS * ARM_MASS / 12, 1.5  # reduced mass, distance of the centres of mass
    w = -0.4 * (ARM_IZZ + mu * d * 0.5) / (BASE_IZZ + ARM_IZZ + mu * d**2)
    np.testing.assert_allclose(w_B[0], w * Z, atol=1e-15)
    np.testing.assert_allclose(v_B[0], -ARM_MASS * (w * d + 0.4 * 0.5) / 12 * Y, atol=1e-15)


def test_a_momentum_moves_the_base_along_it_and_turns_it(craft):
    """From L = 1.5 y about the centre of mass, which moves at 0.5 z."""
    known = BodyDynamics.at(craft.tree, np.zeros((1, 1)), np.zeros((1, 1)))
    w_B, v_B = known.base_twist(np.zeros(10), 1.5 * Y, 0.5 * Z)
    w = 1.5 / (BASE_IZZ + ARM_IZZ + BASE_MASS * ARM_MASS / 12 * 1.5**2)
    np.testing.assert_allclose(w_B[0], w * Y, atol=1e-15)
    np.testing.assert_allclose(v_B[0], (0.5 + 0.25 * w) * Z, atol=1e-15)  # v_cm − ω × 0.25 x


# -- unknowns --------------------------------------------------------------------------------------


def test_the_standard_vector_is_about_C_and_the_parameters_about_the_centre_of_mass():
    phi, (x, y, z) = TARGET.to_standard_vector(), TARGET.p_CTcm_C
    np.testing.assert_allclose(phi[:4], [5.0, 1.0, 0.5, -1.5])
    xx, yy, zz = y * y + z * z, x * x + z * z, x * x + y * y
    shift = np.array([[xx, -x * y, -x * z], [-x * y, yy, -y * z], [-x * z, -y * z, zz]])
    J = TARGET.I_TTcm_C + 5.0 * shift
    np.testing.assert_allclose(phi[4:], tensor_to_vector(J))


def test_eq18_has_the_inverse_mass_and_the_inertia_about_the_centre_of_mass():
    theta = EQ18.from_parameters(TARGET.to_vector())
    np.testing.assert_allclose(theta, [0.2, *TARGET.p_CTcm_C, *tensor_to_vector(TARGET.I_TTcm_C)])


def test_the_relative_unknowns_have_the_reduced_mass():
    """μ = m_k m / (m_k + m), I_* = I + μ (|c|² 1 − c cᵀ)."""
    psi, c = relative_parameterization(20.0).from_parameters(TARGET.to_vector()), TARGET.p_CTcm_C
    assert psi[0] == pytest.approx(4.0)
    np.testing.assert_allclose(psi[1:4], 4.0 * c)
    expected = TARGET.I_TTcm_C + 4.0 * (c @ c * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(psi[4:], tensor_to_vector(expected))


def test_products_of_inertia_are_those_of_the_tensor():
    """Ixy is the entry of the matrix, as in URDF and Drake, and not its negative."""
    np.testing.assert_array_equal(TARGET.to_vector()[7:], [0.1, 0.2, 0.3])
    M = TARGET.to_spatial_inertia()
    np.testing.assert_allclose(M.get_com(), TARGET.p_CTcm_C)
    about_cm = M.Shift(M.get_com()).CalcRotationalInertia().get_products()
    np.testing.assert_allclose(about_cm, [0.1, 0.2, 0.3], atol=1e-14)


# -- sensors ---------------------------------------------------------------------------------------


def test_a_gyro_shows_the_angular_velocity_in_B_and_a_velocity_sensor_in_W():
    telemetry = seen(R_WB=QUARTER, w_WB=0.3 * Y, v_WB=0.2 * X, p_WB=Z)
    np.testing.assert_allclose(SENSORS["gyro"].ideal(telemetry)[0], 0.3 * X, atol=1e-15)
    np.testing.assert_allclose(SENSORS["velocity"].ideal(telemetry)[0], 0.2 * X)
    np.testing.assert_allclose(SENSORS["position"].ideal(telemetry)[0], Z)


def test_a_quaternion_is_scalar_first_and_takes_B_to_W():
    telemetry = seen(R_WB=QUARTER)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(telemetry.quaternion_WB[0], [half, 0, 0, half])
    np.testing.assert_allclose(telemetry.R_WB[0] @ X, Y, atol=1e-15)
    np.testing.assert_allclose(SENSORS["attitude"].ideal(telemetry)[0], [half, 0, 0, half])


# -- forces ----------------------------------------------------------------------------------------


# -- the whole way ---------------------------------------------------------------------------------


def test_the_estimate_is_that_of_the_target_and_of_no_mirror_image(
    servicer, zero_momentum_motion, skewed_target
):
    """Of rows in which every sign matters; with the rates turned round it is the same target."""
    telemetry = zero_momentum_motion(skewed_target, 12, 6)
    names = ("w_WB", "v_WB", "qdot")
    backwards = replace(telemetry, **{n: -getattr(telemetry, n) for n in names})
    for motion in (telemetry, backwards):
        found = identify(servicer, motion).parameters
        np.testing.assert_allclose(found, skewed_target.to_vector(), atol=1e-8)
    for name in names:
        wrong = replace(telemetry, **{name: -getattr(telemetry, name)})
        found = identify(servicer, wrong)
        assert np.nanmax(np.abs(found.parameters - skewed_target.to_vector())) > 1.0
