"""Joint motions along splines, which are linear in their parameters."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.errors import InputError

if TYPE_CHECKING:  # SciPy takes a second to import, and reading a scenario does not need it
    from scipy.interpolate import BSpline

SPLINE_DEGREE = 5
"""Degree of the splines: positions, rates, accelerations and jerks are continuous."""

_POINTS_PER_PIECE = 32


@dataclass(frozen=True, eq=False)
class Spline:
    """q(t) = Σ_k c_k B_k(t): splines of degree 5 with equal pieces, at rest at both ends.

    The first two coefficients are equal, and so are the last two: the rates are zero at t = 0 and
    T. If the first three and the last three are equal, the accelerations are zero there, too. All
    positions are between the smallest and the largest coefficient of their joint. Source: Park
    2006, "Fourier-based optimal excitation trajectories" (end conditions); de Boor 1978 (splines).

    Attributes:
        coefficients: (K, J) c_k [rad or m], K ≥ 6.
        duration: T [s].

    Raises:
        InputError: too few coefficients, an entry is not finite, the joints are not at rest at both
            ends, or the duration is not positive.

    """

    coefficients: NDArray[np.float64]
    duration: float

    def __post_init__(self) -> None:
        try:
            c = np.array(self.coefficients, dtype=float)
        except (TypeError, ValueError):
            c = np.zeros(0)
        if c.ndim != 2 or len(c) <= SPLINE_DEGREE or not np.isfinite(c).all():
            raise InputError(
                f"spline motion: each joint needs at least {SPLINE_DEGREE + 1} coefficients, "
                "finite numbers"
            )
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise InputError(f"spline motion: the duration must be > 0, not {self.duration}")
        object.__setattr__(self, "coefficients", c)
        if not (np.array_equal(c[0], c[1]) and np.array_equal(c[-1], c[-2])):
            raise InputError(
                "spline motion: the first two coefficients of each joint must be equal, and so "
                "must the last two, because the joints start and end at rest"
            )

    @property
    def joint_count(self) -> int:
        """Number of joints J."""
        return self.coefficients.shape[1]

    @property
    def pieces(self) -> int:
        """Number of polynomials."""
        return len(self.coefficients) - SPLINE_DEGREE

    @cached_property
    def _functions(self) -> "list[BSpline]":
        from scipy.interpolate import BSpline

        inner = np.linspace(0.0, self.duration, self.pieces + 1)
        ends = np.ones(SPLINE_DEGREE)
        knots = np.concatenate([0.0 * ends, inner, self.duration * ends])
        position = BSpline(knots, self.coefficients, SPLINE_DEGREE)
        return [position, position.derivative(1), position.derivative(2)]

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)
        t = np.clip(time, 0.0, self.duration)
        result = np.stack([function(t) for function in self._functions], axis=-2)
        moving = (time >= 0) & (time <= self.duration)
        result[..., 1:, :] *= moving[..., None, None]
        return result

    def instants(self) -> NDArray[np.float64]:
        """Return times (N,) from 0 to T that resolve every piece [s]."""
        return np.linspace(0.0, self.duration, _POINTS_PER_PIECE * self.pieces + 1)
