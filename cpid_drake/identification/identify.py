"""`identify`: the one function that identifies a target from any data with any estimator."""

from collections import Counter
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import choose_method
from cpid_drake.identification.problem import Problem, refuse_long
from cpid_drake.identification.requirements import (
    check_log,
    in_joint_order,
    measurements_of_states,
    require_sensors,
)
from cpid_drake.identification.result import Identification
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.sensors import SENSORS, STANDARD_SENSORS
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


def identify(
    spacecraft: Spacecraft,
    data: Telemetry | Measurements,
    *,
    estimator: str | None = None,
    rows: str | None = None,
    sensors: SensorSuite | None = None,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    robust: bool = False,
) -> Identification:
    """Identify the target held by a spacecraft.

    Args:
        spacecraft: the known spacecraft.
        data: exact states at common times, or samples of sensors, each at its own times, as from
            `read_telemetry`. The joints of measurements may be in any order. Exact states may
            belong to unconnected instants; measurements must belong to one motion.
        estimator: name of an estimator (`cpid_drake.identification.estimators.ESTIMATORS`) or of a
            row family, which means least squares on these rows. Default: the trajectory fit if
            sensors are given and no rows, else least squares.
        rows: row family of least squares (`cpid_drake.dynamics.rows.ROW_FAMILIES`); default:
            "standard", or "relative" for data without position and velocity.
        sensors: the sensors' errors. Default: all complete samples have the same weight, and an
            estimator that needs the noise estimates it from the data.
        momentum: the total momentum of spacecraft and target; default: zero.
        known_bodies: uncertainty of the spacecraft's own bodies, whose effect the trajectory fit
            and the momentum filter add to their covariance; default: none.
        robust: whether the trajectory fit uses the Huber loss instead of squares.

    Raises:
        InputError: the estimator or the rows are unknown, or cannot handle this momentum; the data
            contain other joints than the spacecraft's; a sensor that the estimator needs is missing
            (the message lists the estimators that could use the data); rates contradict positions,
            for example by their unit or frame; there are too few or too many samples.

    """
    momentum = momentum or TotalMomentum.zero()
    states, warnings, rejected = None, [], dict[str, int]()
    if isinstance(data, Telemetry):
        spacecraft.require_joints(data)
        states, measurements = data, measurements_of_states(data)
    else:
        measurements, rejected = screen(in_joint_order(data, spacecraft))
        warnings = check_log(spacecraft, measurements)
    record, family = choose_method(estimator, rows, momentum, has_sensors=sensors is not None)
    if family is None and record.default_rows is not None:
        family = row_family(record.default_rows(measurements), momentum.is_unknown)
    require_sensors(measurements, sensors, record, family, momentum)
    added = {name: s for name, s in measurements.items() if name not in STANDARD_SENSORS}
    unused = [SENSORS[name].label for name, samples in added.items() if len(samples)]
    if unused and not record.uses_added_sensors:
        warnings.append(f"{record.name} does not use the samples of {', '.join(unused)}")
    if record.most_samples is not None:
        refuse_long(measurements, record.most_samples, f"the {record.label}")
    problem = Problem(
        spacecraft, measurements, states, sensors, momentum, family, known_bodies, robust
    )
    try:
        found = record.estimate(problem)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"{record.name} cannot calculate with these samples: they contradict each other, or "
            "are too large or too small; plot them, and compare units"
        ) from error
    everything = dict(Counter(rejected) + Counter(found.rejected))  # without entries of zero
    return replace(found, rejected=everything, warnings=(*warnings, *found.warnings))
