"""Rotations: every function agrees with SciPy's `Rotation`, or with a derivative of it."""

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import (
    angular_velocity,
    cross,
    exponentials,
    product,
    quaternion_rate,
    right_jacobian,
    rotate_about_axis,
    rotate_by_quaternion,
    skew,
)


def test_cross_products_agree_with_numpy():
    a, b = np.random.default_rng(90).normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=0, atol=1e-15)
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


def test_a_product_with_a_constant_is_the_product_of_each_sample():
    rng = np.random.default_rng(91)
    R, constant = Rotation.random(4, rng).as_matrix(), rng.normal(size=(3, 5))
    np.testing.assert_allclose(product(R, constant), R @ constant, rtol=0, atol=1e-15)


def test_exponentials_agree_with_scipy():
    sizes = np.array([0.0, 1e-9, 9e-4, 1.1e-3, 0.1, 0.5, 3.0, 3.14])
    turns = sizes[:, None] * [0.6, -0.48, 0.64]
    found = exponentials(turns)
    np.testing.assert_allclose(found, Rotation.from_rotvec(turns).as_matrix(), atol=1e-15)


def test_quaternions_of_any_norm_rotate_as_scipys():
    rng = np.random.default_rng(92)
    quaternions = rng.uniform(0.5, 2.0, (6, 1)) * Rotation.random(6, rng).as_quat()
    vectors = rng.normal(size=(6, 3))
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    found = rotate_by_quaternion(quaternions, vectors)
    np.testing.assert_allclose(found, rotations.apply(vectors), rtol=0, atol=1e-14)


def test_quaternion_rate_is_the_derivative_of_a_turn_about_body_axes():
    rng, h = np.random.default_rng(93), 1e-6
    start, w_B = Rotation.random(5, rng), rng.normal(size=(5, 3))
    quaternion = start.as_quat(scalar_first=True)
    after = (start * Rotation.from_rotvec(h * w_B)).as_quat(scalar_first=True)
    after *= np.sign(np.sum(after * quaternion, axis=1, keepdims=True))
    rate = quaternion_rate(quaternion, w_B)
    np.testing.assert_allclose(rate, (after - quaternion) / h, rtol=0, atol=1e-5)
    np.testing.assert_allclose(angular_velocity(3 * quaternion, 3 * rate), w_B, atol=1e-14)


def test_a_turn_about_an_axis_is_in_the_frame_that_is_rotated_from():
    rng = np.random.default_rng(45)
    axis, angles = np.array([0.6, 0.0, 0.8]), rng.uniform(-4.0, 4.0, 10)
    start = Rotation.random(10, rng)
    expected = (start * Rotation.from_rotvec(angles[:, None] * axis)).as_matrix()
    found = rotate_about_axis(start.as_matrix(), axis, angles)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_right_jacobian_is_the_derivative_of_the_exponential():
    rng = np.random.default_rng(93)
    r = np.vstack([rng.normal(size=(20, 3)), 1e-5 * rng.normal(size=(3, 3)), np.zeros((1, 3))])
    J, h = right_jacobian(r), 1e-5
    for k, unit in enumerate(np.eye(3)):
        ahead, behind = (Rotation.from_rotvec(r + s * unit) for s in (h, -h))
        turn = (behind.inv() * ahead).as_rotvec() / (2 * h)
        np.testing.assert_allclose(J[:, :, k], turn, rtol=0, atol=1e-9)
