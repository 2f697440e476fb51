"""Least squares on rows A x = b with errors inside A: weights, and rows without bias.

If A has errors δA, AᵀA contains E[δAᵀ δA] as well, which looks like information, and least squares
has the bias −(AᵀA)⁻¹ E[δAᵀ (δA x − δb)]. Source: Fuller 1987, Measurement Error Models, ch. 1, 2.
"""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import DEFAULT_RANK_TOLERANCE, triangle

LEAST_SHARE = 1e-9
"""Combinations of the rows of a sample have at least this share of their variance."""

_NOISE = 0.25  # share of the information about a combination that may be noise
_ROUNDS = 4  # of weights, which depend on the solution


def without_bias(
    rows: NDArray[np.float64],
    E: NDArray[np.float64],
    scatter: NDArray[np.float64] | None = None,
    least: float = 1.0,
) -> tuple[NDArray[np.float64], int]:
    """Return rows (r, c + 1) with independent errors of unit size and without bias.

    The second result is the number of unknowns that the rows determine.

    Args:
        rows: (n, c + 1) rows [A | b] with errors of unit size.
        E: (c + 1, c + 1) expectation of δᵀ δ for their errors δ.
        scatter: (c, c) covariance of Aᵀ (A x − b); None for AᵀA.
        least: least size of the scatter, as a share of AᵀA.

    """
    A, b = rows[:, :-1], rows[:, -1]
    norms = np.linalg.norm(A, axis=0)
    # A column that is zero up to rounding must not be scaled to unit length.
    largest = norms.max(initial=0.0) or 1.0
    scale = np.where(norms > 1e-12 * largest, norms, largest)
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    seen = (s > DEFAULT_RANK_TOLERANCE * s[0]) & (s[0] > 0)
    U, s, Vt = U[:, seen], s[seen], Vt[seen]
    y, X = U.T @ b, (Vt / s[:, None] / scale).T  # x = X y
    shares, Q = np.linalg.eigh(X.T @ E[:-1, :-1] @ X)
    axes = Q.T[shares < _NOISE]
    # The errors of y are independent and of unit size, or as large as the scatter.
    whiten = axes
    if scatter is not None:
        sizes, turn = np.linalg.eigh(axes @ X.T @ scatter @ X @ axes.T)
        whiten = turn.T @ axes / np.sqrt(np.maximum(sizes, least))[:, None]
    left = whiten - whiten @ X.T @ E[:-1, :-1] @ X
    right = whiten @ (y - X.T @ E[:-1, -1])
    # The bias, times an unknown of unit σ, is eliminated.
    table = np.zeros((len(left) + 1, A.shape[1] + 2))
    table[0, 0] = 1.0
    table[1:, 0], table[1:, -1] = right - left @ y, right
    table[1:, 1:-1] = left @ (s[:, None] * Vt * scale)
    return triangle(table)[1 : len(table), 1:], int(seen.sum())


def expected_square(
    derivatives: NDArray[np.float64], C: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the expectation of δᵀ δ for rows δ (q, N, m, c) per error, and errors C (N, q, q)."""
    by_sample = np.moveaxis(derivatives, 0, 1)
    flat = by_sample.reshape(*by_sample.shape[:2], -1)
    size = derivatives.shape[-1]
    return np.asarray(flat.reshape(-1, size).T @ (C @ flat).reshape(-1, size))


def row_weights(
    rows: NDArray[np.float64], derivatives: NDArray[np.float64], C: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a solution (c,), and weights (N, m, m).

    The weights make the errors of a sample at the solution independent and of unit size.

    Args:
        rows: (N, m, c + 1).
        derivatives: (q, N, m, c + 1).
        C: (N, q, q) covariance of the errors of the samples.

    """
    m, size = rows.shape[1:]
    weights = np.eye(m)[None]
    for _ in range(_ROUNDS):
        flat = (weights @ rows).reshape(-1, size)
        x = Gaussian.of_rows({"x": size - 1}, flat).solve()
        effects = np.moveaxis(derivatives @ np.append(x, -1.0), 0, -1)
        S = effects @ C @ np.swapaxes(effects, -1, -2)
        trace = np.trace(S, axis1=1, axis2=2)[:, None, None]
        S += (LEAST_SHARE * trace / m + 1e-300) * np.eye(m)
        weights = np.linalg.inv(np.linalg.cholesky(S))
    return x, np.asarray(weights)
