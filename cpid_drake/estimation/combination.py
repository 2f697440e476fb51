"""A joint estimate from several sources, such as logs, and a test whether the sources agree.

A source determines some combinations of the unknowns x. It is represented by rows A x = b with
independent errors of unit variance, one row for each combination. The joint estimate is the least
squares solution of the rows of all sources. If all sources have the same x, the sum of squares of
its residuals has a χ² distribution, with as many degrees of freedom as there are more rows than
determined combinations; so has the decrease of this sum if one source is left out. Source: Rao
1973, Linear Statistical Inference and Its Applications, ch. 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from cpid_drake.estimation.least_squares import (
    KNOWN,
    LeastSquaresSolution,
    solution_of_combinations,
)

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
    def of_solution(cls, solution: LeastSquaresSolution, variance: float = 1.0) -> "SourceRows":
        """Return the rows of the determined combinations of a solution.

        The covariance of the solution is used. If the solution does not determine all unknowns, its
        information is used instead, divided by the factor by which the covariance of the determined
        unknowns is larger than the inverse of the information.

        Args:
            solution: the solution.
            variance: this factor, for a solution that determines no single unknown.

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
        A = A / np.sqrt(ratio.max() if len(ratio) else variance)
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

    def weakened(self, factor: float) -> "SourceRows":
        """Return the rows of a source whose errors are larger by this factor."""
        return SourceRows(self.A / factor, self.b / factor)


@dataclass(frozen=True, eq=False)
class Agreement:
    """The test whether sources agree.

    Attributes:
        chi_squared: sum of squares of the residuals of all rows.
        freedom: number of combinations that more than one source determines.

    """

    chi_squared: float
    freedom: int

    @property
    def probability(self) -> float:
        """Probability of so large a χ² if all sources have the same unknowns."""
        return float(chdtrc(self.freedom, max(self.chi_squared, 0.0))) if self.freedom else 1.0

    @property
    def excess(self) -> float:
        """Excess of χ² over its expectation, in standard deviations of χ²."""
        return (self.chi_squared - self.freedom) / np.sqrt(2 * max(self.freedom, 1))

    def weakened(self, factor: float) -> "Agreement":
        """Return the test of sources whose errors are larger by this factor."""
        return Agreement(self.chi_squared / factor**2, self.freedom)


def joint_solution(
    sources: Sequence[SourceRows],
    nominal: NDArray[np.float64],
    scale: NDArray[np.float64],
    *,
    largest: float = KNOWN,
    row_count: int = 0,
) -> LeastSquaresSolution:
    """Return the joint estimate of several sources.

    Args:
        sources: the sources.
        nominal: (n,) values of combinations that no source determines.
        scale: (n,) plausible sizes of the unknowns.
        largest: largest σ of a determined combination, as a share of its plausible size.
        row_count: number of samples' rows in all sources, for the record.

    """
    A, b = _stacked(sources, nominal, scale)
    U, sizes, axes = _decomposed(A)
    seen = _seen(sizes, largest)
    x = axes[seen].T @ ((U.T @ b)[seen] / sizes[seen])
    return solution_of_combinations(
        nominal + scale * x,
        (A / scale).T @ (A / scale),
        scale,
        sizes,
        axes.T,
        seen,
        row_count=row_count,
    )


def with_shared_errors(
    solution: LeastSquaresSolution,
    sources: Sequence[SourceRows],
    gains: Sequence[NDArray[np.float64] | None],
) -> LeastSquaresSolution:
    """Return a joint solution whose covariance contains errors that several sources share.

    The rows of a source contain these errors as if they were its own. Errors that are the same in
    all sources do not average.

    Args:
        solution: the solution of `joint_solution`.
        sources: the sources.
        gains: for each source: (n, c) the error of its estimate for shared errors of one σ; None if
            it shares none.

    """
    covariance = np.nan_to_num(solution.covariance)
    parts = [
        covariance @ source.A.T @ source.A @ gain
        for source, gain in zip(sources, gains, strict=True)
        if gain is not None
    ]
    if len(parts) < 2:
        return solution
    total = np.sum(parts, axis=0)
    shared = total @ total.T - sum(part @ part.T for part in parts)
    return replace(solution, covariance=solution.covariance + shared)


def agreement(
    sources: Sequence[SourceRows], nominal: NDArray[np.float64], scale: NDArray[np.float64]
) -> Agreement:
    """Return the test whether sources agree; the arguments are those of `joint_solution`.

    A combination of which the sources together know less than its plausible size has its nominal
    value.
    """
    A, b = _stacked(sources, nominal, scale)
    U, sizes, _ = _decomposed(A)
    seen = _seen(sizes, 1.0)
    rest = b - U[:, seen] @ (U.T @ b)[seen]
    return Agreement(float(rest @ rest), len(A) - int(seen.sum()))


def agreement_of_one(
    number: int,
    sources: Sequence[SourceRows],
    nominal: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> Agreement:
    """Return the test whether one of the sources agrees with all others.

    Args:
        number: the number of the source.
        sources, nominal, scale: see `agreement`.

    """
    whole = agreement(sources, nominal, scale)
    others = [source for k, source in enumerate(sources) if k != number]
    rest = agreement(others, nominal, scale) if others else Agreement(0.0, 0)
    return Agreement(whole.chi_squared - rest.chi_squared, whole.freedom - rest.freedom)


def _stacked(
    sources: Sequence[SourceRows], nominal: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rows of all sources by deviations from `nominal`, divided by `scale`."""
    A = np.vstack([np.empty((0, len(scale))), *(source.A for source in sources)])
    b = np.concatenate([np.empty(0), *(source.b for source in sources)])
    return A * scale, b - A @ nominal


def _decomposed(
    A: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return U (m, n), sizes (n,) and axes (n, n) of the singular value decomposition of A."""
    m, n = A.shape
    U, sizes, axes = np.linalg.svd(
        np.vstack([A, np.zeros((max(n - m, 0), n))]), full_matrices=False
    )
    return U[:m], sizes, axes


def _seen(sizes: NDArray[np.float64], largest: float) -> NDArray[np.bool_]:
    """Return which combinations are determined; `largest` is that of `joint_solution`."""
    return sizes > max(1 / largest, _ROUNDING * float(sizes.max(initial=0.0)))
