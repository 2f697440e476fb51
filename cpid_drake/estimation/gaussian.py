"""Gaussian distributions of named unknowns, as a square root of information.

The distribution is that of x in R x = z + e, where e has unit covariance: R is upper triangular,
and ρ² is the sum of squares that no x explains. What adds, marginalizes and conditions is a QR
decomposition of rows, and no covariance is propagated. Source: Bierman 1977, Factorization Methods
for Discrete Sequential Estimation, ch. II and V.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack, solve_triangular

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import (
    DEFAULT_RANK_TOLERANCE,
    KNOWN,
    residual_variance,
    sum_of_triangles,
    triangle,
)

_OPEN = 1e-6  # largest part in combinations that rows do not determine of an entry that is known
_DETERMINED = 1e-6  # share of each column that others leave of it: no direction is open
_NEGLIGIBLE = 1e-13  # share of the largest singular value of scaled columns that is rounding error


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A distribution of named unknowns.

    Attributes:
        places: the columns of each unknown.
        R: (n, n) upper triangle.
        z: (n,) right-hand side.
        rho2: sum of squares at the mean.
        volume: log of the determinant of what was eliminated in a sweep.

    """

    places: dict[str, slice]
    R: Array
    z: Array
    rho2: float = 0.0
    volume: float = 0.0

    @classmethod
    def of_rows(cls, sizes: Mapping[str, int], rows: Array, rho2: float = 0.0) -> "Gaussian":
        """Return the distribution that rows [A | b] (m, n + 1) with unit noise determine.

        Args:
            sizes: number of entries of each unknown, in the order of A's columns.
            rows: [A | b].
            rho2: sum of squares from elsewhere.

        """
        T = triangle(rows)
        return cls.of_triangle(sizes, T[:-1], rho2 + float(T[-1, -1]) ** 2)

    @classmethod
    def of_triangle(cls, sizes: Mapping[str, int], T: Array, rho2: float = 0.0) -> "Gaussian":
        """Return the distribution of a triangle [R | z] (n, n + 1); see `of_rows`."""
        return cls(places_of(sizes), T[:, :-1], T[:, -1], rho2)

    @property
    def size(self) -> int:
        """Number n of all entries."""
        return int(self.R.shape[1])

    @property
    def rows(self) -> Array:
        """[R | z] (n, n + 1)."""
        return np.column_stack([self.R, self.z])

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of each unknown."""
        return {name: place.stop - place.start for name, place in self.places.items()}

    def add(self, other: "Gaussian") -> "Gaussian":
        """Return what both say together; unknowns of one name are the same unknown."""
        sizes = self.sizes | other.sizes
        places = places_of(sizes)
        n = sum(sizes.values())
        both, is_ordered = np.zeros((2, n + 1, n + 1)), True
        for part, rows in zip((self, other), both, strict=True):
            columns = np.concatenate(
                [np.empty(0, np.intp), *[np.r_[places[k]] for k in part.places]]
            )
            is_ordered &= bool(np.all(np.diff(columns) > 0))
            rows[np.ix_(columns, columns)], rows[columns, n] = part.R, part.z
        rho2 = self.rho2 + other.rho2
        if not is_ordered:
            return Gaussian.of_rows(sizes, both.reshape(-1, n + 1), rho2)
        T = sum_of_triangles(*both)  # both are triangles
        return Gaussian.of_triangle(sizes, T[:-1], rho2 + float(T[-1, -1]) ** 2)

    def marginal(self, names: Iterable[str]) -> "Gaussian":
        """Return the distribution of some unknowns, whatever the others are.

        The others must be determined, by a prior if by nothing else.
        """
        names = list(names)
        others = [name for name in self.places if name not in names]
        order = np.concatenate([indices_of(self.places, others), indices_of(self.places, names)])
        gone = self.size - len(indices_of(self.places, names))
        sizes = {name: self.sizes[name] for name in names}
        if np.array_equal(order, np.arange(self.size)):
            return Gaussian.of_triangle(sizes, self.rows[gone:, gone:], self.rho2)
        same = min(int(np.argmax(order != np.arange(self.size))), gone)  # a triangle before
        # The others first: the last rows of their triangle are free of them.
        T = triangle(np.column_stack([self.R[same:, order[same:]], self.z[same:]]))
        rho2 = self.rho2 + float(T[-1, -1]) ** 2
        return Gaussian.of_triangle(sizes, T[gone - same : -1, gone - same :], rho2)

    def condition(self, values: Mapping[str, ArrayLike]) -> "Gaussian":
        """Return the distribution of the others if some unknowns have the given values."""
        if not values:
            return self
        b = self.z.copy()
        for name, value in values.items():
            place = self.places[name]
            # R_x x = z − R_c c
            b -= self.R[:, place] @ np.broadcast_to(value, place.stop - place.start)
        sizes = {name: size for name, size in self.sizes.items() if name not in values}
        rows = np.column_stack([self.R[:, indices_of(self.places, sizes)], b])
        same = min(self.places[name].start for name in values)  # a triangle before
        T = triangle(rows[same:, same:])
        rows = np.vstack([rows[:same], np.pad(T[:-1], ((0, 0), (same, 0)))])
        return Gaussian.of_triangle(sizes, rows, self.rho2 + float(T[-1, -1]) ** 2)

    def minus(self, step: Array) -> "Gaussian":
        """Return the distribution of x − step for a step (n,)."""
        return replace(self, z=self.z - self.R @ step)

    @property
    def rank(self) -> int:
        """Number of combinations of the unknowns about which it says anything."""
        if not self.R.size:
            return 0
        norms = np.linalg.norm(self.R, axis=0)
        scaled = self.R / np.where(norms > 0, norms, 1.0)
        return int(np.linalg.matrix_rank(scaled, tol=1e-12 * np.sqrt(len(scaled))))

    def singular_parts(self, scale: Array) -> tuple[Array, Array, Array]:
        """Return U (n, k), singular values (k,) and Vᵀ (k, n) of R in units `scale` (n,).

        Singular values that are rounding errors are left out.
        """
        U, sizes, axes = np.linalg.svd(self.R * scale)
        is_significant = sizes > _NEGLIGIBLE * sizes.max(initial=0.0)
        return U[:, is_significant], sizes[is_significant], axes[is_significant]

    def cost(self, x: Array) -> float:
        """Return the sum of squares at x (n,)."""
        return self.rho2 + float(np.sum((self.R @ x - self.z) ** 2))

    @property
    def least_cost(self) -> float:
        """The sum of squares at the mean."""
        return self.cost(self.solve())

    def solve(self) -> Array:
        """Return the mean (n,), with zero along what nothing determines."""
        scale = np.linalg.norm(self.R, axis=0)
        scale[scale == 0] = 1.0
        if np.min(np.abs(np.diag(self.R)) / scale, initial=1.0) > _DETERMINED:
            return np.asarray(solve_triangular(self.R, self.z))
        U, s, Vt = np.linalg.svd(self.R / scale, full_matrices=False)
        is_determined = s > _NEGLIGIBLE * s.max(initial=0.0)
        return np.asarray(
            Vt[is_determined].T @ ((U.T @ self.z)[is_determined] / s[is_determined]) / scale
        )

    def covariance(self) -> Array:
        """Return the covariance (n, n); all directions must be determined.

        Raises:
            numpy.linalg.LinAlgError: nothing determines some direction.

        """
        scale = np.linalg.norm(self.R, axis=0)
        if not scale.all():
            raise np.linalg.LinAlgError("nothing determines some of the unknowns")
        # (RᵀR)⁻¹ = R⁻¹R⁻ᵀ
        inverse = np.linalg.inv(self.R / scale) / scale[:, None]
        return np.asarray(inverse @ inverse.T)


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """The least-squares solution of A x = b in n unknowns, and measures of its quality.

    With every column scaled to the unit of its unknown, A is U S Vᵀ.

    Attributes:
        unknowns: number of entries of each unknown.
        unit: (n,) the unit of each unknown: unknown = unit × column-scaled one.
        values: (n,) the unknowns, with an arbitrary value of each combination that is not
            determined.
        axes: (n, n) Vᵀ.
        singular_values: (n,) S, descending.
        rank: number of independent combinations that the rows determine, the first of the axes.
        is_open: (n,) whether the rows leave an unknown open.
        sigma: σ of the errors of the rows.
        root: (n, n) a square root of the covariance, with a plausible size as σ of combinations
            that are not determined; NaN if the errors of the rows are not known.
        row_count: number of scalar rows without rows of zeros.
        residual_rms: root mean square of A x − b; NaN if the rows themselves are not known.
        has_sizes: whether plausible sizes of the unknowns are known.
        has_noise: whether the errors of the rows are known.

    """

    unknowns: Mapping[str, int]
    unit: Array
    values: Array
    axes: Array
    singular_values: Array
    rank: int
    is_open: NDArray[np.bool_]
    root: Array
    sigma: float = 1.0
    row_count: int = 0
    residual_rms: float = np.nan
    has_sizes: bool = True
    has_noise: bool = True

    @cached_property
    def estimate(self) -> Array:
        """(n,) unknowns; NaN in every entry that the rows do not determine."""
        return np.where(self.is_open, np.nan, self.values)

    @cached_property
    def covariance(self) -> Array:
        """(n, n) s² (AᵀA)⁻¹ with s² the `least_squares.residual_variance`, for rows of equal noise.

        NaN in rows and columns of entries that are not determined, and without known errors.
        """
        covariance = self.root @ self.root.T
        is_open = self.is_open if self.has_noise else np.ones_like(self.is_open)
        covariance[is_open, :] = covariance[:, is_open] = np.nan
        return covariance

    @cached_property
    def spread(self) -> Array:
        """(n, n) covariance if what is not determined has its plausible size as σ; else NaN."""
        return self.root @ self.root.T if self.has_sizes else self.covariance

    @cached_property
    def determined(self) -> Gaussian:
        """What is known: the determined combinations, as equations with unit errors."""
        A = self.singular_values[: self.rank, None] * self.axes[: self.rank] / self.unit
        A /= self.sigma
        return Gaussian.of_rows(self.unknowns, np.column_stack([A, A @ self.values]))

    @property
    def unidentifiable(self) -> Array:
        """(n − rank, n) orthonormal directions in column-scaled unknowns that A x does not show."""
        return self.axes[self.rank :]

    @property
    def is_identifiable(self) -> bool:
        """Whether the rows determine every unknown."""
        return self.rank == len(self.values)

    @property
    def information(self) -> Array:
        """(n, n) inverse covariance of what is known."""
        return self.determined.R.T @ self.determined.R

    @property
    def condition_number(self) -> float:
        """Ratio of the largest to the smallest singular value; infinite below full rank."""
        sizes = self.singular_values
        return float(sizes[0] / sizes[-1]) if self.is_identifiable else np.inf


def solution_of(
    target: Gaussian,
    nominal: Array,
    scale: Array,
    *,
    largest: float = KNOWN,
    share: float = 1e-3,
    row_count: int = 0,
) -> LeastSquaresSolution:
    """Return the solution of a Gaussian of the target alone.

    Combinations whose σ is too large stay nominal, and have their plausible size as σ beforehand:
    noise alone looks like weak knowledge. An entry is known if its σ is small all the same, and if
    it contains nothing of these combinations.

    Args:
        target: of n unknowns.
        nominal: (n,) values of combinations that are not determined.
        scale: (n,) plausible sizes of the unknowns.
        largest: largest σ of what is known, as a share of its plausible size.
        share: largest part in such combinations of an entry that is known.
        row_count: number of the rows, for the record.

    """
    z = target.z - target.R @ nominal
    x, root, sizes, axes, rank, _ = _determined(target.R, z, scale, _NEGLIGIBLE, 1 / largest)
    is_large = np.einsum("ij,ij->i", root, root) > (largest * scale) ** 2
    return LeastSquaresSolution(
        target.sizes,
        scale,
        nominal + x,
        axes,
        sizes,
        rank,
        is_large | (np.linalg.norm(axes[rank:], axis=0) > share),
        root,
        row_count=row_count,
    )


def solution_of_rows(rows: Array, row_count: int) -> LeastSquaresSolution:
    """Return the solution of rows [A | b] (m, n + 1); see `solution_of_triangle`."""
    return solution_of_triangle(triangle(rows), row_count)


def solution_of_triangle(T: Array, row_count: int) -> LeastSquaresSolution:
    """Return the solution of rows of equal noise, which their residuals show.

    Columns are scaled to unit length here: nothing is known about plausible sizes.

    Args:
        T: (n + 1, n + 1) their triangle [R z; 0 ρ].
        row_count: number of the rows that are not zero.

    """
    R, z, rho2 = T[:-1, :-1], T[:-1, -1], float(T[-1, -1]) ** 2
    norms = np.sqrt(np.einsum("ij,ij->j", R, R))
    # A column that is zero up to rounding must not be scaled to unit length.
    largest = float(norms.max(initial=0.0)) or 1.0
    norms[norms <= 1e-12 * largest] = largest
    x, root, sizes, axes, rank, rests = _determined(R, z, 1 / norms, DEFAULT_RANK_TOLERANCE)
    squares = rho2 + float(rests @ rests)
    variance = residual_variance(squares, rho2 + float(z @ z), row_count, rank)
    is_open = np.zeros(len(x), dtype=bool)
    if rank < len(x):
        is_open = np.linalg.norm(axes[rank:], axis=0) > _OPEN
    with np.errstate(over="ignore", invalid="ignore"):  # rows of extreme size
        root *= variance**0.5
    return LeastSquaresSolution(
        {"x": len(x)},
        1 / norms,
        x,
        axes,
        sizes,
        rank,
        is_open,
        root,
        variance**0.5 if variance > 0 else 1.0,
        max(row_count, 0),
        (squares / row_count) ** 0.5 if row_count > 0 else np.nan,
        has_sizes=False,
    )


def _determined(
    R: Array, z: Array, scale: Array, tolerance: float, least: float = 0.0
) -> tuple[Array, Array, Array, Array, int, Array]:
    """Return what R x = z determines in units `scale`, by the decomposition U S Vᵀ of R · scale.

    Returns:
        x (n,), zero along what is not determined; a root (n, n) of its covariance, with a unit as σ
        along these; S (n,); Vᵀ (n, n); the number of directions that are determined; and the
        residuals (n − rank,) of z along the others.

    """
    U, S, Vt, failed = lapack.dgesdd(R * scale)
    if failed:
        raise np.linalg.LinAlgError("rows are not finite")
    rank = int(np.count_nonzero(max(least, tolerance * float(S[0])) < S))
    # x = V S⁻¹ Uᵀ z and its root V S⁻¹, along the determined directions.
    sizes = S.copy()
    sizes[rank:] = np.hypot(1.0, S[rank:])
    root, image = scale[:, None] * Vt.T / sizes, z @ U
    return root[:, :rank] @ image[:rank], root, S, Vt, rank, image[rank:]


def indices_of(places: Mapping[str, slice], names: Iterable[str]) -> NDArray[np.intp]:
    """Return the columns of some unknowns, in this order."""
    parts = [np.arange(places[n].start, places[n].stop) for n in names]
    return np.concatenate([np.empty(0, np.intp), *parts])


def places_of(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return successive places of unknowns with so many entries."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True)}
