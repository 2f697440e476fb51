"""Least squares on the momentum rows of a log, as a Gaussian of the target.

The rows A x = b of a log are linear in the target's unknowns and in the log's own momentum. All of
them weigh the same, and their errors are as large as the residuals: the covariance is s² (AᵀA)⁻¹.
That is right for exact states. Noise of sensors is inside A as well, which these rows ignore.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import (
    ROUNDING,
    residual_variance,
    triangle,
    updated_information,
)
from cpid_drake.estimation.momentum_rows import error_square, momentum_columns, momentum_rows
from cpid_drake.logs.log import Samples, concatenated_samples

_T = TypeVar("_T")

TARGET, MOMENTUM = "target", "momentum"
"""The unknowns of a log's Gaussian."""

_SAMPLES_AT_ONCE = 2048  # samples of a part, whose arrays fit into a processor's cache
_MOST_KEPT = 20_000  # samples whose rows are kept for the residuals
_MOST_PIECES = 64  # of a log, of which some are about its first half
_MOST_CHANGED = 200  # complete samples of a block that show the shape of its errors


class LogRows:
    """The rows of one log, added part by part.

    Args:
        tree: the spacecraft's bodies.
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
        self._pieces = [np.zeros((size + 1, size + 1))]  # triangles of successive samples
        self._counts = [0]  # of their samples
        self._errors = np.zeros((size + 1, size + 1))  # E[δᵀ δ] of the errors of the rows
        self._kept: list[Samples] = []  # every k-th part, for residuals
        self._parts, self._every = 0, 1
        self.sample_count = self.row_count = 0

    @property
    def form(self) -> Parameterization:
        """The parameterization of the target's unknowns."""
        tree, family, _ = self._problem
        return family.parameterization(tree.mass)

    def add(self, telemetry: Motion, covariance: Array) -> None:
        """Add samples.

        Args:
            telemetry: the motion at N instants.
            covariance: (N, q, q) of the errors of each sample as changes of the q quantities of
                `momentum_rows.changed_motion`, or (1, q, q) if it is the same for all.

        """
        tree, family, momentum = self._problem
        for start in range(0, len(telemetry), _SAMPLES_AT_ONCE):
            chosen = slice(start, min(start + _SAMPLES_AT_ONCE, len(telemetry)))
            part = telemetry.select(chosen)
            C = covariance[chosen] if len(covariance) > 1 else covariance
            flat = momentum_rows(tree, part, family, momentum)
            rows = flat.reshape(len(part), -1, flat.shape[1])
            for half in np.split(rows, [len(rows) // 2]):
                nothing = np.zeros_like(self._pieces[0])
                self._pieces.append(updated_information(nothing, half.reshape(-1, flat.shape[1])))
                self._counts.append(len(half))
            if len(self._pieces) > _MOST_PIECES:
                self._pieces = [triangle(np.vstack(p)) for p in _pairs(self._pieces)]
                self._counts = [sum(counts) for counts in _pairs(self._counts)]
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

    def triangle(self, *, is_zero: bool = False, is_half: bool = False) -> Array:
        """Return the triangle (k + 11, k + 11) of all rows, or of about the first half.

        Args:
            is_zero: whether the momentum is zero; its columns are then left out.
            is_half: whether the rows are those of the first half.

        """
        ends = np.cumsum(self._counts)
        count = int(np.argmin(np.abs(ends - ends[-1] / 2))) + 1 if is_half else len(ends)
        return triangle(np.vstack(self._pieces[:count])[:, self.extra if is_zero else 0 :])

    def best(self, *, is_zero: bool = False) -> Array:
        """Return the unknowns (k + 10,) with the least residuals."""
        T = self.triangle(is_zero=is_zero)
        x = Gaussian.of_rows({TARGET: len(T) - 1}, T).solve()
        return np.append(np.zeros(self.extra + 10 - len(x)), x)

    def gaussian(self, *, is_zero: bool = False) -> tuple[Gaussian, int]:
        """Return the Gaussian of momentum and target, and the residuals' freedom.

        If this is zero or less, no residuals show the errors, which are then those of rounding.
        """
        T = self.triangle(is_zero=is_zero)
        gaussian = Gaussian.of_rows({MOMENTUM: len(T) - 11, TARGET: 10}, T)
        freedom = self.row_count - gaussian.rank
        size = float(np.sum(T[:, -1] ** 2))
        variance = residual_variance(gaussian.least_cost, size, self.row_count, gaussian.rank)
        if freedom < 1:  # residuals show nothing: rounding
            variance = ROUNDING**2 * size / max(self.row_count, 1)
        # rows A x = b / s, with the covariance s² (AᵀA)⁻¹
        s = np.sqrt(max(variance, 1e-300))
        return replace(
            gaussian, R=gaussian.R / s, z=gaussian.z / s, rho2=gaussian.rho2 / s**2
        ), freedom

    def misfit(self, x: Array) -> tuple[float, float]:
        """Return the sizes of the residuals at unknowns x (k + 10,), as ratios.

        The first is that to the errors of the samples, infinite if these are not known, and the
        second that to the rows.
        """
        # |A x − b|², and its mean E |δA x − δb|² by the errors of the samples
        unit, rows = np.append(x, -1.0), self.triangle()
        squares, expected = float(np.sum((rows @ unit) ** 2)), float(unit @ self._errors @ unit)
        size = float(np.sum(rows[:, -1] ** 2))
        return (
            float(np.sqrt(squares / expected)) if expected > 0 else np.inf,
            float(np.sqrt(squares / size)) if size > 0 else 0.0,
        )

    def bias(self, x: Array, *, is_zero: bool = False) -> Array:
        """Return the error (10,) of the target's unknowns by the noise inside the rows, on average.

        Least squares solves AᵀA x = Aᵀb, and errors [δA | δb] of the rows add E[δᵀδ] to [A | b]ᵀ
        [A | b]. To first order, the bias is −(AᵀA)⁻¹ (E[δAᵀδA] x − E[δAᵀδb]).

        Args:
            x: the unknowns (k + 10,).
            is_zero: whether the momentum is zero; see `triangle`.

        """
        R = self.triangle(is_zero=is_zero)[:-1, :-1]
        # E[δAᵀδA] x − E[δAᵀδb]
        added = (self._errors @ np.append(x, -1.0))[self.extra if is_zero else 0 : -1]
        # (AᵀA)⁻¹ = R⁻¹ R⁻ᵀ
        inverse = np.linalg.pinv(R)
        return np.asarray(-inverse @ (inverse.T @ added))[-10:]

    def residuals(self, x: Array) -> tuple[Samples, Samples]:
        """Return the residuals b − A x at x of the linear and of the angular rows.

        Of a long log, they are those of parts that are spread over it.
        """
        kept = concatenated_samples(self._kept)
        rest = -(kept.value @ np.append(x, -1.0))
        linear, angular = np.split(rest, [rest.shape[1] - self._angular], axis=1)
        return Samples(kept.time, linear), Samples(kept.time, angular)


def _pairs(values: list[_T]) -> list[list[_T]]:
    return [values[k : k + 2] for k in range(0, len(values), 2)]
