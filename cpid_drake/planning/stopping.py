"""Motions that may be stopped at any instant: every joint brakes, and nothing is hit.

A stop begins at an instant of the motion with joint positions q and rates q̇. From then on every
joint brakes with the same deceleration a until it is at rest; joints come to rest one after the
other, at

    q + q̇ |q̇| / (2 a).

If a is the largest acceleration of a motion that ends at rest, the motion itself cannot stop in
less room: it passes each of these positions later, and they are within its own range. The limits of
positions are then kept wherever the motion keeps them. The distances between bodies are not: the
joints leave the planned path, because they do not come to rest together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.planning.constraints import CHECK_PERIOD, MARGIN, Distances
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.limits import MARGIN as LIMITS_MARGIN
from cpid_drake.planning.limits import MotionLimits
from cpid_drake.planning.prediction import MotionSetting

STOP_PERIOD = 0.1
"""Time between the stops of a finished motion that are checked, and between their poses [s]."""

AT_REST = 0.02
"""Time that a joint needs to brake below which it counts as at rest [s]."""


def braked(
    q: NDArray[np.float64], qdot: NDArray[np.float64], deceleration: float, after: float = np.inf
) -> NDArray[np.float64]:
    """Return positions (..., J) a time after all joints began to brake.

    Args:
        q: (..., J) positions when they begin [rad or m].
        qdot: (..., J) rates when they begin [rad/s or m/s].
        deceleration: of each joint until it is at rest [rad/s² or m/s²].
        after: the time [s]; default: when all joints are at rest.

    """
    time = np.minimum(np.abs(qdot) / deceleration, after)
    return q + qdot * time - np.sign(qdot) * deceleration * time**2 / 2


@dataclass(frozen=True, eq=False)
class Stops:
    """The limits of positions and the distances between bodies where the joints come to rest.

    The constraint is imposed for stops every `CHECK_PERIOD`, where all joints are at rest. The
    check of a finished motion follows the joints until then.

    Attributes:
        family: the motions.
        limits: of all joints.
        deceleration: of every joint [rad/s² or m/s²].
        distances: the distances between bodies; None if they are not known.

    """

    family: MotionFamily
    limits: MotionLimits
    deceleration: float
    distances: Distances | None
    name: str = "stops"

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `constraints.Constraint`."""
        return self.evaluate(parameters)[0]

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `constraints.Constraint`; room is a share of half a joint's range."""
        times, moving = self._times(CHECK_PERIOD)[1:-1], self.family.moving
        q, qdot = np.moveaxis(self.family.make(parameters).evaluate(times)[:, :2], 1, 0)
        rest = braked(q, qdot, self.deceleration)
        functions = self.family.functions(times)[:, :2, :, None]
        time = np.abs(qdot[:, None, moving]) / self.deceleration
        by_parameter = functions[:, 0] + time * functions[:, 1]  # (N, F, K)

        lowest, highest = self.limits.lowest[moving], self.limits.highest[moving]
        limited = np.flatnonzero(np.isfinite(highest - lowest))
        half = ((highest - lowest) / 2)[limited]
        offset = (rest[:, moving] - (lowest + highest) / 2)[:, limited] / half
        slopes = np.zeros((len(times), len(limited), *parameters.shape))
        slopes[:, np.arange(len(limited)), :, limited] = np.swapaxes(
            by_parameter[:, :, limited] / half, 1, 2
        ).swapaxes(0, 1)
        slopes = slopes.reshape(-1, parameters.size)
        room = 1 - LIMITS_MARGIN
        values = [(room - offset).ravel(), (room + offset).ravel()]
        gradients = [-slopes, slopes]
        if self.distances is not None:
            least = self.distances.least + MARGIN
            penalties, by_position = self.distances.clearance.penalties(rest, least)
            values.append(1 - penalties)
            change = by_parameter * by_position[:, None, moving]
            gradients.append(-change.reshape(len(times), -1))
        return np.concatenate(values), np.concatenate(gradients)

    def is_kept(self, parameters: NDArray[np.float64], period: float = STOP_PERIOD) -> bool:
        """Return whether limits and distances are kept in all stops that begin this far apart [s].

        The poses of each stop are as far apart, and the last is that at rest.
        """
        motion = self.family.make(parameters).evaluate(self._times(period))
        q, qdot = motion[:, 0], motion[:, 1]
        rest = braked(q, qdot, self.deceleration)
        if (rest < self.limits.lowest).any() or (rest > self.limits.highest).any():
            return False
        if self.distances is None:
            return True
        shaped = np.isfinite(self.limits.highest - self.limits.lowest)  # not of wheels
        longest = np.abs(qdot[:, shaped]).max(initial=0.0) / self.deceleration
        path = [braked(q, qdot, self.deceleration, t) for t in np.arange(period, longest, period)]
        found = self.distances.clearance.approaches(np.concatenate([*path, rest]))
        return not found or found[0].distance >= self.distances.least

    def _times(self, period: float) -> NDArray[np.float64]:
        count = int(np.ceil(self.family.duration / period))
        return np.linspace(0.0, self.family.duration, count + 1)


def needed_torque(
    setting: MotionSetting,
    motion: JointMotion,
    targets: NDArray[np.float64],
    deceleration: float,
) -> float:
    """Return the largest share of a motor's effort that begins a stop, with targets π (T, 10).

    All joints that move begin to brake at once, every `STOP_PERIOD`.
    """
    times = np.linspace(0.0, motion.duration, int(motion.duration / STOP_PERIOD) + 1)
    qdot = motion.evaluate(times)[:, 1]
    accelerations = -deceleration * np.sign(qdot) * (np.abs(qdot) > deceleration * AT_REST)
    telemetries = setting.telemetries(motion, targets, times)
    efforts = setting.efforts(telemetries, targets, accelerations)
    return float((efforts / setting.spacecraft.limits.efforts).max())
