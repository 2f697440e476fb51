"""The gyro's bias that a log shows: its samples less the turning of the attitude."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.array import Array
from cpid_drake.logs.instants import instants_of
from cpid_drake.logs.log import Log
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.suite import SensorSuite


@dataclass(frozen=True, eq=False)
class GyroBias:
    """A bias that a log shows.

    Attributes:
        value: (3,) in B; NaN about axes that the gyro does not measure [rad/s].
        sigma: of each axis, with plausible errors of the gyro's scale and of axes [rad/s].
        seconds: time over which the mean is taken [s].

    """

    value: Array
    sigma: float
    seconds: float

    @property
    def size(self) -> float:
        """Root mean square of an axis that the gyro measures, with its uncertainty [rad/s]."""
        return float(np.sqrt(np.nanmean(self.value**2) + self.sigma**2))

    @property
    def largest(self) -> float:
        """Largest bias about an axis [rad/s]."""
        return float(np.nanmax(np.abs(self.value)))


def gyro_bias(log: Log, suite: SensorSuite) -> GyroBias | None:
    """Return the bias that a screened log shows; None without an attitude, or for too few samples.

    Args:
        log: the log.
        suite: the sensors' noise.

    """
    given = instants_of(log) if {"attitude", "gyro"} <= suite.present().keys() else None
    if given is None or given.turning is None or "gyro" not in given.values:
        return None
    is_measured = np.ptp(log.gyro.value, axis=0) > 0
    if not is_measured.any():
        return None
    seconds = float(np.ptp(given.time))
    value = np.mean(given.values["gyro"] - given.turning, axis=0)
    ends = np.sqrt(2) * float(suite.sigmas("attitude").max()) / seconds
    white = float(suite.sigmas("gyro")[0]) / np.sqrt(seconds * suite["gyro"].rate)
    kinds = [KINDS[name] for name in ("scale", "misalignment", "mounting")]
    shares = np.linalg.norm([kind.sigma * kind.to_SI for kind in kinds])
    turned = float(shares * np.linalg.norm(np.mean(given.turning, axis=0)))
    sigma = float(np.linalg.norm([ends, white, turned]))
    return GyroBias(np.where(is_measured, value, np.nan), sigma, seconds)
