"""Joint motions that are linear in their parameters: splines with given ends, and their limits.

A motion is q(t) = k(t) + Σ_i x_i φ_i(t). The known part k moves from the given start to the
required end, and the functions φ are the same for all joints that move. They and their rates are
zero at both ends, so every motion starts and ends as required. Limits of position, rate and
acceleration are linear in the parameters x.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from cpid_drake.array import Array
from cpid_drake.dynamics.joint_motion import SPLINE_DEGREE, JointMotion, Spline
from cpid_drake.files.errors import InputError
from cpid_drake.simulation.joint_motions import SplineMotion

MOST_FUNCTIONS = 60
"""Largest number of functions of a family: the search takes minutes with more."""

POINTS_PER_FUNCTION = 12
"""Times at which limits hold, for each function: between them a rate is 0.3 % larger at most."""

QUANTITIES = ("position", "rate", "acceleration")
"""What the limits of a joint limit."""


@dataclass(frozen=True, eq=False)
class MotionFamily:
    """Splines of degree 5 between two configurations; the parameters are coefficients.

    Attributes:
        joint_names: the J joints of the spacecraft.
        start, end: (J,) positions at both ends [rad or m].
        moving: (K,) columns of the joints that move besides the motion from start to end.
        duration: [s].
        bounds: (2, 3, J) lower and upper limits of position, rate and acceleration; infinite where
            there is none.
        frequency: highest frequency [Hz]; a spline's piece lasts half a period of it.

    Raises:
        InputError: the highest frequency gives no function, or too many; the motion from start to
            end alone exceeds a limit.

    """

    joint_names: tuple[str, ...]
    start: Array
    end: Array
    moving: NDArray[np.intp]
    duration: float
    bounds: Array
    frequency: float

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST_FUNCTIONS:
            raise InputError(
                f"{self.count} functions for each joint: give a highest frequency between "
                f"{1 / self.duration:.3g} and {MOST_FUNCTIONS / 2 / self.duration:.3g} Hz, not "
                f"{self.frequency:g} Hz"
            )
        least = self._room.min(axis=(0, 1))
        if least.min() <= 0:
            derivative, joint = np.argwhere(least <= 0)[0]
            raise InputError(
                f"{self.joint_names[joint]}: the motion from start to end in {self.duration:g} s "
                f"exceeds the limit of its {QUANTITIES[derivative]}; give a longer duration or "
                "other positions"
            )

    @property
    def count(self) -> int:
        """Number F of functions φ."""
        return int(2 * self.frequency * self.duration) + SPLINE_DEGREE - 6  # 3 fixed at each end

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (F, K) of the parameters of a motion."""
        return self.count, len(self.moving)

    @cached_property
    def times(self) -> Array:
        """(M,) the times at which limits are imposed [s]."""
        return np.linspace(0.0, self.duration, POINTS_PER_FUNCTION * (self.count + 4) + 1)

    def make(self, parameters: Array) -> Spline:
        """Return the motion with parameters (F, K)."""
        # Three equal coefficients at each end: rates and accelerations are zero there.
        fraction = np.pad(
            np.linspace(0.0, 1.0, self.count + 2)[1:-1], 3, constant_values=(0.0, 1.0)
        )
        table = self.start + fraction[:, None] * (self.end - self.start)
        table[3:-3, self.moving] += parameters
        return Spline(table, self.duration)

    def declare(self, parameters: Array) -> SplineMotion:
        """Return the motion with parameters (F, K) as a scenario's file has it."""
        table = self.make(parameters).coefficients
        return SplineMotion(
            self.duration, {name: table[:, j] for j, name in enumerate(self.joint_names)}
        )

    def fitted(self, moved: Array) -> Array:
        """Return parameters (F, K) that move joints nearest to this (M, K) from the known part."""
        return np.asarray(np.linalg.lstsq(self.functions(self.times)[:, 0], moved)[0])

    def samples(self, parameters: Array, times: Array) -> Array:
        """Return positions and rates (M, B, 2, J) at times (M,) of B motions (B, F, K)."""
        moved = np.einsum("mdf,bfk->mbdk", self.functions(times)[:, :2], parameters)
        samples = np.repeat(self._at_known_times(times)[:, None, :2], len(parameters), axis=1)
        samples[..., self.moving] += moved
        return samples

    def functions(self, times: Array) -> Array:
        """Return the functions φ with their first two derivatives (M, 3, F) at times (M,)."""
        units = np.pad(np.eye(self.count), [(3, 3), (0, 0)])
        return Spline(units, self.duration).evaluate(times)

    @cached_property
    def limits(self) -> list[tuple[Array, Array]]:
        """For each joint that moves, A (Q, F) and b (Q,) of its finite limits A x ≤ b, b > 0."""
        phi, limits = self.functions(self.times)[1:-1].reshape(-1, self.count), []
        for joint in self.moving:
            A, b = np.concatenate([-phi, phi]), self._room[:, 1:-1, :, joint].ravel()
            kept = np.isfinite(b) & (np.abs(A).sum(axis=1) > 1e-9)
            limits.append((A[kept], b[kept]))
        return limits

    def usage(self, parameters: Array) -> Array:
        """Return the largest share (..., K) that parameters (..., F, K) use of the limits' room.

        The known part leaves this room of the limits of position, rate and acceleration of a joint.
        """
        shares = [
            (parameters[..., k] @ (A / b[:, None]).T).max(axis=-1, initial=0.0)
            for k, (A, b) in enumerate(self.limits)
        ]
        return np.stack(shares, axis=-1)

    def usage_of(self, motion: JointMotion) -> Array:
        """Return the largest share (3, J) of the limits that any motion of these joints needs."""
        values = motion.evaluate(motion.instants())
        lower, upper = self.bounds
        both = np.isfinite(lower) & np.isfinite(upper)
        centre = np.add(lower, upper, out=np.zeros_like(lower), where=both) / 2
        shares = np.maximum(
            (values - centre) / (upper - centre), (values - centre) / (lower - centre)
        )
        return np.asarray(shares.max(axis=0))

    def inequalities(self) -> tuple[Array, Array]:
        """Return A (Q, F K) and b (Q,) of all finite limits A x ≤ b, x the raveled (F, K)."""
        order = np.arange(self.count * len(self.moving)).reshape(self.shape).T.ravel()
        A = np.zeros((sum(len(b) for _, b in self.limits), len(order)))
        A[:, order] = block_diag(*(A for A, _ in self.limits))
        return A, np.concatenate([b for _, b in self.limits])

    def _at_known_times(self, times: Array) -> Array:
        """Return positions, rates and accelerations (M, 3, J) of the known part."""
        return self.make(np.zeros(self.shape)).evaluate(times)

    @cached_property
    def _room(self) -> Array:
        """(2, M, 3, J) what the known part leaves of the lower and the upper limits."""
        given = self._at_known_times(self.times)
        return np.stack([given - self.bounds[0], self.bounds[1] - given])
