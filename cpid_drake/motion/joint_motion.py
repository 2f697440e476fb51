"""Joint motions as functions of time."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.errors import InputError


class JointMotion(Protocol):
    """A prescribed motion of J joints."""

    duration: float

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        ...


@dataclass(frozen=True, eq=False)
class HalfCosine:
    """q(t) = q0 + Δ/2 (1 − cos(π t/T)), Δ = q1 − q0: at rest at t = 0 and at t = T, held after.

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

    def peak_rates(self) -> NDArray[np.float64]:
        """Return the (J,) largest joint speeds, reached at T/2 [rad/s or m/s]."""
        return np.pi / self.duration * np.abs(self.q_final - self.q_initial) / 2
