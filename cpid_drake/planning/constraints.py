"""Constraints of a motion that are not linear in its parameters, and that of distances."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cpid_drake.planning.families import MotionFamily
from cpid_drake.spacecraft.clearance import Clearance

CHECK_PERIOD = 0.15
"""Time between two poses at which distances are imposed [s]."""

MARGIN = 0.01
"""Distance that is imposed beyond the smallest one, for the motion between the poses [m]."""


class MotionFunction(Protocol):
    """A vector of functions of a motion's parameters."""

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values (Q,) for parameters (F, K)."""
        ...

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the values (Q,) and their gradients (Q, F K) for parameters (F, K)."""
        ...


class Constraint(MotionFunction, Protocol):
    """A vector of functions of a motion's parameters that must not be negative."""

    @property
    def name(self) -> str:
        """Its name in words."""
        ...


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances between bodies that are not neighbours.

    Attributes:
        clearance: of the spacecraft with a target of known shape.
        family: the motions.
        least: smallest distance [m].

    """

    clearance: Clearance
    family: MotionFamily
    least: float
    name: str = "distance"

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Constraint`."""
        return self.evaluate(parameters)[0]

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Constraint`."""
        count = int(np.ceil(self.family.duration / CHECK_PERIOD))
        times = np.linspace(0.0, self.family.duration, count + 1)[1:-1]
        positions = self.family.make(parameters).evaluate(times)[:, 0]
        values, by_position = self.clearance.penalties(positions, self.least + MARGIN)
        functions = self.family.functions(times)[:, 0]
        by_parameter = functions[:, :, None] * by_position[:, None, self.family.moving]
        return 1 - values, -by_parameter.reshape(len(times), -1)

    def is_kept(self, parameters: NDArray[np.float64], period: float) -> bool:
        """Return whether the distances are kept at times this far apart [s]."""
        count = int(np.ceil(self.family.duration / period))
        times = np.linspace(0.0, self.family.duration, count + 1)
        positions = self.family.make(parameters).evaluate(times)[:, 0]
        found = self.clearance.approaches(positions)
        return not found or found[0].distance >= self.least
