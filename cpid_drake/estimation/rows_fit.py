"""Least squares on the momentum rows of a log: what they tell about the target, as a Gaussian.

The rows A x = b of a log are linear in the target's unknowns and in the log's own momentum. Their
errors come from the errors of the samples, and are inside A as well (`noisy_rows`). Here

- their shape follows from the errors of the samples, by finite differences; of smoothed samples,
  whose errors are known, it is also the weight of the rows;
- their size and their correlation in time are those of the residuals (Newey and West 1987, "A
  simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
  matrix");
- the bias is subtracted, and is also a σ, because its size is known roughly only; a combination of
  whose information more than a quarter is noise is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.evidence import compare
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import (
    empty_information,
    triangle,
    updated_information,
)
from cpid_drake.estimation.momentum_rows import momentum_columns, row_blocks, row_derivatives
from cpid_drake.estimation.noisy_rows import (
    LEAST_SHARE,
    expected_square,
    row_weights,
    without_bias,
)
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.smoothed_motion import ErrorBlock
from cpid_drake.sensing.thinning import EvenSelection

TARGET, MOMENTUM = "target", "momentum"
"""The unknowns of a log's Gaussian."""

ROUNDING = 1e-8
"""Least size of the errors of rows, as a share of the rows: less is rounding."""

_MOST_KEPT = 20_000  # samples whose residuals are kept for their correlation in time
_MOST_SHOWN = 4_000  # samples of a long log that a page shows
_MOST_CHANGED = 200  # complete samples of a block that show the shape of its errors
_FEWEST = 20  # independent residuals that determine their correlation
_NOTHING = 1e-12  # size of combinations that have no effect, as a share of the columns
_ROUNDS = 4  # of the size of the errors, which depends on the solution


@dataclass(frozen=True, eq=False)
class RowNoise:
    """The errors of the weighted rows of a log.

    Attributes:
        variance: their variance.
        correlation_time: number of samples with the information of one independent sample.
        factor: `variance` divided by that of the errors of the samples; 0 if these are not known.
        is_known: whether there are more rows than unknowns, so that residuals show the errors.
        scatter: (3, k + u, k + u) covariance of Aᵀ (A x − b), for all rows and for each half; None
            if it is not known. Of smoothed samples it is that of the splines' errors, else of sums
            of the residuals over successive samples that are correlated. It contains what the
            variance misses, such as errors that grow with the motion.
        least: least size of the scatter, in units of `variance` and `correlation_time`.

    """

    variance: float = 1.0
    correlation_time: float = 1.0
    factor: float = 0.0
    is_known: bool = False
    scatter: NDArray[np.float64] | None = None
    least: float = 1.0


class LogRows:
    """The rows of one log, added part by part.

    Args:
        tree: the known bodies.
        family: the row family.
        momentum: the momentum, for `momentum_rows`.

    Attributes:
        extra: number k of columns of a momentum.
        unknowns: places of the rows' u unknowns among the target's ten.
        sample_count: number of samples.
        row_count: number of rows without rows of zeros.

    """

    def __init__(self, tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> None:
        self._problem = tree, family, momentum
        self.extra, self.unknowns = momentum_columns(tree, family, momentum), tree.unknowns
        self._angular = 3 if tree.normal_B is None else 1  # angular rows of a sample
        size = self.extra + len(self.unknowns)
        self._plain = empty_information(size)
        self._halves = [empty_information(size), empty_information(size)]  # weighted, of all parts
        self._errors = np.zeros((size + 1, size + 1))  # E[δᵀ δ] of the errors of weighted rows
        self._spread: NDArray[np.float64] | None = None  # `RowNoise.scatter` of smoothed samples
        self._first: list[Samples] = []  # rows, and below them weighted rows
        self._shown = EvenSelection(_MOST_SHOWN)
        self._p_WB = np.zeros(3)  # at the first sample
        self.sample_count = self.row_count = 0

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

    def add(
        self,
        telemetry: Telemetry,
        covariance: NDArray[np.float64],
        errors: Sequence[ErrorBlock] = (),
    ) -> None:
        """Add samples.

        Args:
            telemetry: the motion at N instants.
            covariance: (N, q, q) of the errors of each sample as changes of the q quantities of
                `momentum_rows.changed`, or (1, q, q) if it is the same for all.
            errors: of smoothed samples, the independent parts of these errors.

        """
        if not self.sample_count and len(telemetry):
            self._p_WB = telemetry.p_WB[0]
        for own, rows in row_blocks(telemetry, *self._problem):
            flat = rows.reshape(-1, rows.shape[-1])
            self._plain = updated_information(self._plain, flat)
            self.row_count += int(np.count_nonzero(flat[:, self.extra :].any(axis=1)))
            white, middle = rows, len(rows) // 2
            if covariance.any():
                C = covariance[own] if len(covariance) > 1 else covariance
                every = 1 if errors else -(-len(rows) // _MOST_CHANGED)
                part = telemetry.select(own).select(slice(None, None, every))
                derivatives = row_derivatives(part, *self._problem)
                if errors:
                    x, weights = row_weights(rows, derivatives, C)
                    white, derivatives = weights @ rows, weights @ derivatives
                    self._add_spread(white, derivatives @ np.append(x, -1.0), own, errors)
                self._errors += len(rows) / len(part) * expected_square(derivatives, C)
            for k, half in enumerate((white[:middle], white[middle:])):
                if half.size:
                    flat = half.reshape(-1, half.shape[-1])
                    self._halves[k] = updated_information(self._halves[k], flat)
            kept = Samples(telemetry.time[own], np.concatenate([rows, white], axis=1))
            kept = kept.where(slice(0, max(_MOST_KEPT - self.sample_count, 0)))
            self._first += [kept] if len(kept) else []
            self._shown.add(Samples(telemetry.time[own], rows))
            self.sample_count += len(rows)

    def _add_spread(
        self,
        white: NDArray[np.float64],
        effects: NDArray[np.float64],
        own: slice,
        errors: Sequence[ErrorBlock],
    ) -> None:
        """Add to the scatter the effects of the errors of splines.

        The error of one coefficient enters many samples: its effects are summed before squaring.
        """
        A, middle = white[..., :-1], len(white) // 2
        effects = np.moveaxis(effects, 0, -1)
        if self._spread is None:
            self._spread = np.zeros((3, A.shape[-1], A.shape[-1]))
        for block in errors:
            effect = np.swapaxes(effects[:, :, block.columns] @ block.basis[own], -1, -2) @ A
            gains = np.zeros((3, len(block.covariance), A.shape[-1]))
            for k, half in ((1, slice(0, middle)), (2, slice(middle, None))):
                np.add.at(gains[k], block.support[own][half], effect[half])
            gains[0] = gains[1] + gains[2]
            self._spread += np.swapaxes(gains, -1, -2) @ block.covariance @ gains

    def misfit(self, x: NDArray[np.float64]) -> tuple[float, float]:
        """Return the sizes of the residuals at unknowns x (k + u,), as ratios.

        The first is that of the weighted residuals to the errors of the samples, infinite if these
        are not known, and the second that of the residuals to the rows.
        """
        unit = np.append(x, -1.0)
        squares = sum(float(np.sum((half @ unit) ** 2)) for half in self._halves)
        expected = float(unit @ self._errors @ unit)
        size = float(np.sum(self._plain[:, -1] ** 2))
        rest = float(np.sum((self._plain @ unit) ** 2))
        return (
            float(np.sqrt(squares / expected)) if expected > 0 else np.inf,
            float(np.sqrt(rest / size)) if size > 0 else 0.0,
        )

    def residual_sum(self, x: NDArray[np.float64]) -> float:
        """Return the sum of squares of the residuals, without weights, at x (k + u,)."""
        return float(np.sum((self._plain @ np.append(x, -1.0)) ** 2))

    def residuals(self, x: NDArray[np.float64]) -> list[tuple[Samples, int, NDArray[np.float64]]]:
        """Return the residuals b − A x at x of the linear and of the angular rows.

        Each with the number k of which every k-th is shown, and the first ones without selection.
        """
        shown, unit = self._shown.samples(), np.append(x, -1.0)
        if shown is None:
            return []
        m = shown.value.shape[1]
        linear, angular = slice(0, m - self._angular), slice(m - self._angular, m)
        first = np.concatenate([-(part.value[:, :m] @ unit) for part in self._first])
        every, time, value = self._shown.every, shown.time, -(shown.value @ unit)
        if self.sample_count <= _MOST_KEPT:
            every, time, value = 1, np.concatenate([part.time for part in self._first]), first
        return [(Samples(time, value[:, k]), every, first[:, k]) for k in (linear, angular)]

    def noise(self, *, is_zero: bool = False) -> RowNoise:
        """Return the errors of the weighted rows, from the residuals at their best unknowns.

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
            rests = [part.value[:, part.value.shape[1] // 2 :] @ unit for part in self._first]
            time = whiteness(np.concatenate(rests)).correlation_time
            if self.row_count / time - used < _FEWEST:
                time = 1.0
            # Residuals are smaller than errors by what the unknowns take of them.
            larger = self.row_count / (self.row_count - time * used)
            squares, expected = np.sum((root @ unit) ** 2), float(unit @ self._errors @ unit)
            variance = larger * float(squares) / self.row_count
            factor = variance * self.row_count / expected if expected > 0 else 0.0
            noise = RowNoise(max(variance, least), time, factor, True)
            if self._spread is not None:
                factor = max(factor, 1.0)  # the errors of the samples are known
                scatter = factor * self._spread
                noise = replace(noise, factor=factor, scatter=scatter, least=LEAST_SHARE)
            else:
                noise = replace(noise, scatter=self._scatter(rests, int(np.ceil(time)), larger))
        return noise

    def _scatter(
        self, rests: Sequence[NDArray[np.float64]], length: int, larger: float
    ) -> NDArray[np.float64]:
        """Return `RowNoise.scatter`, from residuals that are correlated over some samples."""
        white = [part.value[:, part.value.shape[1] // 2 :, :-1] for part in self._first]
        scores = np.concatenate(
            [np.einsum("nmc,nm->nc", A, r) for A, r in zip(white, rests, strict=True)]
        )
        sums = np.add.reduceat(scores, np.arange(0, len(scores), length), axis=0)
        scatter = larger * self.sample_count / len(scores) * sums.T @ sums
        return np.array([scatter, scatter / 2, scatter / 2])

    def gaussians(
        self, noise: RowNoise, *, is_zero: bool = False
    ) -> tuple[Gaussian, Gaussian, Gaussian]:
        """Return what all rows tell, and what each half tells, about the momentum and ten unknowns.

        Their costs are counted from the minimum of their own rows.

        Args:
            noise: the errors of the rows.
            is_zero: whether the momentum is zero; it is then not in the result.

        """
        found, k = [], 0 if is_zero else self.extra
        for part in range(3):
            rows = self._compressed(noise, part, self.extra - k)[0]
            whole = np.zeros((len(rows), k + 11))
            whole[:, :k], whole[:, -1] = rows[:, :k], rows[:, -1]
            whole[:, k + self.unknowns] = rows[:, k:-1]
            found.append(Gaussian.of_rows({MOMENTUM: k, TARGET: 10}, whole))
        return found[0], found[1], found[2]

    def _compressed(
        self, noise: RowNoise, part: int = 0, first: int = 0
    ) -> tuple[NDArray[np.float64], int]:
        """Return the rows of `without_bias` of all rows, or of one half (1 or 2).

        The unknowns before the first one are zero.
        """
        weight = 1 / np.sqrt(noise.variance * noise.correlation_time)
        flat = weight * np.vstack(self._halves[part - 1 : part] if part else self._halves)
        E = (0.5 if part else 1.0) * weight**2 * noise.factor * self._errors
        scatter = None
        if noise.scatter is not None:
            scatter = weight**4 * noise.scatter[part][first:, first:]
        return without_bias(flat[:, first:], E[first:, first:], scatter, noise.least)


@dataclass(frozen=True, eq=False)
class MomentumComparison:
    """What the comparison of zero with an unknown momentum says.

    Attributes:
        probability: of a momentum.
        target: the target, averaged over zero and a momentum.
        momentum: (k,) the momentum, in the rows' unknowns.
        covariance: (k, k) of the momentum.

    """

    probability: float
    target: Gaussian
    momentum: NDArray[np.float64]
    covariance: NDArray[np.float64]


def compare_momentum(
    rows: LogRows, noise: RowNoise, sigma: NDArray[np.float64]
) -> MomentumComparison | None:
    """Compare a momentum of zero with an unknown one; None if the rows show nothing of the target.

    See `evidence`.

    Args:
        rows: of a log, with columns of an unknown momentum.
        noise: their errors.
        sigma: (6,) of an unknown momentum [L; P] about the base's first place.

    """
    free, zero = rows.gaussians(noise)[0], rows.gaussians(noise, is_zero=True)[0]
    R, k, own = free.R @ rows.about_base(), rows.extra, sigma[rows.momenta]
    scale = np.maximum(np.linalg.norm(R[:, k:], axis=0), np.finfo(float).tiny)
    # What noise hides of the target with zero, it hides with a momentum as well.
    _, sizes, axes = np.linalg.svd(zero.R[:, zero.places[TARGET]] / scale)
    hidden = axes[sizes <= _NOTHING * sizes[0]].T
    U, sizes, _ = np.linalg.svd(R[:, k:] / scale @ hidden)
    clear = U[:, np.sum(sizes > _NOTHING) :].T
    R, z = clear @ R, clear @ free.z
    U, sizes, axes = np.linalg.svd(R[:, k:] / scale)
    count = int(np.sum(sizes > _NOTHING))
    if not count:
        return None
    axes = axes[:count] * scale
    table = np.zeros((k + len(R), k + count + 1))
    table[:k, :k] = np.diag(1 / own)
    table[k:, :k], table[k:, k:-1], table[k:, -1] = R[:, :k], U[:, :count] * sizes[:count], z
    both = Gaussian.of_rows({MOMENTUM: k, TARGET: count}, table)
    found = compare(both, {MOMENTUM: own}, [TARGET], odds={MOMENTUM: 1.0})
    target = found.gaussian
    target = Gaussian.of_rows({TARGET: 10}, np.column_stack([target.R @ axes, target.z]))
    to_origin = rows.about_base()[:k, :k]
    value = to_origin @ found.values.get(MOMENTUM, np.zeros(k))
    root = to_origin * found.sigma.get(MOMENTUM, np.zeros(k))
    return MomentumComparison(found.probability[MOMENTUM], target, value, root @ root.T)


def disagreement(parts: Sequence[Gaussian]) -> tuple[float, int, float]:
    """Return χ², freedom and probability of so large a χ² if all parts have the same unknowns.

    χ² is the least cost with one set of unknowns minus the sum of the least costs of each part.
    Source: Rao 1973, Linear Statistical Inference and Its Applications, ch. 4.
    """
    total = reduce(Gaussian.add, parts)
    chi_squared = max(total.least_cost - sum(each.least_cost for each in parts), 0.0)
    freedom = sum(part.rank for part in parts) - total.rank
    probability = float(chdtrc(freedom, chi_squared)) if freedom else 1.0
    return chi_squared, freedom, probability
