"""Joint motions as functions of time: half a cosine, sums of sines, splines."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError

SPLINE_DEGREE = 5
"""Degree of the splines: positions, rates, accelerations and jerks are continuous."""

_POINTS_PER_CYCLE = 64
"""An extreme between two instants exceeds that at an instant by (π/64)²/2 = 1e-3 at most."""


class JointMotion(Protocol):
    """A prescribed motion of J joints."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        ...

    def instants(self) -> Array:
        """Return times (N,) from 0 to the end that resolve the motion [s]."""
        ...

    def breaks(self) -> Array:
        """Return times (N,) between which the motion has all derivatives [s]."""
        ...


@dataclass(frozen=True, eq=False)
class HalfCosine:
    """q(t) = q0 + Δ/2 (1 − cos(π t/T)), Δ = q1 − q0: at rest at t = 0 and from t = T on.

    Source: Ning et al. 2016, Fig. 5 (a half cycle of cosine motion with T = 10 s).

    Attributes:
        q_initial: (J,) positions at t = 0 [rad or m].
        q_final: (J,) positions from t = T on [rad or m].
        duration: T [s].

    Raises:
        InputError: shapes differ, an entry is not finite, or the duration is not positive.

    """

    q_initial: Array
    q_final: Array
    duration: float

    def __post_init__(self) -> None:
        _check(self, "half-cosine", q_initial=1, q_final=1)
        if self.q_initial.shape != self.q_final.shape:
            raise InputError("half-cosine motion: q_initial and q_final must be of equal length")

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)[..., None]
        phase, w = np.pi * np.clip(time / self.duration, 0.0, 1.0), np.pi / self.duration
        half, moves = (self.q_final - self.q_initial) / 2, (time >= 0) & (time <= self.duration)
        q = self.q_initial + half * (1 - np.cos(phase))
        qdot, qddot = half * w * np.sin(phase) * moves, half * w**2 * np.cos(phase) * moves
        return np.stack([q, qdot, qddot], axis=-2)

    def instants(self) -> Array:
        """Return times (N,) from 0 to T that resolve the motion, T/2 included [s]."""
        return np.linspace(0.0, self.duration, _POINTS_PER_CYCLE + 1)

    def breaks(self) -> Array:
        """Return 0 and T, between which the motion has all derivatives [s]."""
        return np.array([0.0, self.duration])


@dataclass(frozen=True, eq=False)
class MultiSine:
    """q(t) = centre + s(t/T) Δ + r(t) Σ_k a_k sin(2π f_k t + φ_k): a bounded motion of all joints.

    s is the polynomial of degree 9 that rises from 0 to 1 and whose first four derivatives vanish
    at both ends. r rises in the same way over the first `ramp` seconds and falls back over the
    last. The joints are at rest at the centre until t = 0 and at centre + Δ from t = T on, without
    acceleration or jerk. Source: Swevers et al. 1997 (sums of sines that excite a robot well).

    Attributes:
        centre: (J,) positions about which the joints move [rad or m].
        amplitudes: (K, J) a_k [rad or m].
        frequencies: (K,) f_k [Hz].
        phases: (K, J) φ_k [rad].
        ramp: time to rise, and to fall [s].
        duration: T [s].
        displacement: (J,) or (1,) Δ [rad or m]; default: zero.

    Raises:
        InputError: shapes do not match, an entry is not finite, a frequency or time is not
            positive, the ramp is longer than T/2, or there are more than 1000 cycles in T.

    """

    centre: Array
    amplitudes: Array
    frequencies: Array
    phases: Array
    ramp: float
    duration: float
    displacement: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        _check(self, "multi-sine", centre=1, displacement=1, frequencies=1, amplitudes=2, phases=2)
        shape, highest = (self.frequencies.size, self.centre.size), 1000 / self.duration
        problem = ""
        if self.amplitudes.shape != shape or self.phases.shape != shape:
            problem = (
                f"for {shape[0]} frequencies of {shape[1]} joints, amplitudes and phases must be "
                f"of shape {shape}, not {self.amplitudes.shape} and {self.phases.shape}"
            )
        elif self.displacement.size not in (1, shape[1]):
            problem = "displacement and centre must be of equal length"
        elif not shape[0] or not ((self.frequencies > 0) & (self.frequencies < highest)).all():
            problem = f"frequencies must be > 0 and < {highest:g} Hz (1000 cycles), at least one"
        elif not 0 < self.ramp <= self.duration / 2:
            problem = (
                "the ramp must be > 0 and at most half the duration of "
                f"{self.duration:g}, not {self.ramp}"
            )
        if problem:
            raise InputError(f"multi-sine motion: {problem}")

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.clip(np.asarray(time, dtype=float)[..., None], 0.0, self.duration)
        x = np.minimum(np.minimum(t, self.duration - t) / self.ramp, 1.0)
        r, rdot, rddot = np.moveaxis(_smooth_step(x, self.ramp), -2, 0)
        rdot = np.where(t < self.duration / 2, 1.0, -1.0) * rdot

        w = 2 * np.pi * self.frequencies[:, None]
        angle = w * t[..., None] + self.phases
        sines, cosines = self.amplitudes * np.sin(angle), self.amplitudes * np.cos(angle)
        s, sdot, sddot = sines.sum(-2), (w * cosines).sum(-2), -(w**2 * sines).sum(-2)
        motion = [r * s, rdot * s + r * sdot, rddot * s + 2 * rdot * sdot + r * sddot]
        motion[0] = motion[0] + self.centre
        shift = _smooth_step(t / self.duration, self.duration) * self.displacement
        return np.asarray(np.stack(motion, axis=-2) + shift)

    def instants(self) -> Array:
        """Return times (N,) from 0 to T that resolve every cycle and both ramps [s].

        Extremes at these instants are accurate to about 1e-3.
        """
        count = _POINTS_PER_CYCLE * max(1.0, self.frequencies.max() * self.duration)
        start = np.linspace(0.0, self.ramp, _POINTS_PER_CYCLE + 1)
        whole = np.linspace(0.0, self.duration, int(np.ceil(count)) + 1)
        return np.unique(np.concatenate([start, whole, self.duration - start]))

    def breaks(self) -> Array:
        """Return the ends of both ramps, between which the motion has all derivatives [s]."""
        return np.unique([0.0, self.ramp, self.duration - self.ramp, self.duration])


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

    coefficients: Array
    duration: float

    def __post_init__(self) -> None:
        _check(self, "spline", coefficients=2)
        c = self.coefficients
        if len(c) <= SPLINE_DEGREE:
            raise InputError(
                f"spline motion: each joint needs at least {SPLINE_DEGREE + 1} coefficients"
            )
        if not (np.array_equal(c[0], c[1]) and np.array_equal(c[-1], c[-2])):
            raise InputError(
                "spline motion: the joints must start and end at rest: the first two coefficients "
                "of each must be equal, and so must the last two"
            )

    @cached_property
    def _spline(self) -> "scipy.interpolate.BSpline":
        knots = np.pad(self.breaks(), SPLINE_DEGREE, mode="edge")
        # SciPy imports scipy.interpolate here: it takes a second, and a scenario needs none.
        return scipy.interpolate.BSpline(knots, self.coefficients, SPLINE_DEGREE)

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)
        t = np.clip(time, 0.0, self.duration)
        result = np.stack([self._spline(t, order) for order in range(3)], axis=-2)
        result[..., 1:, :] *= (t == time)[..., None, None]
        return result

    def instants(self) -> Array:
        """Return times (N,) from 0 to T that resolve every piece, half a cycle at most [s]."""
        pieces = len(self.coefficients) - SPLINE_DEGREE
        return np.linspace(0.0, self.duration, _POINTS_PER_CYCLE // 2 * pieces + 1)

    def breaks(self) -> Array:
        """Return the ends (N,) of the pieces [s]."""
        return np.linspace(0.0, self.duration, len(self.coefficients) - SPLINE_DEGREE + 1)


def _check(motion: JointMotion, kind: str, **dimensions: int) -> None:
    """Convert the named members to arrays of finite numbers, and require a positive duration."""
    for name, count in dimensions.items():
        try:
            values = np.array(getattr(motion, name), dtype=float)
        except (TypeError, ValueError):
            values = np.full(1, np.nan)
        if values.ndim != count or not np.isfinite(values).all():
            raise InputError(
                f"{kind} motion: {name} must be finite numbers in {count} dimension(s)"
            )
        object.__setattr__(motion, name, values)
    if not 0 < motion.duration < np.inf:
        raise InputError(f"{kind} motion: the duration must be > 0, not {motion.duration}")


def _smooth_step(x: Array, time: float) -> Array:
    """Return (..., 3, 1) the step of `MultiSine` at x = t / time (..., 1), and two derivatives."""
    step = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
    rate, acceleration = 630 * (x * (1 - x)) ** 4, 2520 * (x * (1 - x)) ** 3 * (1 - 2 * x)
    return np.stack([step, rate / time, acceleration / time**2], axis=-2)
