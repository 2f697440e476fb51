"""What an estimate tells about the unknowns, as rows of its determined combinations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.least_squares import LeastSquaresSolution

_ROUNDING = 1e-13  # share of the best determined combination below which there is rounding only


@dataclass(frozen=True, eq=False)
class SourceRows:
    """What one source tells about the unknowns.

    Attributes:
        A: (r, n) combinations of the unknowns.
        b: (r,) their values, with independent errors of unit variance.

    """

    A: NDArray[np.float64]
    b: NDArray[np.float64]

    @classmethod
    def of_information(
        cls,
        values: NDArray[np.float64],
        information: NDArray[np.float64],
        unit: NDArray[np.float64],
    ) -> "SourceRows":
        """Return the rows of an estimate with an information matrix of any rank.

        Args:
            values: (n,) the estimate, with arbitrary values of undetermined combinations.
            information: (n, n) inverse covariance, zero for undetermined combinations.
            unit: (n,) units that make the unknowns comparable.

        """
        scaled = information * unit * unit[:, None]
        sizes, axes = np.linalg.eigh((scaled + scaled.T) / 2)
        seen = sizes > max(float(sizes[-1]), 0.0) * _ROUNDING
        A = np.sqrt(sizes[seen])[:, None] * axes[:, seen].T / unit
        return cls(A, A @ values)

    @classmethod
    def of_solution(cls, solution: LeastSquaresSolution) -> "SourceRows":
        """Return the rows of the determined combinations of a solution.

        The covariance of the solution is used. If the solution does not determine all unknowns, its
        information is used instead, divided by the factor by which the covariance of the determined
        unknowns is larger than the inverse of the information.
        """
        unit, n = solution.unit, len(solution.unit)
        if solution.is_observable and np.isfinite(solution.covariance).all():
            own = np.sqrt(np.maximum(np.diag(solution.covariance), np.finfo(float).tiny))
            correlation = solution.covariance / own / own[:, None]
            sizes, axes = np.linalg.eigh((correlation + correlation.T) / 2)
            A = (axes / np.sqrt(np.maximum(sizes, 1e-15))).T / own
            return cls(A, A @ solution.values)
        open_part = solution.unobservable
        axes = np.linalg.svd(open_part, full_matrices=True)[2][len(open_part) :]
        scaled = solution.information * unit * unit[:, None]
        sizes, turn = np.linalg.eigh(axes @ scaled @ axes.T)
        kept = sizes > 0
        A = np.sqrt(sizes[kept])[:, None] * (turn[:, kept].T @ axes) / unit
        covariance = np.linalg.pinv(A * unit) @ np.linalg.pinv(A * unit).T if len(A) else np.eye(n)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.diag(solution.covariance) / (np.diag(covariance) * unit**2)
        ratio = ratio[np.isfinite(ratio) & np.isfinite(solution.estimate)]
        A = A / np.sqrt(ratio.max() if len(ratio) else 1.0)
        return cls(A, A @ solution.values)

    def limited(self, scale: NDArray[np.float64], smallest: float) -> "SourceRows":
        """Return the rows with a least σ of each combination, as a share of its plausible size.

        Differences that are smaller than this are rounding.
        """
        if not len(self.b):
            return self
        U, sizes, axes = np.linalg.svd(self.A * scale, full_matrices=False)
        kept = sizes > 0
        factor = np.minimum(1.0, 1 / smallest / sizes[kept])[:, None]
        A = factor * sizes[kept, None] * axes[kept] / scale
        return SourceRows(A, factor[:, 0] * (U.T @ self.b)[kept])
