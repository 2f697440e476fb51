"""Rotations and cross products, batched over samples."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def rotate(R: ArrayLike, vectors: ArrayLike) -> NDArray[np.float64]:
    """Return R @ v for (..., 3, 3) rotations and (..., 3) vectors, broadcast."""
    return np.einsum("...ij,...j->...i", R, vectors)


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a × b of (..., 3) vectors, broadcast; several times as fast as `numpy.cross`."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def product(R: NDArray[np.float64], constant: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R @ constant of (N, 3, 3) rotations and one (3, ...) array, as one large product."""
    return (R.reshape(-1, 3) @ constant).reshape(len(R), 3, *constant.shape[1:])


def rotate_about_axis(R: ArrayLike, axis: ArrayLike, angle: ArrayLike) -> NDArray[np.float64]:
    """Return R (N, 3, 3) times rotations by angles (N,) [rad] about one unit axis (3,).

    The axis is expressed in the frame on R's right-hand side. Source: Rodrigues' formula.
    """
    x, y, z = np.asarray(axis, dtype=float)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R, angle = np.asarray(R, dtype=float), np.asarray(angle, dtype=float)[:, None, None]
    by_sine, by_cosine = product(R, K), product(R, K @ K)
    by_sine *= np.sin(angle)
    by_cosine *= 1 - np.cos(angle)
    by_sine += by_cosine
    by_sine += R
    return by_sine


def linear_form(columns: int, entries: dict[tuple[int, int], tuple[int, float]]) -> NDArray:
    """Return the matrix (3, 3 columns) that makes v the matrix with these entries ±v_k."""
    form = np.zeros((3, 3, columns))
    for (row, column), (k, sign) in entries.items():
        form[k, row, column] = sign
    return form.reshape(3, -1)


_SKEW = linear_form(
    3,
    {
        (0, 1): (2, -1.0),
        (0, 2): (1, 1.0),
        (1, 2): (0, -1.0),
        (1, 0): (2, 1.0),
        (2, 0): (1, -1.0),
        (2, 1): (0, 1.0),
    },
)


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """Return ṽ (..., 3, 3) with ṽ u = v × u (Ning et al. 2016, Eq. 8)."""
    v = np.asarray(v, dtype=float)
    return (v @ _SKEW).reshape(*v.shape, 3)
