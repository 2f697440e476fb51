"""What is known besides the logs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.sensors.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.identification.checked_log import CheckedLog
    from cpid_drake.identification.prior import TargetPrior
    from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class Known:
    """What is known besides the logs, and holds for all of them.

    Attributes:
        spacecraft: the known spacecraft.
        sensors: the sensors' errors; None if they are unknown.
        momentum: the total momentum; None to test whether it is zero, and to estimate it if not.
        known_bodies: uncertainty of the spacecraft; None if it is exact.
        prior: what is known about the target; None for nothing.
        family: the row family, for an estimator that uses rows.

    """

    spacecraft: "Spacecraft"
    sensors: SensorSuite | None = None
    momentum: TotalMomentum | None = None
    known_bodies: BodyUncertainty | None = None
    prior: "TargetPrior | None" = None
    family: RowFamily | None = None


def suite_of(sensors: SensorSuite | None, log: "CheckedLog") -> tuple[SensorSuite, tuple[str, ...]]:
    """Return the sensors' errors, by default as the log shows them, and a warning if they are."""
    if sensors is not None:
        return sensors, ()
    text = "the sensors' noise was estimated from the log; give the sensors if you know them"
    return estimate_suite(log.measurements), (text,)
