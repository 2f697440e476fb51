"""The inputs of an estimator, and the record of an estimator in the registry."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.identification.checked_log import CheckedLog
    from cpid_drake.identification.target_prior import TargetPrior
    from cpid_drake.spacecraft.spacecraft import Spacecraft

NOISE_ESTIMATED = "the sensors' noise was estimated from the log; give the sensors if you know them"
"""The warning of an estimator that needs the sensors' noise when no sensors were given."""

ESTIMATED = (
    "the samples contradict a total momentum of zero, so the momentum was estimated; say so with "
    "--momentum unknown"
)
"""The warning if the momentum was estimated because zero does not explain the samples."""

NOT_ZERO = (
    "the samples contradict a total momentum of zero, which may bias the estimate: identify with "
    "--momentum unknown"
)
"""The failed check if the momentum is not zero and has not been estimated."""

NOT_ESTIMATED = (
    "the samples contradict a total momentum of zero, and {} cannot estimate it: identify with "
    "--momentum unknown and another estimator, such as least_squares with --rows standard"
)
"""The failed check if the momentum is not zero and the estimator cannot estimate it."""

MAY_MOVE = "the total momentum may not be zero (probability {}); the intervals include it"
"""The warning if the samples do not decide whether the momentum is zero."""

SUSPECTED = 0.1
"""Probability from which an error, or a momentum, that may act is mentioned."""

MOST_NOISE = 3.0
"""Ratio of the noise to the given one above which a check fails."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The inputs of an estimator.

    Attributes:
        spacecraft: the known spacecraft.
        log: screened samples, joints in the spacecraft's order.
        states: the caller's exact states, which were not sampled by sensors; else None.
        sensors: the sensors' errors; None if unknown.
        momentum: the total momentum of spacecraft and target.
        family: the row family, for estimators that use rows.
        known_bodies: uncertainty of the known bodies; None if they are exact.

    """

    spacecraft: "Spacecraft"
    log: "CheckedLog"
    states: Telemetry | None
    sensors: SensorSuite | None
    momentum: TotalMomentum
    family: RowFamily | None = None
    known_bodies: BodyUncertainty | None = None

    def with_sensors(self) -> tuple["Problem", SensorSuite, tuple[str, ...]]:
        """Return the problem with sensors, the sensors, and a warning if they are estimated."""
        if self.sensors is not None:
            return self, self.sensors, ()
        sensors = estimate_suite(self.log.head)
        return replace(self, sensors=sensors), sensors, (NOISE_ESTIMATED,)


@dataclass(frozen=True)
class Estimator:
    """A record of an estimator in the registry `estimators.ESTIMATORS`.

    Attributes:
        name: its name on the command line, in result files and in scenarios.
        label: its name in reports.
        good_for: its recommended use, in one sentence.
        estimate: its function of the problems of all logs by name, of the total momentum (None to
            test zero), of a prior, and of a callback for progress.
        needs: returns the sensors that it needs for a row family and a momentum: at least one
            sensor of each entry.
        default_rows: returns the name of its default row family for the number of samples by
            sensor; None if it uses no rows.
        momenta: names of the total momenta that it can handle; see `TotalMomentum.name`.
        prefers_sensors: whether it is the default where sensors are given.
        uses_added_sensors: whether it uses sensors that `register_sensor` added to the table.
        uses_known_bodies: whether its covariance includes the uncertainty of the known bodies.
        uses_thrust: whether it uses the log of thrust.
        reports: number of estimates over time in a report; smaller for slow estimators.

    """

    name: str
    label: str
    good_for: str
    estimate: Callable[
        [Mapping[str, Problem], TotalMomentum | None, "TargetPrior | None", Callable[[str], None]],
        SolvedIdentification,
    ]
    needs: Callable[[RowFamily | None, TotalMomentum], tuple[tuple[str, ...], ...]]
    default_rows: Callable[[Mapping[str, int]], str] | None = None
    momenta: tuple[str, ...] = ("zero", "unknown", "known")
    prefers_sensors: bool = False
    uses_added_sensors: bool = False
    uses_known_bodies: bool = False
    uses_thrust: bool = False
    reports: int = 14
