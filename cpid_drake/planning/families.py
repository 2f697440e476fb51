"""Families of joint motions that are linear in their parameters.

A motion is q(t) = k(t) + Σ_i x_i φ_i(t). The known part k moves from the given start to the
required end, and the functions φ are the same for all joints that move. They and their rates are
zero at both ends, so every motion of a family starts and ends as required.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import MultiSine
from cpid_drake.dynamics.linear_motion import SPLINE_DEGREE, Spline, Waypoints
from cpid_drake.errors import InputError, choose_from
from cpid_drake.planning import HIGHEST_FREQUENCY
from cpid_drake.scenario.joint_motions import (
    AnyMotion,
    Motion,
    MultiSineMotion,
    SplineMotion,
    WaypointMotion,
)

MOST_FUNCTIONS = 60
"""Largest number of functions of a family."""

RAMP_SHARE = 0.3
"""Ramp of sums of sines, as a share of the duration."""


@dataclass(frozen=True, eq=False)
class MotionFamily(ABC):
    """All motions of one kind between two configurations.

    Attributes:
        joint_names: the J joints of the spacecraft.
        start, end: (J,) positions at both ends [rad or m].
        moving: (K,) columns of the joints that move besides the motion from start to end.
        duration: [s].
        frequency: highest frequency [Hz]; it determines the number of functions.
        smooth_ends: whether the accelerations are zero at both ends too.

    """

    joint_names: tuple[str, ...]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    moving: NDArray[np.intp]
    duration: float
    frequency: float = HIGHEST_FREQUENCY
    smooth_ends: bool = True

    @property
    @abstractmethod
    def count(self) -> int:
        """Number F of functions φ."""

    @abstractmethod
    def make(self, parameters: NDArray[np.float64]) -> AnyMotion:
        """Return the motion with parameters (F, K)."""

    @abstractmethod
    def declare(self, parameters: NDArray[np.float64]) -> Motion:
        """Return the motion with parameters (F, K) as a scenario's file has it."""

    @property
    def size(self) -> int:
        """Number of parameters F K."""
        return self.count * len(self.moving)

    def known(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (M, 3, J) of the known part at times (M,)."""
        return self.make(np.zeros((self.count, len(self.moving)))).evaluate(times)

    def functions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the functions φ with their first two derivatives (M, 3, F) at times (M,)."""
        one = replace(self, start=np.zeros(1), end=np.zeros(1), moving=np.zeros(1, dtype=int))
        parts = [one.make(unit[:, None]).evaluate(times)[..., 0] for unit in np.eye(self.count)]
        return np.stack(parts, axis=-1)

    def _table(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return parameters (F, K) for all joints (F, J), zero for those that do not move."""
        table = np.zeros((len(parameters), len(self.start)))
        table[:, self.moving] = parameters
        return table

    def _by_name(self, table: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the columns of a table (M, J) by the joints' names."""
        return {name: table[:, j] for j, name in enumerate(self.joint_names)}


@dataclass(frozen=True, eq=False)
class SplineFamily(MotionFamily):
    """Splines of degree 5; the parameters are coefficients."""

    @property
    def count(self) -> int:
        """See `MotionFamily`. A spline's piece lasts half a period of the highest frequency."""
        pieces = int(2 * self.frequency * self.duration)
        return _checked(pieces + SPLINE_DEGREE - 2 * self._fixed, self)

    def make(self, parameters: NDArray[np.float64]) -> Spline:
        """See `MotionFamily`."""
        n = self._fixed
        inner = np.linspace(0.0, 1.0, self.count + 2)[1:-1]
        share = np.concatenate([np.zeros(n), inner, np.ones(n)])[:, None]
        table = self.start + share * (self.end - self.start)
        table[:n], table[-n:] = self.start, self.end
        table[n:-n] += self._table(parameters)
        return Spline(table, self.duration)

    def declare(self, parameters: NDArray[np.float64]) -> SplineMotion:
        """See `MotionFamily`."""
        return SplineMotion(self.duration, self._by_name(self.make(parameters).coefficients))

    @property
    def _fixed(self) -> int:
        """Number of equal coefficients at each end."""
        return 3 if self.smooth_ends else 2


@dataclass(frozen=True, eq=False)
class WaypointFamily(MotionFamily):
    """Half-cosine motions through waypoints, with jumps of the acceleration at each of them."""

    @property
    def count(self) -> int:
        """See `MotionFamily`. Each motion lasts half a period of the highest frequency."""
        return _checked(int(2 * self.frequency * self.duration) - 1, self)

    def make(self, parameters: NDArray[np.float64]) -> Waypoints:
        """See `MotionFamily`."""
        share = np.linspace(0.0, 1.0, self.count + 2)[:, None]
        table = self.start + share * (self.end - self.start)
        table[-1] = self.end
        table[1:-1] += self._table(parameters)
        return Waypoints(table, self.duration)

    def declare(self, parameters: NDArray[np.float64]) -> WaypointMotion:
        """See `MotionFamily`."""
        return WaypointMotion(self.duration, self._by_name(self.make(parameters).positions))


@dataclass(frozen=True, eq=False)
class FourierFamily(MotionFamily):
    """Sines and cosines of k/T for k = 1, 2, … up to the highest frequency, with smooth ramps.

    Source: Swevers et al. 1997, "Optimal robot excitation and identification".
    """

    @property
    def count(self) -> int:
        """See `MotionFamily`."""
        return _checked(2 * int(self.frequency * self.duration + 1e-9), self)

    def make(self, parameters: NDArray[np.float64]) -> MultiSine:
        """See `MotionFamily`."""
        sines, cosines = np.split(self._table(parameters), 2)
        return MultiSine(
            centre=self.start,
            amplitudes=np.hypot(sines, cosines),
            frequencies=np.arange(1, len(sines) + 1) / self.duration,
            phases=np.arctan2(cosines, sines),
            ramp=RAMP_SHARE * self.duration,
            duration=self.duration,
            displacement=self.end - self.start,
        )

    def declare(self, parameters: NDArray[np.float64]) -> MultiSineMotion:
        """See `MotionFamily`."""
        motion = self.make(parameters)

        def by_joint(values: NDArray[np.float64]) -> dict[str, float]:
            return dict(zip(self.joint_names, values.tolist(), strict=True))

        return MultiSineMotion(
            self.duration,
            motion.ramp,
            motion.frequencies,
            by_joint(motion.centre),
            self._by_name(motion.amplitudes),
            self._by_name(motion.phases),
            by_joint(self.end),
        )


FAMILIES: dict[str, type[MotionFamily]] = {
    "spline": SplineFamily,
    "fourier": FourierFamily,
    "waypoints": WaypointFamily,
}
"""The families by name."""


def family_of(name: str) -> type[MotionFamily]:
    """Return the family of this name.

    Raises:
        InputError: there is no such family.

    """
    if name not in FAMILIES:
        raise InputError(f"no family of motions '{name}'; {choose_from(name, list(FAMILIES))}")
    return FAMILIES[name]


def _checked(count: int, family: MotionFamily) -> int:
    if not 1 <= count <= MOST_FUNCTIONS:
        raise InputError(
            f"{count} functions for each joint: give a highest frequency between "
            f"{1 / family.duration:.3g} and {MOST_FUNCTIONS / 2 / family.duration:.3g} Hz, not "
            f"{family.frequency:g} Hz"
        )
    return count
