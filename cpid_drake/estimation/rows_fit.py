"""Least squares on the momentum rows of a log: what they tell about the target, as a Gaussian.

The rows A x = b of a log are linear in the target's unknowns and in the log's own momentum. All of
them weigh the same. Their errors come from the errors of the samples, and are inside A as well:

- their size and their correlation in time are those of the residuals (Newey and West 1987, "A
  simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
  matrix");
- errors δA inside A add E[δAᵀ δA] to AᵀA, which looks like information, and a bias of
  −(AᵀA)⁻¹ E[δAᵀ (δA x − δb)]. The shape of this expectation follows from the errors of the samples.
  The bias is subtracted, and is also a σ, because its size is known roughly only; a combination of
  whose information more than a quarter is noise is left out (Fuller 1987, Measurement Error Models,
  ch. 1 and 2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.evidence import compare
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import (
    DEFAULT_RANK_TOLERANCE,
    triangle,
    updated_information,
)
from cpid_drake.estimation.momentum_rows import error_square, momentum_columns, momentum_rows
from cpid_drake.estimation.unknowns import WIDE
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.logs.log import Samples, concatenated_samples

TARGET, MOMENTUM = "target", "momentum"
"""The unknowns of a log's Gaussian."""

FEWEST = 20
"""Number of independent residuals from which on they show their correlation in time."""

ROUNDING = 1e-8
"""Least size of the errors of rows, as a share of the rows: less is rounding."""

_SAMPLES_AT_ONCE = 2048  # samples of a part, whose arrays fit into a processor's cache
_MOST_KEPT = 20_000  # samples whose rows are kept for the residuals and their correlation in time
_MOST_CHANGED = 200  # complete samples of a block that show the shape of its errors
_NOISE = 0.25  # share of the information about a combination that may be noise
_ROUNDS = 4  # of the size of the errors, which depends on the solution


@dataclass(frozen=True, eq=False)
class RowNoise:
    """The errors of the rows of a log.

    Attributes:
        variance: their variance.
        correlation_time: number of samples with the information of one independent sample.
        factor: `variance` divided by that of the errors of the samples; 0 if these are not known.
        scatter: (k + 10, k + 10) covariance of Aᵀ (A x − b), from sums of residuals over successive
            samples that are correlated. It contains what the variance misses, such as errors that
            grow with the motion, or differ from row to row. None if there are no more rows than
            unknowns, so that no residuals show the errors.

    """

    variance: float = 1.0
    correlation_time: float = 1.0
    factor: float = 0.0
    scatter: NDArray[np.float64] | None = None


class LogRows:
    """The rows of one log, added part by part.

    Args:
        tree: the known bodies.
        family: the row family.
        momentum: the momentum, for `momentum_rows`.

    Attributes:
        extra: number k of columns of a momentum.
        sample_count: number of samples.
        row_count: number of rows without rows of zeros.

    """

    def __init__(self, tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> None:
        self._problem = tree, family, momentum
        self.extra = momentum_columns(tree, family, momentum)
        self._angular = 3 if tree.normal_B is None else 1  # angular rows of a sample
        size = self.extra + 10
        self._halves = [np.zeros((size + 1, size + 1)) for _ in range(2)]  # of all parts
        self._errors = np.zeros((size + 1, size + 1))  # E[δᵀ δ] of the errors of the rows
        self._kept: list[Samples] = []  # every k-th part, for residuals and their correlation
        self._parts, self._every = 0, 1
        self._p_WB = np.zeros(3)  # at the first sample
        self.sample_count = self.row_count = 0

    @property
    def form(self) -> Parameterization:
        """The parameterization of the target's unknowns."""
        tree, family, _ = self._problem
        return family.parameterization(tree.mass)

    @property
    def momenta(self) -> NDArray[np.intp]:
        """Places (k,) of the unknowns of a momentum in [L; P]."""
        tree, family, _ = self._problem
        return np.arange(self.extra) if tree.normal_B is None else family.momenta_in_plane()

    def about_base(self) -> NDArray[np.float64]:
        """Return the unknowns (k + 10, k + 10) by those with L about the base's first place."""
        whole = np.eye(6)
        whole[:3, 3:] = skew(self._p_WB)
        result = np.eye(self.extra + 10)
        result[: self.extra, : self.extra] = whole[np.ix_(self.momenta, self.momenta)]
        return result

    def add(self, telemetry: Motion, covariance: NDArray[np.float64]) -> None:
        """Add samples.

        Args:
            telemetry: the motion at N instants.
            covariance: (N, q, q) of the errors of each sample as changes of the q quantities of
                `momentum_rows.changed`, or (1, q, q) if it is the same for all.

        """
        if not self.sample_count and len(telemetry):
            self._p_WB = telemetry.p_WB[0]
        tree, family, momentum = self._problem
        for start in range(0, len(telemetry), _SAMPLES_AT_ONCE):
            own = slice(start, min(start + _SAMPLES_AT_ONCE, len(telemetry)))
            part, C = telemetry.select(own), covariance[own] if len(covariance) > 1 else covariance
            flat = momentum_rows(tree, part, family, momentum)
            rows = flat.reshape(len(part), -1, flat.shape[1])
            for k, half in enumerate(np.split(rows, [len(rows) // 2])):
                half = half.reshape(-1, flat.shape[1])
                self._halves[k] = updated_information(self._halves[k], half)
            self.row_count += int(np.count_nonzero(flat[:, self.extra :].any(axis=1)))
            self.sample_count += len(rows)
            if C.any():
                some = slice(None, None, -(-len(rows) // _MOST_CHANGED))
                few = part.select(some)
                square = error_square(few, C[some], *self._problem)
                self._errors += len(rows) / len(few) * square
            if self._parts % self._every == 0:
                self._kept.append(Samples(part.time, rows))
            self._parts += 1
            while sum(map(len, self._kept)) > _MOST_KEPT and len(self._kept) > 1:
                self._kept, self._every = self._kept[::2], 2 * self._every

    def best(self) -> NDArray[np.float64]:
        """Return the unknowns (k + 10,) with the least residuals."""
        rows = np.vstack(self._halves)
        return Gaussian.of_rows({TARGET: rows.shape[1] - 1}, rows).solve()

    def misfit(self, x: NDArray[np.float64]) -> tuple[float, float]:
        """Return the sizes of the residuals at unknowns x (k + 10,), as ratios.

        The first is that to the errors of the samples, infinite if these are not known, and the
        second that to the rows.
        """
        unit, rows = np.append(x, -1.0), np.vstack(self._halves)
        squares, expected = float(np.sum((rows @ unit) ** 2)), float(unit @ self._errors @ unit)
        size = float(np.sum(rows[:, -1] ** 2))
        return (
            float(np.sqrt(squares / expected)) if expected > 0 else np.inf,
            float(np.sqrt(squares / size)) if size > 0 else 0.0,
        )

    def residuals(self, x: NDArray[np.float64]) -> tuple[Samples, Samples]:
        """Return the residuals b − A x at x of the linear and of the angular rows.

        Of a long log, they are those of parts that are spread over it.
        """
        kept = concatenated_samples(self._kept)
        rest = -(kept.value @ np.append(x, -1.0))
        linear, angular = np.split(rest, [rest.shape[1] - self._angular], axis=1)
        return Samples(kept.time, linear), Samples(kept.time, angular)

    def noise(self, *, is_zero: bool = False) -> RowNoise:
        """Return the errors of the rows, from the residuals at their best unknowns.

        Args:
            is_zero: whether the momentum is zero; else it is free.

        """
        first = self.extra if is_zero else 0
        root = triangle(np.vstack(self._halves))
        size = float(np.sum(root[:, -1] ** 2))
        least = max(ROUNDING**2 * size / max(self.row_count, 1), 1e-300)
        noise = RowNoise(least)
        for _ in range(_ROUNDS):
            rows, used = self._compressed(noise, first=first)
            x = Gaussian.of_rows({TARGET: rows.shape[1] - 1}, rows).solve()
            unit = np.concatenate([np.zeros(first), x, [-1.0]])
            free = self.row_count - used
            if free < 1:
                return noise
            rests = np.concatenate([part.value @ unit for part in self._kept])
            time = whiteness(rests).correlation_time
            if self.row_count / time - used < FEWEST:
                time = 1.0
            # Residuals are smaller than errors by what the unknowns take of them.
            larger = self.row_count / (self.row_count - time * used)
            squares, expected = np.sum((root @ unit) ** 2), float(unit @ self._errors @ unit)
            variance = larger * float(squares) / self.row_count
            factor = variance * self.row_count / expected if expected > 0 else 0.0
            scatter = larger * self._scatter(rests, time)
            noise = RowNoise(max(variance, least), time, factor, scatter)
            if not factor:  # without errors inside A, the solution does not depend on their size
                break
        return noise

    def _scatter(self, rests: NDArray[np.float64], time: float) -> NDArray[np.float64]:
        """Return `RowNoise.scatter`, from residuals (N, m) with a correlation time in samples.

        It is that of independent rows with the errors of each of a sample's m rows, and larger
        where sums of successive rows show more.
        """
        A = np.concatenate([part.value[..., :-1] for part in self._kept])
        flat = (A * np.sqrt(time * np.mean(rests**2, axis=0))[:, None]).reshape(-1, A.shape[-1])
        scores = np.einsum("nmc,nm->nc", A, rests)
        starts = np.arange(0, len(scores), int(np.ceil(time)))
        sums = np.add.reduceat(scores, starts, axis=0)
        norms = np.linalg.norm(flat, axis=0)
        norms[norms == 0] = 1.0
        _, s, Vt = np.linalg.svd(triangle(flat / norms))
        seen = s > DEFAULT_RANK_TOLERANCE * s[:1]
        by_root = sums / norms @ (Vt[seen] / s[seen, None]).T
        sizes, turn = np.linalg.eigh(by_root.T @ by_root)
        root = norms * (
            np.sqrt(np.maximum(sizes, 1.0))[:, None] * turn.T @ (s[seen, None] * Vt[seen])
        )
        return np.asarray(self.sample_count / len(scores) * root.T @ root)

    def gaussians(self, noise: RowNoise, *, is_zero: bool = False) -> tuple[Gaussian, Gaussian]:
        """Return what all rows, and what the first half, tell about momentum and ten unknowns.

        Their costs are counted from the minimum of their own rows.

        Args:
            noise: the errors of the rows.
            is_zero: whether the momentum is zero; it is then not in the result.

        """
        found, k = [], 0 if is_zero else self.extra
        for is_half in (False, True):
            rows = self._compressed(noise, is_half=is_half, first=self.extra - k)[0]
            found.append(Gaussian.of_rows({MOMENTUM: k, TARGET: 10}, rows))
        return found[0], found[1]

    def _compressed(
        self, noise: RowNoise, *, is_half: bool = False, first: int = 0
    ) -> tuple[NDArray[np.float64], int]:
        """Return the rows of `without_bias` of all rows, or of the first half.

        The unknowns before the first one are zero.
        """
        weight, share = (
            1 / np.sqrt(noise.variance * noise.correlation_time),
            0.5 if is_half else 1.0,
        )
        flat = weight * np.vstack(self._halves[: 1 if is_half else 2])
        E = share * weight**2 * noise.factor * self._errors
        scatter = None
        if noise.scatter is not None:
            scatter = share * weight**4 * noise.scatter[first:, first:]
        return without_bias(flat[:, first:], E[first:, first:], scatter)


def without_bias(
    rows: NDArray[np.float64], E: NDArray[np.float64], scatter: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], int]:
    """Return rows (r, c + 1) with independent errors of unit size and without bias.

    The second result is the number of unknowns that the rows determine.

    Args:
        rows: (n, c + 1) rows [A | b] with errors of unit size.
        E: (c + 1, c + 1) expectation of δᵀ δ for their errors δ.
        scatter: (c, c) covariance of Aᵀ (A x − b), if it is not AᵀA.

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
    whiten = axes = Q.T[shares < _NOISE]
    if scatter is not None:
        sizes, turn = np.linalg.eigh(axes @ X.T @ scatter @ X @ axes.T)
        whiten = turn.T @ axes / np.sqrt(np.maximum(sizes, ROUNDING))[:, None]
    left = whiten - whiten @ X.T @ E[:-1, :-1] @ X
    right = whiten @ (y - X.T @ E[:-1, -1])
    # The bias, times an unknown of unit σ, is eliminated.
    table = np.zeros((len(left) + 1, A.shape[1] + 2))
    table[0, 0] = 1.0
    table[1:, 0], table[1:, -1] = right - left @ y, right
    table[1:, 1:-1] = left @ (s[:, None] * Vt * scale)
    return triangle(table)[1 : len(table), 1:], int(seen.sum())


def compare_momentum(
    rows: LogRows, noise: RowNoise, sigma: NDArray[np.float64], size: NDArray[np.float64]
) -> tuple[float, Gaussian, dict[str, NDArray[np.float64]]]:
    """Compare a momentum of zero with an unknown one.

    The result is the probability of a momentum, the average of the target (see `evidence`), and the
    fields of the momentum in an identification.

    Args:
        rows: of a log, with columns of an unknown momentum.
        noise: their errors.
        sigma: (6,) of an unknown momentum [L; P] about the base's first place.
        size: (10,) plausible sizes of the target's unknowns.

    """
    free, to_origin, k = rows.gaussians(noise)[0], rows.about_base(), rows.extra
    own = sigma[rows.momenta]
    vague = np.append(1 / np.append(own, WIDE * size), 0.0)
    table = np.vstack([np.column_stack([free.R @ to_origin, free.z]), np.diag(vague)[:-1]])
    both = Gaussian.of_rows(free.sizes, table)
    found = compare(both, {MOMENTUM: own}, [TARGET], odds={MOMENTUM: 1.0})
    to_origin = to_origin[:k, :k]
    covariance = found.covariance.get(MOMENTUM, np.zeros((k, k)))
    fields = {
        "momentum_estimate": to_origin @ found.values.get(MOMENTUM, np.zeros(k)),
        "momentum_covariance": to_origin @ covariance @ to_origin.T,
    }
    return found.probability[MOMENTUM], found.gaussian, fields
