"""Rotations and cross products, batched over samples.

Rotation vectors r = angle · axis [rad] and quaternions (w, x, y, z) denote rotations R. The package
takes all other operations from `scipy.spatial.transform.Rotation`.
"""

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array


def rotate(R: ArrayLike, vectors: ArrayLike) -> Array:
    """Return R @ v for (..., 3, 3) rotations and (..., 3) vectors, broadcast."""
    return np.asarray(np.einsum("...ij,...j->...i", np.asarray(R), np.asarray(vectors)))


def cross(a: Array, b: Array) -> Array:
    """Return a × b of (..., 3) vectors, broadcast; several times as fast as `numpy.cross`."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    first = a1 * b2 - a2 * b1
    result = np.empty((*first.shape, 3), first.dtype)
    result[..., 0], result[..., 1], result[..., 2] = first, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return result


def inverses(tensors: Array) -> Array:
    """Return the inverses of symmetric (..., 3, 3) tensors, several times as fast as NumPy."""
    a, b, c = np.moveaxis(tensors, -1, 0)
    rows = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=-2)
    return np.asarray(rows / np.sum(a * rows[..., 0, :], axis=-1)[..., None, None])


def product(R: Array, constant: Array) -> Array:
    """Return R @ constant of (N, 3, 3) rotations and one (3, ...) array, as one large product."""
    return (R.reshape(-1, 3) @ constant).reshape(len(R), 3, *constant.shape[1:])


# Row k is the matrix of e_k ×, flattened: column j of that matrix is e_k × e_j.
_SKEW = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2).reshape(3, 9)


def skew(v: ArrayLike) -> Array:
    """Return ṽ (..., 3, 3) with ṽ u = v × u, for vectors v (..., 3).

    Source: Ning et al. 2016, Eq. 8.
    """
    v = np.asarray(v)
    return (v @ _SKEW).reshape(*v.shape, 3)


def rotate_about_axis(R: ArrayLike, axis: ArrayLike, angle: ArrayLike) -> Array:
    """Return R exp(axis · angle) (N, 3, 3) for attitudes R, one unit axis (3,) and angles (N,).

    The axis is expressed in the frame that R rotates from. Source: Rodrigues' formula.
    """
    K = skew(axis)
    R, angle = np.asarray(R), np.asarray(angle)[:, None, None]
    by_sine, by_cosine = product(R, K), product(R, K @ K)
    by_sine *= np.sin(angle)
    by_cosine *= 1 - np.cos(angle)
    by_sine += by_cosine
    by_sine += R
    return by_sine


def exponentials(r: Array) -> Array:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3): Rodrigues' formula."""
    K, half = skew(r), np.sqrt(np.sum(r * r, axis=-1))[..., None, None] / 2
    ratio = np.sinc(half / np.pi)
    return np.asarray(np.eye(3) + ratio * np.cos(half) * K + ratio**2 / 2 * (K @ K))


def sines(R: Array) -> Array:
    """Return the axes times the sines of the angles (..., 3) of rotations (..., 3, 3)."""
    odd = (R - np.swapaxes(R, -1, -2)) / 2
    return np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1)


def right_jacobian(r: ArrayLike) -> Array:
    """Return Jr (..., 3, 3) with exp(r + dr) = exp(r) exp(Jr dr) for vectors r (..., 3).

    Source: Solà et al. 2018, "A micro Lie theory for state estimation in robotics", Eq. 143.
    """
    r = np.asarray(r, dtype=float)
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    K = skew(r)
    return np.asarray(np.eye(3) - a * K + b * K @ K)


def conjugate(quaternion: Array) -> Array:
    """Return the conjugates (..., 4) of quaternions, scalar first: the inverse rotations."""
    return np.asarray(quaternion * np.array([1.0, -1.0, -1.0, -1.0]))


def rotate_by_quaternion(quaternion: Array, v: Array) -> Array:
    """Return R v (..., 3) for quaternions (..., 4) of any norm but zero and vectors (..., 3)."""
    w, u = quaternion[..., :1], quaternion[..., 1:]
    scale = 2 / np.einsum("...i,...i->...", quaternion, quaternion)[..., None]
    u_cross_v = cross(u, v)
    return np.asarray(v + scale * (w * u_cross_v + cross(u, u_cross_v)))


def angular_velocity(quaternion: Array, rate: Array) -> Array:
    """Return ω (..., 3) in the body frame of quaternions of any norm and their rates (..., 4)."""
    w, x, dw, dx = quaternion[..., :1], quaternion[..., 1:], rate[..., :1], rate[..., 1:]
    square = np.sum(quaternion**2, axis=-1, keepdims=True)
    return np.asarray(2 * (w * dx - dw * x - cross(x, dx)) / square)


def quaternion_rate(quaternion: Array, w_B: Array) -> Array:
    """Return q̇ = ½ q ∘ (0, ω) (..., 4) for angular velocities ω in the body frame [rad/s]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    a, b, c = (w_B[..., i] for i in range(3))
    rate = [-(x * a + y * b + z * c), w * a + y * c - z * b]
    rate += [w * b + z * a - x * c, w * c + x * b - y * a]
    return np.stack(rate, axis=-1) / 2
