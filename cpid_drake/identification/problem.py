"""The inputs of an estimator, and the record of an estimator in the registry."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.spacecraft.spacecraft import Spacecraft

NOISE_ESTIMATED = "the sensors' noise was estimated from the log; give the sensors if you know them"
"""The warning of an estimator that needs the sensors' noise when no sensors were given."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The inputs of an estimator.

    Attributes:
        spacecraft: the known spacecraft.
        measurements: screened samples, joints in the spacecraft's order.
        states: the caller's exact states, which were not sampled by sensors; else None.
        sensors: the sensors' errors; None if unknown.
        momentum: the total momentum of spacecraft and target.
        family: the row family, for estimators that use rows.
        known_bodies: uncertainty of the known bodies; None if they are exact.
        robust: whether to use a robust loss, where the estimator has one.

    """

    spacecraft: "Spacecraft"
    measurements: Measurements
    states: Telemetry | None
    sensors: SensorSuite | None
    momentum: TotalMomentum
    family: RowFamily | None = None
    known_bodies: BodyUncertainty | None = None
    robust: bool = False

    def with_sensors(self) -> tuple["Problem", SensorSuite, tuple[str, ...]]:
        """Return the problem with sensors, the sensors, and a warning if they are estimated."""
        if self.sensors is not None:
            return self, self.sensors, ()
        sensors = estimate_suite(self.measurements)
        return replace(self, sensors=sensors), sensors, (NOISE_ESTIMATED,)


@dataclass(frozen=True)
class Estimator:
    """A record of an estimator in the registry `estimators.ESTIMATORS`.

    Attributes:
        name: its name on the command line, in result files and in scenarios.
        label: its name in reports.
        good_for: its recommended use, in one sentence.
        estimate: its function.
        needs: returns the sensors that it needs for a row family and a momentum: at least one
            sensor of each entry.
        default_rows: returns the name of its default row family for some measurements; None if it
            uses no rows.
        momenta: names of the total momenta that it can handle; see `TotalMomentum.name`.
        most_samples: the largest number of samples of one sensor that it accepts; None for any.
        prefers_sensors: whether it is the default where sensors are given.
        uses_added_sensors: whether it uses sensors that `register_sensor` added to the table.
        reports: number of estimates over time in a report; smaller for slow estimators.

    """

    name: str
    label: str
    good_for: str
    estimate: Callable[[Problem], Identification]
    needs: Callable[[RowFamily | None, TotalMomentum], tuple[tuple[str, ...], ...]]
    default_rows: Callable[[Measurements], str] | None = None
    momenta: tuple[str, ...] = ("zero", "unknown", "known")
    most_samples: int | None = None
    prefers_sensors: bool = False
    uses_added_sensors: bool = False
    reports: int = 14


def refuse_long(measurements: Measurements, most: int, what: str) -> None:
    """Refuse more samples of one sensor than an estimator can handle in reasonable time.

    Raises:
        InputError: a sensor has more than `most` samples.

    """
    for name, samples in measurements.items():
        if len(samples) > most:
            raise InputError(
                f"{len(samples)} samples of {name} are too many for {what}; use a part of the log "
                f"with at most {most} (cpid identify: --from and --to)"
            )
