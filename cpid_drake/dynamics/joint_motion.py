"""Joint motions as functions of time: half a cosine, sums of sines, splines."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

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
        time = np.asarray(time, dtype=float)
        t, w = np.minimum(np.maximum(time, 0.0), self.duration), np.pi / self.duration
        moves, cosine = t == time, np.cos(w * t)
        share = np.empty((*time.shape, 3))
        share[..., 0] = 1 - cosine
        share[..., 1] = w * np.sin(w * t) * moves
        share[..., 2] = w**2 * cosine * moves
        motion = share[..., None] * ((self.q_final - self.q_initial) / 2)
        motion[..., 0, :] += self.q_initial
        return motion

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

    @cached_property
    def _w(self) -> Array:
        """Angular frequencies w_k (K,) [rad/s]."""
        return 2 * np.pi * self.frequencies

    @cached_property
    def _phasors(self) -> NDArray[np.complex128]:
        """Factors (K, 3 J) of exp(i w_k t) in the sum and its derivatives, the imaginary parts."""
        # s⁽ⁿ⁾(t) = Im Σ_k (i w_k)ⁿ a_k exp(i φ_k) exp(i w_k t)
        phasors = self.amplitudes * np.exp(1j * self.phases)
        iw = 1j * self._w[:, None]
        return np.concatenate([phasors, iw * phasors, iw**2 * phasors], axis=1)

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.asarray(time, dtype=float)[..., None]
        t = np.minimum(np.maximum(t, 0.0), self.duration)
        x = np.minimum(np.minimum(t, self.duration - t) / self.ramp, 1.0)
        durations = np.array([self.ramp, self.duration])
        steps = _smooth_step(np.concatenate([x, t / self.duration], axis=-1), durations)
        r, rdot, rddot = steps[..., 0, :1], steps[..., 1, :1], steps[..., 2, :1]
        rdot = np.where(t < self.duration / 2, rdot, -rdot)
        sums = (np.exp(1j * self._w * t) @ self._phasors).imag
        sums = sums.reshape(*t.shape[:-1], 3, self.centre.size)
        s, sdot = sums[..., 0, :], sums[..., 1, :]

        # (r s)' = r s' + r' s,  (r s)'' = r s'' + 2 r' s' + r'' s
        motion = r[..., None] * sums + steps[..., 1:] * self.displacement
        motion[..., 0, :] += self.centre
        motion[..., 1, :] += rdot * s
        motion[..., 2, :] += 2 * rdot * sdot + rddot * s
        return np.asarray(motion)

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


def _smooth_step(x: Array, time: Array) -> Array:
    """Return (..., 3, n) steps of `MultiSine` at x = t / time (..., n), and two derivatives."""
    y = x * (1 - x)
    motion = np.empty((*x.shape[:-1], 3, x.shape[-1]))
    motion[..., 0, :] = (x * x) ** 2 * x * (126 + x * (-420 + x * (540 + x * (-315 + x * 70))))
    motion[..., 1, :] = 630 / time * (y * y) ** 2
    motion[..., 2, :] = 2520 / time**2 * (y * y * y) * (1 - 2 * x)
    return motion
