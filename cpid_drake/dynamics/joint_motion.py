"""Joint motions as functions of time."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.errors import InputError

_POINTS_PER_CYCLE = 64


class JointMotion(Protocol):
    """A prescribed motion of J joints."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        ...

    def instants(self) -> NDArray[np.float64]:
        """Return times (N,) from 0 to the end that resolve the motion [s]."""
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

    q_initial: NDArray[np.float64]
    q_final: NDArray[np.float64]
    duration: float

    def __post_init__(self) -> None:
        for name in ("q_initial", "q_final"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
        if self.q_initial.ndim != 1 or self.q_initial.shape != self.q_final.shape:
            raise InputError("half-cosine motion: q_initial and q_final must be of equal length")
        if not (np.isfinite(self.q_initial).all() and np.isfinite(self.q_final).all()):
            raise InputError("half-cosine motion: joint positions must be finite")
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise InputError(f"half-cosine motion: the duration must be > 0, not {self.duration}")

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)[..., None]
        phase = np.pi * np.clip(time / self.duration, 0.0, 1.0)
        moving = (time >= 0) & (time <= self.duration)
        rate = np.pi / self.duration
        half = (self.q_final - self.q_initial) / 2
        q = self.q_initial + half * (1 - np.cos(phase))
        qdot = half * rate * np.sin(phase) * moving
        qddot = half * rate**2 * np.cos(phase) * moving
        return np.stack([q, qdot, qddot], axis=-2)

    def instants(self) -> NDArray[np.float64]:
        """Return times (N,) from 0 to T that resolve the motion, T/2 included [s]."""
        return np.linspace(0.0, self.duration, _POINTS_PER_CYCLE + 1)


_MOST_CYCLES = 1000


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
        displacement: (J,) Δ [rad or m]; default: zero.

    Raises:
        InputError: shapes do not match, an entry is not finite, a frequency or time is not
            positive, the ramp is longer than T/2, or there are more than 1000 cycles in T.

    """

    centre: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    frequencies: NDArray[np.float64]
    phases: NDArray[np.float64]
    ramp: float
    duration: float
    displacement: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not np.size(self.displacement):
            object.__setattr__(self, "displacement", np.zeros(np.shape(self.centre)))
        dimensions = {
            "centre": 1,
            "displacement": 1,
            "frequencies": 1,
            "amplitudes": 2,
            "phases": 2,
        }
        for name, count in dimensions.items():
            try:
                values = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                values = np.full(1, np.nan)
            if values.ndim != count or not np.isfinite(values).all():
                raise InputError(
                    f"multi-sine motion: {name} must be finite numbers in {count} dimension(s)"
                )
            object.__setattr__(self, name, values)
        shape = (self.frequencies.size, self.centre.size)
        if self.amplitudes.shape != shape or self.phases.shape != shape:
            raise InputError(
                f"multi-sine motion: for {shape[0]} frequencies of {shape[1]} joints, amplitudes "
                f"and phases must be of shape {shape}, not {self.amplitudes.shape} and "
                f"{self.phases.shape}"
            )
        if np.shape(self.displacement) != self.centre.shape:
            raise InputError("multi-sine motion: displacement and centre must be of equal length")
        if not self.frequencies.size or not (self.frequencies > 0).all():
            raise InputError("multi-sine motion: frequencies must be > 0 Hz, at least one")
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise InputError(f"multi-sine motion: the duration must be > 0, not {self.duration}")
        if not 0 < self.ramp <= self.duration / 2:
            raise InputError(
                "multi-sine motion: the ramp must be > 0 and at most half the duration of "
                f"{self.duration:g}, not {self.ramp}"
            )
        if self.frequencies.max() > _MOST_CYCLES / self.duration:
            raise InputError(
                f"multi-sine motion: {self.frequencies.max():g} Hz for {self.duration:g} s is more "
                f"than {_MOST_CYCLES} cycles"
            )

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.clip(np.asarray(time, dtype=float)[..., None], 0.0, self.duration)
        x = np.minimum(np.minimum(t, self.duration - t) / self.ramp, 1.0)
        direction = np.where(t < self.duration / 2, 1.0, -1.0)
        r, rdot, rddot = _smooth_step(x)
        rdot, rddot = direction * rdot / self.ramp, rddot / self.ramp**2

        w = 2 * np.pi * self.frequencies[:, None]
        angle = w * t[..., None] + self.phases
        sines, cosines = self.amplitudes * np.sin(angle), self.amplitudes * np.cos(angle)
        s, sdot, sddot = sines.sum(-2), (w * cosines).sum(-2), -(w**2 * sines).sum(-2)
        q = self.centre + r * s
        qdot = rdot * s + r * sdot
        qddot = rddot * s + 2 * rdot * sdot + r * sddot
        moved = np.stack([q, qdot, qddot], axis=-2)
        scales = self.duration ** -np.arange(3.0)[:, None]
        shift = np.stack(_smooth_step(t / self.duration), axis=-2) * scales * self.displacement
        return np.asarray(moved + shift)

    def instants(self) -> NDArray[np.float64]:
        """Return times (N,) from 0 to T that resolve every cycle and both ramps [s].

        Extremes at these instants are accurate to about 1e-3.
        """
        count = _POINTS_PER_CYCLE * max(1.0, self.frequencies.max() * self.duration)
        start = np.linspace(0.0, self.ramp, _POINTS_PER_CYCLE + 1)
        whole = np.linspace(0.0, self.duration, int(np.ceil(count)) + 1)
        return np.unique(np.concatenate([start, whole, self.duration - start]))


def _smooth_step(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the polynomial of degree 9 from 0 at x = 0 to 1 at x = 1, and two derivatives."""
    step = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
    return step, 630 * (x * (1 - x)) ** 4, 2520 * (x * (1 - x)) ** 3 * (1 - 2 * x)
