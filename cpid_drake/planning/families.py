"""Joint motions that are linear in their parameters: splines with given ends.

A motion is q(t) = k(t) + Σ_i x_i φ_i(t). The known part k moves from the given start to the
required end, and the functions φ are the same for all joints that move. They and their rates are
zero at both ends, so every motion starts and ends as required.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import SPLINE_DEGREE, Spline
from cpid_drake.errors import InputError
from cpid_drake.planning import HIGHEST_FREQUENCY
from cpid_drake.scenario.joint_motions import SplineMotion

MOST_FUNCTIONS = 60
"""Largest number of functions of a family."""

_FIXED = 3  # equal coefficients at each end: rates and accelerations are zero there


@dataclass(frozen=True, eq=False)
class MotionFamily:
    """Splines of degree 5 between two configurations; the parameters are coefficients.

    Attributes:
        joint_names: the J joints of the spacecraft.
        start, end: (J,) positions at both ends [rad or m].
        moving: (K,) columns of the joints that move besides the motion from start to end.
        duration: [s].
        frequency: highest frequency [Hz]; a spline's piece lasts half a period of it.

    """

    joint_names: tuple[str, ...]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    moving: NDArray[np.intp]
    duration: float
    frequency: float = HIGHEST_FREQUENCY

    @property
    def count(self) -> int:
        """Number F of functions φ.

        Raises:
            InputError: the highest frequency gives no function, or too many.

        """
        count = int(2 * self.frequency * self.duration) + SPLINE_DEGREE - 2 * _FIXED
        if not 1 <= count <= MOST_FUNCTIONS:
            raise InputError(
                f"{count} functions for each joint: give a highest frequency between "
                f"{1 / self.duration:.3g} and {MOST_FUNCTIONS / 2 / self.duration:.3g} Hz, not "
                f"{self.frequency:g} Hz"
            )
        return count

    def make(self, parameters: NDArray[np.float64]) -> Spline:
        """Return the motion with parameters (F, K)."""
        n = _FIXED
        inner = np.linspace(0.0, 1.0, self.count + 2)[1:-1]
        share = np.concatenate([np.zeros(n), inner, np.ones(n)])[:, None]
        table = self.start + share * (self.end - self.start)
        table[:n], table[-n:] = self.start, self.end
        table[n:-n, self.moving] += parameters
        return Spline(table, self.duration)

    def declare(self, parameters: NDArray[np.float64]) -> SplineMotion:
        """Return the motion with parameters (F, K) as a scenario's file has it."""
        table = self.make(parameters).coefficients
        return SplineMotion(
            self.duration, {name: table[:, j] for j, name in enumerate(self.joint_names)}
        )

    def known(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (M, 3, J) of the known part at times (M,)."""
        return self.make(np.zeros((self.count, len(self.moving)))).evaluate(times)

    def functions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the functions φ with their first two derivatives (M, 3, F) at times (M,)."""
        one = replace(self, start=np.zeros(1), end=np.zeros(1), moving=np.zeros(1, dtype=int))
        parts = [one.make(unit[:, None]).evaluate(times)[..., 0] for unit in np.eye(self.count)]
        return np.stack(parts, axis=-1)
