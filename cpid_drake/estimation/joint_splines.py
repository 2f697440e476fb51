"""The splines of a log's joints for any jerk, by square roots: no normal equations.

In a block c = T (z, v, x), see `edge_coordinates`: x is the state at its end; x and v (3,) alone
give that at its start; |P c|² = |z|² + |v|². The singular values a of the samples' rows in z turn
z so that each z is in one row of the samples, a z + E (v, x) = y. The least over z, for any λ, is

    (a z + E (v, x) − y)² + z²/λ = (E (v, x) − y)² / (1 + λ a²)

What is left is a chain of states: QR eliminates v of a block from its rows and from those by which
the blocks before know the state at its start. Neither a large λ nor a small one loses digits, as
the banded BᵀB + PᵀP/λ does, whose condition is the square of that of the rows.

Sources: Demmler and Reinsch 1975, Oscillation matrices with spline smoothing; Bierman 1977,
Factorization Methods for Discrete Sequential Estimation, ch. V; MacKay 1992, Bayesian
interpolation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.joint_samples import JointSamples
from cpid_drake.estimation.least_squares import triangles
from cpid_drake.estimation.likelihood.joint_model import ORDER, edge_coordinates
from cpid_drake.estimation.process import DECLARED_COUNT, Process

Indices = NDArray[np.intp]

ENOUGH = 6.0
"""Difference of −2 log(evidence) that is strong evidence (Kass and Raftery 1995)."""

_GRID = np.arange(-29.0, 16.0, 3.0)  # of log λ: jerk noise of 1e-6 to 1e3 rad/s³·√s
_EDGES = 2 * ORDER  # columns of v and x
_TOGETHER = 16  # blocks whose rows are decomposed in one call


class JointSplines:
    """The splines of a log for any jerk; joints with the same weights share their algebra.

    Args:
        samples: of successive blocks.
        rate: pieces in a second.
        weights: (N, J) of every block.
        once: (N, J) the weights without outliers; see `once_weights`.

    """

    def __init__(
        self,
        samples: Sequence[JointSamples],
        rate: float,
        weights: Sequence[Array],
        once: Sequence[Array],
    ) -> None:
        self.rate, self._samples, self._weights, self._once = rate, samples, weights, once
        groups = dict[bytes, int]()
        columns = zip(*(w.T for w in weights), strict=True)
        keys = [b"".join(w.tobytes() for w in column) for column in columns]
        self._group = np.array([groups.setdefault(key, len(groups)) for key in keys], dtype=int)
        self._blocks = _block_rows(samples, rate, weights, self._group)
        self._a2 = np.concatenate([block.a**2 for block in self._blocks], axis=1)
        is_first = [True, *(a.end < b.start for a, b in pairwise(samples))]  # behind a gap
        self._is_first, self._is_last = is_first, [*is_first[1:], True]
        self._left2 = np.sum([block.left2 for block in self._blocks], axis=0)
        self._volume = -2 * np.sum(np.log(np.concatenate(weights)), axis=0)
        self._volume += sum(block.volume for block in samples)
        # ν + n − d, with ORDER unknowns of every part without a jerk
        samples_once = np.sum(np.concatenate(once) ** 2, axis=0)
        self._freedom = DECLARED_COUNT + np.maximum(samples_once - ORDER * sum(is_first), 0.0)

    @property
    def steps(self) -> dict[str, float]:
        """Usual time between two samples [s] of the sensors without steps."""
        times = [(name, t) for each in self._samples for name, t in each.times.items()]
        names = dict.fromkeys(name for name, t in times if len(t) > 1)
        return {
            n: float(np.median(np.concatenate([np.diff(t) for name, t in times if name == n])))
            for n in names
        }

    def of(self, processes: Mapping[str, Process]) -> "JointSplines":
        """Return the splines with other noise."""
        samples = [each.with_processes(processes) for each in self._samples]
        return JointSplines(samples, self.rate, self._weights, self._once)

    def least_about(self, u: Array) -> float:
        """Return the least −2 log(evidence) of all joints near u = log λ (J,), or smoother."""
        near = self._values(u[:, None] + 3.0 * np.arange(-4, 2))
        return float(near.min(axis=1, initial=np.inf).sum())

    @cached_property
    def on_grid(self) -> Array:
        """−2 log(evidence) (J, G) on the grid of u = log λ."""
        return self._values(np.tile(_GRID, (len(self._freedom), 1)))

    def best(self) -> Array:
        """Return u = log λ (J,).

        The smoothest u of a grid that is not much worse than the best one; then parabolas.
        """
        values = self.on_grid
        u: Array = _GRID[np.argmax(values < values.min(axis=1)[:, None] + ENOUGH, axis=1)]
        for step in (0.75, 0.1):
            at = u[:, None] + step * np.arange(-4, 5)
            values = self._values(at)
            k = np.clip(np.argmin(values, axis=1), 1, 7)[:, None]
            a, b, c = (np.take_along_axis(values, k + i, 1)[:, 0] for i in (-1, 0, 1))
            # the vertex of the parabola through three values
            shift = 0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12)
            u = np.take_along_axis(at, k, 1)[:, 0] + step * np.clip(shift, -1, 1)
        return u

    def solved(self, u: Array) -> tuple[list[Array], Array, Array]:
        """Return coefficients (K, J) of each block, noise and roughness (J,), at u = log λ (J,).

        The roughness is the largest jerk of a block, as a multiple of its size. It is the root of
        the mean square of as many entries as the samples show (MacKay 1992).
        """
        lambdas, joints = np.exp(u), np.arange(len(u))[:, None]
        chain = list(self._chain(self._group, lambdas, joints))
        S = self._left2 + sum(R[:, -1, -1] ** 2 for R in chain)
        coefficients, roughness = list[Array](), np.ones(len(u))
        # f² = (ν + S) / (ν + n − d)
        noise = np.sqrt((DECLARED_COUNT + S) / self._freedom)
        x: Array = np.empty((0, ORDER, 1))
        blocks = zip(self._blocks[::-1], chain[::-1], self._is_last[::-1], strict=True)
        for block, R, is_last in blocks:
            if is_last:
                x = np.asarray(
                    np.linalg.solve(R[:, ORDER:_EDGES, ORDER:_EDGES], R[:, ORDER:_EDGES, -1:])
                )
            # R_vv v/√λ + R_vx x = y
            rest = R[:, :ORDER, -1:] - R[:, :ORDER, ORDER:_EDGES] @ x
            v = np.sqrt(lambdas)[:, None, None] * np.linalg.solve(R[:, :ORDER, :ORDER], rest)
            z, c = block.coefficients(self._group, lambdas, np.concatenate([v, x], axis=1))
            x = c[:, :ORDER]
            coefficients.append(c[..., 0].T)
            # |z|² + |v|² over λ f² and their γ = 3 + Σ λ a² / (1 + λ a²) entries that samples show
            weight = lambdas[:, None] * block.a[self._group] ** 2
            square = np.sum(z**2, axis=(1, 2)) + np.sum(v**2, axis=(1, 2))
            square /= lambdas * noise**2 * (ORDER + np.sum(weight / (1 + weight), axis=1))
            roughness = np.maximum(roughness, np.sqrt(square))
        return coefficients[::-1], noise, roughness

    def residuals(self, coefficients: Sequence[Array]) -> list[Array]:
        """Return what coefficients (K, J) leave of the samples (N, J) of each block."""
        blocks = zip(self._samples, self._blocks, coefficients, strict=True)
        return [samples.values - block.A @ c for samples, block, c in blocks]

    def _values(self, u: Array) -> Array:
        """Return −2 log(evidence) (J, G) at u = log λ (J, G)."""
        joint = np.repeat(np.arange(len(u)), u.shape[1])
        # A complex number for each pair of a group and u, so that each pair is computed once.
        pairs, which = np.unique(self._group[joint] + 1j * u.ravel(), return_inverse=True)
        group, lambdas = pairs.real.astype(int), np.exp(pairs.imag)
        place = _ranks(which)
        joints = np.zeros((len(pairs), place.max(initial=0) + 1), dtype=int)
        joints[which, place] = joint
        squares, sizes = list[Array](), list[Array]()
        chain = self._chain(group, lambdas, joints)
        for R, is_last in zip(chain, self._is_last, strict=True):
            squares.append(R[:, _EDGES:, _EDGES:])
            # of v, and of x where no block continues it
            sizes.append(np.diagonal(R, axis1=1, axis2=2)[:, : _EDGES if is_last else ORDER])
        S = np.sum(np.concatenate(squares, axis=1) ** 2, axis=1)[which, place] + self._left2[joint]
        # log det of v/√λ and x, and of z: Σ log(1 + λ a²)
        volume = 2 * np.sum(np.log(np.abs(np.concatenate(sizes, axis=1))), axis=1)
        volume += np.sum(np.log1p(lambdas[:, None] * self._a2[group]), axis=1)
        values = (
            self._freedom[joint] * np.log(DECLARED_COUNT + S) + volume[which] + self._volume[joint]
        )
        return np.asarray(values.reshape(u.shape))

    def _chain(self, group: Indices, lambdas: Array, joints: Indices) -> Iterator[Array]:
        """Yield what each block and those before it tell: R (U, n, n) of v/√λ, x and targets.

        Args:
            group: (U,) of joints.
            lambdas: (U,) λ.
            joints: (U, P) of these groups, whose targets are the last columns.

        """
        root = np.sqrt(lambdas)[:, None, None]
        n = _EDGES + joints.shape[1]
        before = np.zeros((len(group), ORDER, n - ORDER))
        for block, is_first in zip(self._blocks, self._is_first, strict=True):
            m = block.a.shape[1]
            rows = np.zeros((len(group), max(ORDER + _EDGES + m + ORDER, n), n))
            # v/√λ = 0; then x at the start, as the blocks before tell it; then the samples.
            rows[:, :ORDER, :ORDER] = np.eye(ORDER)
            if not is_first:
                rows[:, ORDER:_EDGES, :_EDGES] = before[..., :ORDER] @ block.start
                rows[:, ORDER:_EDGES, _EDGES:] = before[..., ORDER:]
            samples = rows[:, _EDGES : 2 * _EDGES + m]
            samples[..., :_EDGES] = block.edges[group]
            samples[..., _EDGES:] = np.swapaxes(block.targets[joints], 1, 2)
            samples[:, :m] /= np.hypot(1.0, root * block.a[group][..., None])
            rows[:, ORDER:, :ORDER] *= root
            R = triangles(rows)
            before = R[:, ORDER:_EDGES, ORDER:]
            yield R


@dataclass(frozen=True, eq=False)
class _BlockRows:
    """The samples of a block as rows a z + E (v, x) = y; the last 6 of them have no z.

    Attributes:
        A: (N, K) rows of the coefficients, in units of σ.
        T: (K, K) with c = T (z, v, x) before z is turned.
        turn: (g, m, m) of z, for g groups of joints.
        a: (g, m).
        edges: (g, m + 6, 6) E.
        targets: (J, m + 6) y.
        left2: (J,) squares that no coefficients explain.

    """

    A: Array
    T: Array
    turn: Array
    a: Array
    edges: Array
    targets: Array
    left2: Array

    @property
    def start(self) -> Array:
        """(3, 6) the state at the start by v and x."""
        return self.T[:ORDER, -_EDGES:]

    def coefficients(self, group: Indices, lambdas: Array, edges: Array) -> tuple[Array, Array]:
        """Return z (J, m, 1), turned back, and c (J, K, 1) at λ (J,), with v and x (J, 6, 1)."""
        a, factor = self.a[group][..., None], lambdas[:, None, None]
        m = a.shape[1]
        # z = λ a / (1 + λ a²) (y − E (v, x))
        rest = self.targets[:, :m, None] - self.edges[group, :m] @ edges
        z = self.turn[group] @ (factor * a / (1 + factor * a**2) * rest)
        return z, np.asarray(self.T @ np.concatenate([z, edges], axis=1))


def _block_rows(
    samples: Sequence[JointSamples], rate: float, weights: Sequence[Array], group: Indices
) -> list[_BlockRows]:
    """Return the rows of samples of weights (N, J) in successive blocks."""
    blocks = list[_BlockRows]()
    pairs = zip(samples, weights, strict=True)
    for pieces, run in groupby(pairs, lambda pair: pair[0].pieces(rate)):
        alike = list(run)
        for first in range(0, len(alike), _TOGETHER):
            blocks += _alike_rows(alike[first : first + _TOGETHER], pieces, group)
    return blocks


def _alike_rows(
    blocks: Sequence[tuple[JointSamples, Array]], pieces: int, group: Indices
) -> Iterator[_BlockRows]:
    """Yield the rows of blocks, samples and weights (N, J), with as many pieces."""
    A = [samples.design(pieces) for samples, _ in blocks]
    T = [edge_coordinates(samples.length, pieces) for samples, _ in blocks]
    K, N = len(T[0]), max(len(rows) for rows in A)
    first, place = np.unique(group, return_index=True)[1], _ranks(group)
    n = K + place.max(initial=0) + 1
    rows = np.zeros((len(blocks), len(first), max(N, n), n))
    for block, (samples, w), A_b, T_b in zip(rows, blocks, A, T, strict=True):
        plain = w[:, first, None] * (A_b @ T_b)[:, None]
        block[:, : len(w), :K] = np.swapaxes(samples.white(plain), 0, 1)
        block[group, : len(w), K + place] = samples.white(w * samples.values).T
    # A T (z, v, x) = y as a triangle; z = Vᵀ z' with R_zz = U a Vᵀ
    R, m = triangles(rows), K - _EDGES
    U, a, turn = np.linalg.svd(R[..., :m, :m])
    R[..., :m, m:] = np.swapaxes(U, -1, -2) @ R[..., :m, m:]
    targets = np.moveaxis(R[:, group, :, K + place], 0, 1)
    left2 = np.sum(targets[..., K:] ** 2, axis=-1)
    turn, edges = np.swapaxes(turn, -1, -2), R[..., :K, m:K]
    yield from map(_BlockRows, A, T, turn, a, edges, targets[..., :K], left2)


def _ranks(group: Indices) -> Indices:
    """Return how many equal entries are before each entry."""
    order = np.argsort(group, kind="stable")
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    return ranks
