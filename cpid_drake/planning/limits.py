"""Limits of joint positions, rates and accelerations: linear in the parameters of a motion."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.planning.families import MotionFamily
from cpid_drake.spacecraft.reading import JointLimits

POINTS_PER_FUNCTION = 8
"""Times at which limits are checked, for each function of a family."""

MARGIN = 0.02
"""Share of each limit that a motion leaves unused: the limits are checked at some times only."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits (J,) of position, rate and acceleration; infinite where there is none.

    Attributes:
        lowest, highest: positions [rad or m].
        rates: largest rates [rad/s or m/s].
        accelerations: largest accelerations [rad/s² or m/s²].

    """

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    rates: NDArray[np.float64]
    accelerations: NDArray[np.float64]

    @classmethod
    def of_model(
        cls, limits: JointLimits, rate_share: float = 1.0, acceleration: float = np.inf
    ) -> "MotionLimits":
        """Return the limits of a model, with a share of its rates and one acceleration limit."""
        accelerations = np.full(len(limits.rates), acceleration)
        return cls(limits.lowest, limits.highest, rate_share * limits.rates, accelerations)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3, J) lower and upper limits of position, rate and acceleration."""
        upper = np.stack([self.highest, self.rates, self.accelerations])
        return np.stack([np.stack([self.lowest, -self.rates, -self.accelerations]), upper])


@dataclass(frozen=True, eq=False)
class LimitedFamily:
    """A family with limits, at times that resolve its motions.

    Attributes:
        family: the family.
        limits: of all joints.

    Raises:
        InputError: the motion from start to end alone exceeds a limit.

    """

    family: MotionFamily
    limits: MotionLimits

    def __post_init__(self) -> None:
        room = self.room.min(axis=(0, 1))
        if room.min() <= 0:
            joint, derivative = np.argwhere(self.room.min(axis=(0, 1)) <= 0)[0][::-1]
            name = self.family.joint_names[joint]
            what = ("position", "rate", "acceleration")[derivative]
            raise InputError(
                f"{name}: the motion from start to end in {self.family.duration:g} s exceeds the "
                f"limit of its {what}; give a longer duration or other positions"
            )

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """(M,) the times at which limits are checked [s]."""
        count = POINTS_PER_FUNCTION * (self.family.count + 4)
        return np.linspace(0.0, self.family.duration, count + 1)

    @cached_property
    def functions(self) -> NDArray[np.float64]:
        """(M, 3, F) the family's functions at these times."""
        return self.family.functions(self.times)

    @cached_property
    def room(self) -> NDArray[np.float64]:
        """(2, M, 3, J) what the known part leaves of the lower and the upper limits."""
        known = self.family.known(self.times)
        lower, upper = self.limits.bounds
        centre = np.zeros_like(lower)
        both = np.isfinite(lower) & np.isfinite(upper)
        centre[both] = (lower[both] + upper[both]) / 2
        lower, upper = (centre + (1 - MARGIN) * (bound - centre) for bound in (lower, upper))
        return np.stack([known - lower, upper - known])

    def usage(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest share (3, ..., K) of the room that parameters (..., F, K) use.

        It is 1 where the limit of position, rate or acceleration of a joint is reached.
        """
        moved = np.moveaxis(np.tensordot(self.functions, parameters, axes=(2, -2)), 1, 0)
        if parameters.ndim > 2:  # (3, M, ..., K)
            shape = (2, 3, len(self.times), *(1,) * (parameters.ndim - 2), -1)
        else:
            shape = (2, 3, len(self.times), -1)
        room = np.swapaxes(self.room[..., self.family.moving], 1, 2).reshape(shape)
        return np.maximum((-moved / room[0]).max(axis=1), (moved / room[1]).max(axis=1))

    @cached_property
    def largest_alone(self) -> NDArray[np.float64]:
        """(F, K) how large each parameter can be if all others are zero."""
        units = np.eye(self.family.count)[:, :, None] * np.ones(len(self.family.moving))
        with np.errstate(divide="ignore"):
            return np.asarray(1 / self.usage(units).max(axis=0))

    def inequalities(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return A (Q, F K) and b (Q,) of the finite limits A x ≤ b, x the raveled (F, K)."""
        K, F = len(self.family.moving), self.family.count
        rows, rest = [], []
        for j, joint in enumerate(self.family.moving):
            for sign, room in ((-1.0, self.room[0]), (1.0, self.room[1])):
                b = room[1:-1, :, joint].ravel()
                phi = self.functions[1:-1].reshape(-1, F)
                kept = np.isfinite(b) & (np.abs(phi).sum(axis=1) > 1e-9)
                A = np.zeros((int(kept.sum()), F, K))
                A[:, :, j] = sign * phi[kept]
                rows.append(A.reshape(-1, F * K))
                rest.append(b[kept])
        return np.concatenate(rows), np.concatenate(rest)
