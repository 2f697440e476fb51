"""Recursive least squares as a square-root information filter.

Any number of rows [A | b] in n unknowns is summarized by one upper triangular matrix
(n + 1, n + 1), the R factor of their QR decomposition:

    [R  z]      R x = z    the equations compressed to n rows,
    [0  ρ]      ρ²         the residual sum of squares at their solution.

Each new sample needs one QR decomposition of this triangle with six rows below it. The method
propagates no covariance, which could lose its symmetry or definiteness. Source: Bierman 1977,
Factorization Methods for Discrete Sequential Estimation, ch. IV.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cpid_drake.estimation.least_squares import (
    DEFAULT_RANK_TOLERANCE,
    LeastSquaresSolution,
    solve_compressed,
)


def empty_information(n: int = 10) -> NDArray[np.float64]:
    """Return the square-root information of no rows about n unknowns: zeros (n + 1, n + 1)."""
    return np.zeros((n + 1, n + 1))


def updated_information(
    information: NDArray[np.float64], augmented_rows: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the square-root information (n + 1, n + 1) after adding the rows [A | b] (M, n + 1).

    Rows are not checked: a row that is not finite makes the result not finite.
    """
    updated, _, _, _ = lapack.dtpqrt(0, len(information), information, augmented_rows)
    return np.asarray(updated)


def triangle(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R (n, n) of the QR decomposition of rows (M, n); M may be smaller than n."""
    m, n = rows.shape
    if m < n:
        rows = np.vstack([rows, np.zeros((n - m, n))])
    work = int(lapack.dgeqrf_lwork(*rows.shape)[0])
    return np.triu(lapack.dgeqrf(rows, lwork=work)[0][:n])


def solve_information(
    information: NDArray[np.float64],
    row_count: int,
    *,
    eliminated: int = 0,
    rank_tolerance: float = DEFAULT_RANK_TOLERANCE,
) -> LeastSquaresSolution:
    """Solve for the unknowns from the square-root information of `row_count` scalar rows.

    Columns are scaled here, once: QR decomposition itself does not depend on their scale.

    Args:
        information: (n + 1, n + 1) array from `updated_information`.
        row_count: number of scalar rows that were added.
        eliminated: number of leading unknowns to eliminate: the solution contains the other
            unknowns, for the best values of the eliminated ones.
        rank_tolerance: see `least_squares.DEFAULT_RANK_TOLERANCE`.

    """
    kept = information[eliminated:, eliminated:]
    R, z, rho = kept[:-1, :-1], kept[:-1, -1], kept[-1, -1]
    return solve_compressed(R, z, rho**2, max(row_count - eliminated, 0), rank_tolerance)
