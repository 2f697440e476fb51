"""Elimination of what ends with a block, and of changes at its end, by QR of rows.

What is eliminated is known for given values of what is kept, with rows [X | z] of x = z − X keep.
So it can be found again, and its uncertainty: the covariance of what is kept, and that of the rows.

Source: Bierman 1977, Factorization Methods for Discrete Sequential Estimation, ch. V and X.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.array import Array
from cpid_drake.estimation.block_rows import BlockRows
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import sum_of_triangles, triangle, updated_information
from cpid_drake.estimation.likelihood.model import BlockModel


@dataclass(frozen=True, eq=False)
class Change:
    """A change u of some entries at the end of a block, eliminated; see `changed`.

    Attributes:
        columns: (m,) the entries that change.
        rows: (m, n + 1) [X | z] of u = z − X x, with x those behind the change.
        unit: (m, m) root of the covariance of u for given x.
        now: (m,) present values of u.
        block: number of the block.

    """

    columns: NDArray[np.intp]
    rows: Array
    unit: Array
    now: Array
    block: int

    def solved(self, x: Array) -> Array:
        """Return u, given the step x (n,) behind the change."""
        return np.asarray(self.rows[:, -1] - self.rows[:, :-1] @ x)

    def spread(self, root: Array) -> Array:
        """Return a root (n, ...) of the covariance before the change, from one behind it."""
        X, m = self.rows[:, :-1], len(self.columns)
        # before = x − u = x + X x − z, where it changes
        before = np.column_stack([np.zeros((len(root), m)), root])
        before[self.columns] += np.column_stack([self.unit, X @ root])
        return before


@dataclass(frozen=True, eq=False)
class EndedBlock:
    """A block, eliminated: what ended with it is z − X keep.

    Attributes:
        model: of the block.
        gone: (g,) columns of what ended with it.
        keep: (k,) columns of what is known at its end.
        rows: (g, k + 1) [X | z].
        unit: (g, g) root of the covariance of what ended, for given values of what is kept.
        transition: E of x₁ = E₀ x₀ + E y; see `BlockRows`.
        absorbed: how many of a sensor's residuals the unknowns absorb that end with the block.

    """

    model: BlockModel
    gone: NDArray[np.intp]
    keep: NDArray[np.intp]
    rows: Array
    unit: Array
    transition: Array
    absorbed: dict[str, float]

    @classmethod
    def of(
        cls,
        block_model: BlockModel,
        residuals: Mapping[str, Array],
        block_rows: BlockRows,
        T: Array,
    ) -> "EndedBlock":
        """Return a block from its rows and its triangle."""
        E, gone, at_end = block_rows.transition, block_rows.gone, block_model.at_end
        first, g = block_model.shared_start, len(gone)
        # columns 0 to 11, x₀ until now, are x₁ from here on
        keep = np.concatenate([at_end, np.arange(first, first + len(T) - 1 - g - len(at_end))])
        # x₀ = E₀⁻¹(x₁ − E y): a row A₀ x₀ + A y has (A − A₀E₀⁻¹E) y
        start = np.linalg.solve(E[:, :12], E[:, gone])
        of_gone = block_rows.samples[:, 12 : 12 + g] - block_rows.samples[:, :12] @ start
        inverse = solve_triangular(T[:g, :g], np.eye(g))
        # |row T⁻¹|²: the share of a residual that they explain
        leverage = np.sum((of_gone @ inverse) ** 2, axis=1)
        ends = np.cumsum([each.size for each in residuals.values()])
        absorbed = {n: float(x.sum()) for n, x in zip(residuals, np.split(leverage, ends))}
        return cls(block_model, gone, keep, inverse @ T[:g, g:], inverse, E, absorbed)

    def solved(self, x: Array) -> Array:
        """Return the steps of all columns of the block's model, given those x (k,) at its end."""
        y = np.zeros(len(self.gone) + len(self.keep))
        y[self.gone], y[self.keep] = self.rows[:, -1] - self.rows[:, :-1] @ x, x
        return self._from_start(y)[: self.transition.shape[1]]

    def spread(self, root: Array) -> Array:
        """Return a root of the covariance of all columns, from one (k, ...) of those at its end.

        Behind the columns of the block's model are the other entries that are kept.
        """
        g = len(self.gone)
        y = np.zeros((g + len(self.keep), g + root.shape[1]))
        y[self.gone, :g], y[self.gone, g:] = self.unit, -self.rows[:, :-1] @ root
        y[self.keep, g:] = root
        return self._from_start(y)

    def at_start(self, values: Array) -> Array:
        """Return what is kept at the block's start of values (n, ...) of all columns."""
        return np.concatenate([values[self.model.at_start], values[self.model.shared_start :]])

    def _from_start(self, y: Array) -> Array:
        """Return values with the state at the block's start in place of that at its end."""
        # x₀ = E₀⁻¹(x₁ − E y)
        E, x1 = self.transition, y[:12].copy()
        y[:12] = 0.0
        y[:12] = np.linalg.solve(E[:, :12], x1 - E @ y[: E.shape[1]])
        y[self.model.held] = 0.0
        return y


def eliminated(
    block_model: BlockModel, block_rows: BlockRows, before: Gaussian
) -> tuple[Gaussian, Array]:
    """Return what is known at the end of a block, and the triangle [R | z] without its start.

    With the start x₀ (attitude, p, L, v) and all other columns y, the end is x₁ = E₀ x₀ + E y. So a
    row A₀ x₀ + A y = b is

        A₀E₀⁻¹ x₁ + (A − A₀E₀⁻¹E) y = b,

    and QR eliminates what ends with the block. Only the first rows of both triangles contain x₀ or
    what ends: the others remain a triangle.
    """
    order, own, E = block_rows.order, block_rows.T, block_rows.transition
    n, gone, at_end = len(order), len(block_rows.gone), block_model.at_end
    size = gone + before.size
    # The result's columns are: what ends, x₁, the joints at the end, and the table, the last of
    # which is the log's momentum, that no block has; then b.
    of_block = np.r_[:gone, gone + 12 : n, size]  # places of the block's y and b
    joints = of_block[np.argsort(order)[block_model.at_start[12:]] - 12]  # those at its start end
    of_before = np.r_[:12, 12 + joints, 12 + gone + len(at_end) : size + 13]  # after x₀
    # [A₀ | A | b]: the first rows of what is known before, and of the block's own.
    rows_before, boundary, first = before.rows, len(at_end), gone + 12
    rows = np.zeros((boundary + first, 12 + size + 1))
    rows[:boundary, of_before] = rows_before[:boundary]
    rows[boundary:, :12], rows[boundary:, 12 + of_block] = own[:first, :12], own[:first, 12:]
    # A₀E₀⁻¹ x₁ + (A − A₀E₀⁻¹E) y = b
    of_end = rows[:, :12] @ np.linalg.inv(E[:, :12])
    rows[:, 12 + of_block[:-1]] -= of_end @ E[:, order[12:]]
    rows[:, 12 + gone : 12 + first] = of_end
    ended = triangle(rows[:, 12:])[: boundary + first]
    # The other rows of both contain neither: they remain triangles.
    others, places = np.zeros((2, size + 1 - gone, size + 1 - gone)), of_block[gone:] - gone
    others[0][np.ix_(places, places)] = own[first:, first:]
    others[1, boundary:-1, boundary:] = rows_before[boundary:, boundary:]
    T = np.zeros((size + 1, size + 1))
    T[:gone] = ended[:gone]
    T[gone:, gone:] = updated_information(sum_of_triangles(*others), ended[gone:, gone:])
    rho2 = before.rho2 + float(T[-1, -1]) ** 2
    volume = before.volume + float(np.sum(np.log(np.abs(np.diag(T)[:gone]))))
    return replace(before, R=T[gone:-1, gone:-1], z=T[gone:-1, -1], rho2=rho2, volume=volume), T


def changed(
    gaussian: Gaussian, columns: NDArray[np.intp], sigma: Array, now: Array, block: int
) -> tuple[Gaussian, Change]:
    """Return what is known after a change u ~ N(0, σ²) of some entries, which is eliminated.

    u has the present value `now`. The entries before are those after it less u: rows R x = z become
    R x − R_u u = z, and (now + u)/σ = 0 is one more.
    """
    m, n = len(columns), gaussian.size
    if not m:
        return gaussian, Change(columns, np.zeros((0, n + 1)), np.zeros((0, 0)), now, block)
    before, p = gaussian.rows, 1 + int(columns.max())  # the first rows contain them
    # [1/σ, 0; −R_u, R] (u, x) = (−now/σ, z)
    rows = np.zeros((m + p, m + n + 1))
    rows[:m, :m], rows[:m, -1] = np.diag(1 / sigma), -now / sigma
    rows[m:, :m], rows[m:, m:] = -before[:p, columns], before[:p]
    T = triangle(rows)
    before[:p] = T[m : m + p, m:]
    unit = solve_triangular(T[:m, :m], np.eye(m))
    volume = gaussian.volume + float(np.sum(np.log(np.abs(np.diag(T)[:m]))))
    after = replace(gaussian, R=before[:, :-1], z=before[:, -1], volume=volume)
    return after, Change(columns, unit @ T[:m, m:], unit, now, block)


def linked(gaussian: Gaussian, name: str, sigma: Array, now: Array) -> Gaussian:
    """Return what is known after a change u (12,) of attitude, p, L and v, a further unknown.

    See `changed`. These are the first columns, and u is last: the rows remain a triangle.
    """
    n = gaussian.size
    # [R, −R_u; 0, 1/σ] (x, u) = (z, −now/σ)
    T = np.zeros((n + 12, n + 13))
    T[:n, :n], T[:n, n:-1], T[:n, -1] = gaussian.R, -gaussian.R[:, :12], gaussian.z
    T[n:, n:-1], T[n:, -1] = np.diag(1 / sigma), -now / sigma
    return Gaussian.of_triangle({**gaussian.sizes, name: 12}, T, gaussian.rho2)
