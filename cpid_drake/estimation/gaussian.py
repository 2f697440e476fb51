"""Gaussian distributions of named unknowns, as a square root of information.

The distribution is that of x in R x = z + e, where e has unit covariance: R is upper triangular,
and ρ² is the sum of squares that no x explains. Every operation is a QR decomposition of rows, and
no covariance is propagated. Source: Bierman 1977, Factorization Methods for Discrete Sequential
Estimation, ch. II and V.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import (
    DEFAULT_RANK_TOLERANCE,
    KNOWN,
    triangle,
)

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

    def indices(self, names: Iterable[str]) -> NDArray[np.intp]:
        """Return the columns of some unknowns, in this order."""
        parts = [np.arange(self.places[n].start, self.places[n].stop) for n in names]
        return np.concatenate([np.empty(0, np.intp), *parts])

    def add(self, other: "Gaussian") -> "Gaussian":
        """Return what both say together; unknowns of one name are the same unknown."""
        sizes = self.sizes | other.sizes
        places = places_of(sizes)
        n = sum(sizes.values())
        rows = np.zeros((self.size + other.size, n + 1))
        first = 0
        for part in (self, other):
            columns = np.concatenate([np.r_[places[name]] for name in part.places] or [[]])
            block = rows[first : first + part.size]
            block[:, columns.astype(int)], block[:, n] = part.R, part.z
            first += part.size
        return Gaussian.of_rows(sizes, rows, self.rho2 + other.rho2)

    def marginal(self, names: Iterable[str]) -> "Gaussian":
        """Return the distribution of some unknowns, whatever the others are.

        The others must be determined, by a prior if by nothing else.
        """
        names = list(names)
        others = [name for name in self.places if name not in names]
        order = np.concatenate([self.indices(others), self.indices(names)])
        gone = self.size - len(self.indices(names))
        sizes = {name: self.sizes[name] for name in names}
        if np.array_equal(order, np.arange(self.size)):
            return Gaussian.of_triangle(sizes, self.rows[gone:, gone:], self.rho2)
        T = triangle(np.column_stack([self.R[:, order], self.z]))
        rho2 = self.rho2 + float(T[-1, -1]) ** 2
        return Gaussian.of_triangle(sizes, T[gone:-1, gone:], rho2)

    def condition(self, values: Mapping[str, ArrayLike]) -> "Gaussian":
        """Return the distribution of the others if some unknowns have the given values."""
        b = self.z.copy()
        for name, value in values.items():
            place = self.places[name]
            b -= self.R[:, place] @ np.broadcast_to(value, place.stop - place.start)
        sizes = {name: size for name, size in self.sizes.items() if name not in values}
        rows = np.column_stack([self.R[:, self.indices(sizes)], b])
        return Gaussian.of_rows(sizes, rows, self.rho2)

    def moved(self, step: Array) -> "Gaussian":
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
        seen = sizes > _NEGLIGIBLE * sizes.max(initial=0.0)
        return U[:, seen], sizes[seen], axes[seen]

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
        U, s, Vt = np.linalg.svd(self.R / scale, full_matrices=False)
        known = s > _NEGLIGIBLE * s.max(initial=0.0)
        return np.asarray(Vt[known].T @ ((U.T @ self.z)[known] / s[known]) / scale)

    def covariance(self) -> Array:
        """Return the covariance (n, n); all directions must be determined.

        Raises:
            numpy.linalg.LinAlgError: nothing determines some direction.

        """
        scale = np.linalg.norm(self.R, axis=0)
        if not scale.all():
            raise np.linalg.LinAlgError("nothing determines some of the unknowns")
        inverse = np.linalg.inv(self.R / scale) / scale[:, None]
        return np.asarray(inverse @ inverse.T)


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """The least-squares solution of A x = b in n unknowns, and measures of its quality.

    Attributes:
        estimate: (n,) unknowns; NaN in every entry that the rows do not determine.
        covariance: (n, n) s² (AᵀA)⁻¹ with s² the residual sum of squares over the degrees of
            freedom, for rows of equal uncertainty; NaN in rows and columns of undetermined entries,
            and in all entries if there are no degrees of freedom.
        spread: (n, n) covariance if combinations that are not determined have their plausible size
            as σ before the rows; NaN if such sizes are not known.
        known: what is known: the determined combinations, and those about which something is known,
            about as much as a unit.
        rank: number of independent combinations of the unknowns that the rows determine.
        singular_values: (n,) singular values of the rows with every column scaled to unit length,
            descending.
        unidentifiable: (n − rank, n) orthonormal directions, in column-scaled unknowns, along which
            the unknowns can change without a change of A x.
        residual_rms: root mean square of A x − b; NaN if the rows themselves are not known.
        row_count: number of scalar rows without rows of zeros.
        values: (n,) as `estimate`, with an arbitrary value of each undetermined combination in
            place of NaN.
        unit: (n,) the unit of each unknown in `unidentifiable`: unknown = unit × column-scaled one.

    """

    estimate: Array
    covariance: Array
    spread: Array
    known: Gaussian
    rank: int
    singular_values: Array
    unidentifiable: Array
    residual_rms: float
    row_count: int
    values: Array
    unit: Array

    @property
    def is_identifiable(self) -> bool:
        """Whether the rows determine every unknown."""
        return self.rank == self.estimate.size

    @property
    def information(self) -> Array:
        """(n, n) inverse covariance of what is known."""
        return self.known.R.T @ self.known.R

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
    moved = target.moved(nominal)
    U, sizes, axes = np.linalg.svd(moved.R * scale)
    strong = sizes > max(1 / largest, _NEGLIGIBLE * float(sizes[0]))
    x = nominal + scale * (axes[strong].T @ ((U.T @ moved.z)[strong] / sizes[strong]))
    root = (
        scale[:, None]
        * axes.T
        * np.where(strong, 1 / np.maximum(sizes, 1e-300), 1 / np.hypot(1.0, sizes))
    )
    spread = root @ root.T
    covariance = spread.copy()
    is_large = np.diag(spread) > (largest * scale) ** 2
    is_open = is_large | (np.linalg.norm(axes[~strong], axis=0) > share)
    A = sizes[strong, None] * axes[strong] / scale
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    return LeastSquaresSolution(
        estimate=np.where(is_open, np.nan, x),
        covariance=covariance,
        spread=spread,
        known=Gaussian.of_rows(target.sizes, np.column_stack([A, A @ x])),
        rank=int(strong.sum()),
        singular_values=sizes,
        unidentifiable=axes[~strong],
        residual_rms=np.nan,
        row_count=row_count,
        values=x,
        unit=scale,
    )


def solution_of_rows(rows: Array, row_count: int) -> LeastSquaresSolution:
    """Return the solution of rows of equal noise, which their residuals show.

    Columns are scaled to unit length here: nothing is known about plausible sizes.

    Args:
        rows: (m, n + 1) [A | b], or their triangle.
        row_count: number of the rows that are not zero.

    """
    n = rows.shape[1] - 1
    target = Gaussian.of_rows({"x": n}, rows)
    norms = np.linalg.norm(target.R, axis=0)
    # A column that is zero up to rounding must not be scaled to unit length.
    largest = norms.max(initial=0.0) or 1.0
    scale = 1 / np.where(norms > 1e-12 * largest, norms, largest)
    size = float(np.linalg.norm(target.R * scale, 2))
    least = 1 / (DEFAULT_RANK_TOLERANCE * size) if size else np.inf
    found = solution_of(target, np.zeros(n), scale, largest=least, share=1e-6)
    squares, freedom = target.cost(found.values), row_count - found.rank
    variance = squares / freedom if freedom > 0 else np.nan
    factor = 1 / np.sqrt(variance) if variance > 0 else 1.0
    known = replace(found.known, R=factor * found.known.R, z=factor * found.known.z)
    with np.errstate(over="ignore", invalid="ignore"):  # rows of extreme size
        covariance = variance * found.covariance
    return replace(
        found,
        covariance=covariance,
        spread=covariance,
        known=known,
        residual_rms=np.sqrt(squares / row_count) if row_count > 0 else np.nan,
        row_count=max(row_count, 0),
    )


def places_of(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return successive places of unknowns with so many entries."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True)}
