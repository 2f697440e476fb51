"""Limits of the base's motion during a plan: its turn, its angular rate and its displacement.

A limit bounds the length of a vector that follows from the base's motion. The model of the base's
motion has nodes; a cubic spline gives the vectors midway between them, where they may be longer.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.planning.motion_batch import BatchTrajectory, MotionBatch
from cpid_drake.planning.objective import Objective

IMPOSED_SHARE = 0.98
"""Share of a limit that is imposed: the vectors may be longer at other times."""


@dataclass(frozen=True, eq=False)
class BaseLimit(ABC):
    """A limit of the base's motion, for all targets of an objective.

    Attributes:
        objective: the model of the base's motion.
        largest: the limit [rad, rad/s or m].
        imposed: share of the limit that is imposed.

    """

    objective: Objective
    largest: float
    imposed: float = IMPOSED_SHARE
    name: ClassVar[str]

    @abstractmethod
    def measured(self, base: Telemetry) -> float:
        """Return the largest value in a motion of the base, which starts at W [rad, rad/s or m]."""

    @abstractmethod
    def _vectors(self, motions: MotionBatch, trajectory: BatchTrajectory) -> NDArray[np.float64]:
        """Return the vectors (U, n) at the nodes of B motions, time after time."""

    def _length(self, value: float) -> float:
        """Return the length that a vector has at a value [rad, rad/s or m]."""
        return value

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `constraints.Constraint`; the values are 1 minus squares of shares."""
        return 1 - self._squares(parameters[None]).reshape(-1)

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `constraints.Constraint`."""
        gradients = []
        for chunk, step in self.objective.steps(parameters):
            squares = self._squares(chunk)
            gradients.append(squares.imag.reshape(-1, squares.shape[-1]) / step)
        return self.values(parameters), -np.concatenate(gradients, axis=1)

    def demands(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest share (T, 1) of what is imposed, in motions (B, F, K) with T targets.

        The shares are those of the vectors' lengths.
        """
        return np.sqrt(self._squares(parameters).max(axis=(1, 2)))[:, None]

    def _squares(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the squares (T, M, B) of the shares of what is imposed, in motions (B, F, K)."""
        model = self.objective.model
        motions, found = model.motions(self.objective.samples(parameters)), []
        times = np.linspace(0.0, model.times[-1], 2 * len(model.times) - 1)
        between = CubicSpline(model.times, np.eye(len(model.times)))(times)
        for target in self.objective.targets:
            trajectory = motions.trajectory(model.state(self.objective.psi(target)))
            vectors = self._vectors(motions, trajectory).reshape(len(model.times), -1)
            fine = (between @ vectors).reshape(len(times), motions.count, -1)
            found.append(np.sum(fine * fine, axis=-1))
        return np.stack(found) / self._length(self.imposed * self.largest) ** 2


class BaseAttitude(BaseLimit):
    """The turn of the base from its attitude at the start [rad]."""

    name = "base attitude"

    def measured(self, base: Telemetry) -> float:
        """See `BaseLimit`."""
        cosine = np.abs(base.quaternion_WB @ base.quaternion_WB[0])
        return float(2 * np.arccos(np.clip(cosine, 0, 1)).max())

    def reached(self, parameters: NDArray[np.float64]) -> float:
        """Return the largest angle in a motion (F, K) with any of the targets [rad]."""
        length = self.demands(parameters[None]).max() * self._length(self.imposed * self.largest)
        return float(2 * np.arcsin(min(length / np.sqrt(8), 1.0)))

    def _vectors(self, motions: MotionBatch, trajectory: BatchTrajectory) -> NDArray[np.float64]:
        return (trajectory.R - np.eye(3)).reshape(-1, 9)

    def _length(self, value: float) -> float:
        return float(np.sqrt(8) * np.sin(min(value, np.pi) / 2))  # of R − 1


class BaseRate(BaseLimit):
    """The angular rate of the base [rad/s]."""

    name = "base rate"

    def measured(self, base: Telemetry) -> float:
        """See `BaseLimit`."""
        return float(np.linalg.norm(base.w_WB, axis=1).max())

    def _vectors(self, motions: MotionBatch, trajectory: BatchTrajectory) -> NDArray[np.float64]:
        return trajectory.w


class BaseDisplacement(BaseLimit):
    """The displacement of the base's origin from the start [m].

    The system's centre of mass has a constant velocity, which is zero without momentum.
    """

    name = "base displacement"

    def measured(self, base: Telemetry) -> float:
        """See `BaseLimit`."""
        return float(np.linalg.norm(base.p_WB - base.p_WB[0], axis=1).max())

    def _vectors(self, motions: MotionBatch, trajectory: BatchTrajectory) -> NDArray[np.float64]:
        state = trajectory.state
        from_base = rotate(trajectory.R, motions.dynamics.com(state.psi))
        moved = motions.nodes[:, None] * state.v_Wcm - from_base
        first = -from_base.reshape(-1, motions.count, 3)[0]
        return (moved.reshape(-1, motions.count, 3) - first).reshape(-1, 3)
