"""Joint motion in one block of time: quintic splines that continue from block to block.

The coefficients of a block's spline are its derivatives at both ends, and B-spline coefficients
between them. The derivatives at a boundary, s = h^d/d! q^(d) with d < `ORDER`, are the same numbers
in both blocks, so an encoder's error at the boundary is one and the same error in both.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from cpid_drake.array import Array
from cpid_drake.estimation.likelihood.uniform_spline import GAUSS_LEGENDRE

ORDER = 3
"""Number of derivatives of the joint motion, from the zeroth, that are continuous at a boundary."""

TIME_SCALE = 0.1
"""The time h that makes derivatives of different order comparable [s]."""

DEGREE = 5
"""Degree of the splines."""


@dataclass(frozen=True, eq=False)
class JointPart:
    """The joints' motion in one block, and the rows of their own sensors.

    Attributes:
        start, end: [s].
        pieces: number of polynomials.
        coefficients: (K, J) present values c; the first and the last `ORDER` are the scaled
            derivatives at both ends.
        rows, target: (J, K, K), (J, K) with rows c = target and unit noise: samples and jerk.

    """

    start: float
    end: float
    pieces: int
    coefficients: Array
    rows: Array
    target: Array

    @property
    def size(self) -> int:
        """Number of coefficients K of each joint."""
        return len(self.coefficients)

    @property
    def rest(self) -> Array:
        """(J, K) right-hand side of the rows for errors of the present coefficients."""
        return np.asarray(self.target - np.einsum("jrk,kj->jr", self.rows, self.coefficients))

    def basis(self, times: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives (M, K) of a joint's position (or rate, …) w.r.t. coefficients."""
        return spline_basis(self.start, self.end, self.pieces, np.asarray(times), derivative)

    @property
    def sites(self) -> tuple[Array, Array]:
        """K times [s], and (K, K) that makes coefficients of positions at these times."""
        since_start, to_coefficients = _sites(round(self.end - self.start, 9), self.pieces)
        return self.start + since_start, to_coefficients

    def evaluate(self, times: Array) -> Array:
        """Return positions and rates (M, 2, J) at times (M,)."""
        return np.stack([self.basis(times, d) @ self.coefficients for d in range(2)], axis=1)

    def about(self, coefficients: Array) -> "JointPart":
        """Return the part about other coefficients (K, J)."""
        return replace(self, coefficients=coefficients)

    def moved(self, step: Array) -> "JointPart":
        """Return the part after a step (J K,) of all coefficients, joint after joint."""
        c = self.coefficients
        return self.about(c + step.reshape(c.T.shape).T)


def spline_basis(start: float, end: float, pieces: int, times: Array, derivative: int) -> Array:
    """Return the derivatives (M, K) of a joint's position (or rate, …) by a block's coefficients.

    Args:
        start, end: of the block [s].
        pieces: number of polynomials.
        times: (M,) [s].
        derivative: 0 for positions, 1 for rates, …

    """
    at = np.round(times - start, 12)
    return _basis(round(end - start, 9), pieces, at.tobytes(), derivative)


@lru_cache(maxsize=1024)
def _basis(length: float, pieces: int, times: bytes, derivative: int) -> Array:
    """Return the basis at times since the start: the same in every sweep, and in many blocks."""
    return np.asarray(_functions(length, pieces)(np.frombuffer(times), nu=derivative))


@lru_cache(maxsize=64)
def jerk_rows(length: float, pieces: int) -> Array:
    """Return P (3 pieces, K): |P c|² is the integral of the squared jerk over a block."""
    edges = np.linspace(0.0, length, pieces + 1)
    x, weights = GAUSS_LEGENDRE  # exact for the square of a quadratic
    half = length / pieces / 2
    at = ((edges[:-1] + edges[1:])[:, None] / 2 + half * x).ravel()
    basis = _functions(length, pieces)(at, nu=ORDER)
    return np.asarray(np.sqrt(np.tile(weights * half, pieces))[:, None] * basis)


@lru_cache(maxsize=64)
def edge_coordinates(length: float, pieces: int) -> Array:
    """Return T (K, K) with c = T (z, v, x) and the squared jerk |P c|² = |z|² + |v|².

    x (3,) is s at the end of the block, v (3,) determines s at its start together with x, and
    z (K − 6,) leaves s at both ends as it is.
    """
    P = jerk_rows(length, pieces)
    K = P.shape[1]
    T = np.zeros((K, K))
    # A parabola x has no jerk: P c = Q R c' + P' x = 0 for the coefficients c' before x.
    Q, R = np.linalg.qr(P[:, :-ORDER])
    T[:-ORDER, -ORDER:] = -np.linalg.solve(R, Q.T @ P[:, -ORDER:])
    T[-ORDER:, -ORDER:] = np.eye(ORDER)
    # c' = R⁻¹ w has the jerk |w|²; the first three of an orthonormal base of w move the start.
    inverse = np.linalg.inv(R)
    base = np.linalg.qr(inverse[:ORDER].T, mode="complete")[0]
    T[:-ORDER, :-ORDER] = inverse @ np.roll(base, -ORDER, axis=1)
    T[:ORDER, : -2 * ORDER] = 0.0
    return T


@lru_cache(maxsize=64)
def _sites(length: float, pieces: int) -> tuple[Array, Array]:
    """Return the same of a block that starts at zero: at the means of each B-spline's knots."""
    basis = _functions(length, pieces)
    times = sliding_window_view(basis.t[1:-1], DEGREE).mean(axis=1)
    return times, np.linalg.inv(basis(times))


@lru_cache(maxsize=64)
def _functions(length: float, pieces: int) -> BSpline:
    """Return the basis functions of a block that starts at zero.

    The first and the last `ORDER` B-splines are combined so that their coefficients are s.
    """
    inner = np.linspace(0.0, length, pieces + 1)
    knots = np.concatenate([DEGREE * [0.0], inner, DEGREE * [length]])
    K = pieces + DEGREE
    plain = BSpline(knots, np.eye(K), DEGREE)
    factor = np.cumprod(np.concatenate([[1.0], TIME_SCALE / np.arange(1, ORDER)]))
    to_s = np.eye(K)
    to_s[:ORDER] = [factor[d] * plain(0.0, nu=d) for d in range(ORDER)]
    to_s[-ORDER:] = [factor[d] * plain(length, nu=d) for d in range(ORDER)]
    return BSpline(knots, np.linalg.inv(to_s), DEGREE)
