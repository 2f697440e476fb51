"""Batch least squares, with a measure of how well the data determine each unknown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEFAULT_RANK_TOLERANCE = 1e-9
"""Singular values of column-scaled rows are treated as zero below this share of the largest one.

If a simulation conserves momentum to 1e-10 of its size, the singular values of unobservable
directions are below this tolerance. Noisy rows nearly always have full rank: use the covariance
instead.
"""


KNOWN = 0.1
"""Largest σ of a determined combination of unknowns, as a share of its plausible size."""


@dataclass(frozen=True)
class LeastSquaresSolution:
    """The least-squares solution of A x = b in n unknowns, and measures of its quality.

    Attributes:
        estimate: (n,) unknowns; NaN in every entry that the rows do not determine.
        covariance: (n, n) s² (AᵀA)⁻¹ with s² the residual sum of squares over the degrees of
            freedom, for rows of equal uncertainty; NaN in rows and columns of undetermined entries,
            and in all entries if there are no degrees of freedom.
        information: (n, n) AᵀA: the inverse covariance up to the factor s².
        rank: number of independent combinations of the unknowns that the rows determine.
        singular_values: (n,) singular values of the rows with every column scaled to unit length,
            descending.
        condition_number: ratio of the largest to the smallest singular value; infinite below full
            rank.
        unobservable: (n − rank, n) orthonormal directions, in column-scaled unknowns, along which
            the unknowns can change without a change of A x.
        residual_rms: root mean square of A x − b; NaN without rows.
        row_count: number of scalar rows without rows of zeros.

    """

    estimate: NDArray[np.float64]
    covariance: NDArray[np.float64]
    information: NDArray[np.float64]
    rank: int
    singular_values: NDArray[np.float64]
    condition_number: float
    unobservable: NDArray[np.float64]
    residual_rms: float
    row_count: int

    @property
    def is_observable(self) -> bool:
        """Whether the rows determine every unknown."""
        return self.rank == self.estimate.size


def solve_compressed(
    A: NDArray[np.float64],
    b: NDArray[np.float64],
    left_out: float,
    row_count: int,
    rank_tolerance: float = DEFAULT_RANK_TOLERANCE,
) -> LeastSquaresSolution:
    """Solve rows that may be an orthogonal compression of more rows.

    Args:
        A, b: (M, n) and (M,) the rows themselves, or R and Qᵀb of their QR factors.
        left_out: the part of the residual sum of squares that the compressed rows do not contain.
        row_count: number of rows before compression.
        rank_tolerance: see `DEFAULT_RANK_TOLERANCE`.

    """
    n = A.shape[1]
    norms = np.linalg.norm(A, axis=0)
    # A column that is zero up to rounding must not be scaled to unit length.
    largest = norms.max(initial=0.0) or 1.0
    scale = np.where(norms > 1e-12 * largest, norms, largest)
    if len(A) < n:
        A, b = np.vstack([A, np.zeros((n - len(A), n))]), np.append(b, np.zeros(n - len(b)))
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    rank = int((s > rank_tolerance * s[0]).sum()) if s[0] > 0 else 0
    y = Vt[:rank].T @ ((U.T @ b)[:rank] / s[:rank])
    unobservable = Vt[rank:]
    is_open = np.linalg.norm(unobservable, axis=0) > 1e-6

    residual = A @ (y / scale) - b
    residual_sum = residual @ residual + left_out
    freedom = row_count - rank
    variance = residual_sum / freedom if freedom > 0 else np.nan
    with np.errstate(over="ignore", invalid="ignore"):  # rows of extreme size
        root = (Vt[:rank].T / s[:rank]) / scale[:, None]
        covariance = variance * root @ root.T
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return LeastSquaresSolution(
            estimate=np.where(is_open, np.nan, y / scale),
            covariance=covariance,
            information=A.T @ A,
            rank=rank,
            singular_values=s,
            condition_number=s[0] / s[-1] if rank == n else np.inf,
            unobservable=unobservable,
            residual_rms=np.sqrt(residual_sum / row_count) if row_count else np.nan,
            row_count=row_count,
        )


def solution_of_information(
    estimate: NDArray[np.float64],
    information: NDArray[np.float64],
    scale: NDArray[np.float64],
    *,
    consider: NDArray[np.float64] | None = None,
    residual_sum: float = np.nan,
    row_count: int = 0,
) -> LeastSquaresSolution:
    """Return an estimate with known information as a solution, with its undetermined directions.

    Args:
        estimate: (n,) unknowns.
        information: (n, n) inverse covariance, of the data alone.
        scale: (n,) plausible sizes: a combination of unknowns is treated as undetermined if its σ
            exceeds a tenth of its size, because noise in the regressors has the same effect as
            information.
        consider: (n, n) covariance to add for uncertain quantities that the estimator treated as
            exact.
        residual_sum: sum of the squared residuals of the whitened rows.
        row_count: number of whitened rows.

    """
    scaled = information * scale * scale[:, None]
    values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    values, axes = values[::-1], axes[:, ::-1]
    seen = values > KNOWN**-2
    rank = int(seen.sum())
    unobservable = axes[:, ~seen].T
    is_open = np.linalg.norm(unobservable, axis=0) > 1e-3
    root = scale[:, None] * axes[:, seen] / np.sqrt(values[seen])
    covariance = root @ root.T
    if consider is not None:
        covariance = covariance + consider
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    singular_values = np.sqrt(np.maximum(values, 0.0))
    full = rank == len(scale)
    with np.errstate(divide="ignore", invalid="ignore"):
        return LeastSquaresSolution(
            estimate=np.where(is_open, np.nan, estimate),
            covariance=covariance,
            information=information,
            rank=rank,
            singular_values=singular_values,
            condition_number=singular_values[0] / singular_values[-1] if full else np.inf,
            unobservable=unobservable,
            residual_rms=np.sqrt(residual_sum / row_count) if row_count else np.nan,
            row_count=row_count,
        )
