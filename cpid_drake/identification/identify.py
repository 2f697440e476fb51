"""`identify` and `identify_together`: a target from any data with any estimator."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.rows import RELATIVE_ROWS, row_family
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.identification.checked_log import check_log, log_of_states
from cpid_drake.identification.consistency import consistency_of
from cpid_drake.identification.diagnosis import with_cause
from cpid_drake.identification.estimators import choose_method
from cpid_drake.identification.joint import IdentifiedLog, identify_jointly
from cpid_drake.identification.momentum_test import TestedMomentum, with_tested_momentum
from cpid_drake.identification.planar import in_capture_frame, in_frame, normal_in_base
from cpid_drake.identification.problem import Problem
from cpid_drake.identification.requirements import require_sensors
from cpid_drake.identification.result import Identification
from cpid_drake.identification.seen_noise import LARGER_NOISE
from cpid_drake.identification.table_setting import TableSetting, frame_of, is_oblique
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.identification.trust import gated
from cpid_drake.identification.undeclared import with_undeclared
from cpid_drake.processes import one_thread
from cpid_drake.sensing.measurement_stream import MeasurementStream
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.sensors import SENSORS, STANDARD_SENSORS
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

THRUST_NOT_USED = (
    "thrusters fired from {} s on, and {} does not use the log of thrust: identify with "
    "--estimator trajectory_fit"
)
"""The doubt of an estimator that assumes a constant momentum while thrusters fire."""


@one_thread
def identify(
    spacecraft: Spacecraft,
    data: Telemetry | Measurements | MeasurementStream,
    *,
    estimator: str | None = None,
    rows: str | None = None,
    sensors: SensorSuite | None = None,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    prior: TargetPrior | None = None,
    planar: bool | None = None,
    is_final: bool = True,
) -> Identification:
    """Identify the target held by a spacecraft.

    Args:
        spacecraft: the known spacecraft.
        data: exact states at common times, or samples of sensors, each at its own times, as from
            `read_telemetry`, or a stream of such samples of any length, as from `open_telemetry`,
            which is read several times. The joints of measurements may be in any order. Exact
            states may belong to unconnected instants; measurements must belong to one motion.
        estimator: name of an estimator (`cpid_drake.identification.estimators.ESTIMATORS`) or of a
            row family, which means least squares on these rows. Default: the trajectory fit if
            sensors or known bodies are given and no rows, else least squares.
        rows: row family of least squares (`cpid_drake.dynamics.rows.ROW_FAMILIES`); default:
            "standard", or "relative" for data without position and velocity.
        sensors: the sensors' errors. Default: all complete samples have the same weight, and an
            estimator that needs the noise estimates it from the data.
        momentum: the total momentum of spacecraft and target; default: zero if the samples agree
            with this, else unknown.
        known_bodies: uncertainty of the spacecraft's own bodies, of the arm's geometry and of the
            grasp, whose errors the trajectory fit and the recursive fit estimate with these σ as
            prior, and include in their covariance; default: none.
        planar: whether the spacecraft floats on a table whose normal is W's z axis, such as an
            air-bearing table: only momentum in the plane is then used, because the table holds the
            others (`dynamics.plane`). Default: measurements whose tilts and heights are exactly
            zero, as those of a log of x, y and yaw, are identified in the plane, with a warning.
        is_final: whether the momentum is tested and causes are looked for; not needed for estimates
            from parts of a log that was tested as a whole, and in studies of simulated trials.

    Raises:
        InputError: the estimator or the rows are unknown, or cannot handle this momentum; the data
            contain other joints than the spacecraft's; a sensor that the estimator needs is missing
            (the message lists the estimators that could use the data); there are too few samples;
            the prior determines combinations of other unknowns than the estimator's.

    """
    log = _identified(
        spacecraft,
        data,
        estimator=estimator,
        rows=rows,
        sensors=sensors,
        momentum=momentum,
        known_bodies=known_bodies,
        planar=planar,
        is_final=is_final,
        is_part=prior is not None,
    )
    if prior is None:
        return log.found
    return _completed([log], identify_jointly([log], prior), spacecraft)


@one_thread
def identify_together(
    spacecraft: Spacecraft,
    logs: Mapping[str, Telemetry | Measurements | MeasurementStream],
    *,
    estimator: str | None = None,
    rows: str | None = None,
    sensors: SensorSuite | None = None,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    prior: TargetPrior | None = None,
    planar: bool | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> Identification:
    """Identify one target from several logs of the same spacecraft.

    Each log has its own start, momentum and biases. The result has the doubts about every log, a
    test whether the logs agree, and the separate estimates (`Identification.joint`).

    Args:
        spacecraft: the known spacecraft.
        logs: the data of each log by its name in messages.
        estimator, rows, sensors, momentum, known_bodies, prior, planar: see `identify`; `momentum`
            holds for each log.
        progress: called before every step with a short description of the step.

    Raises:
        InputError: there is no log; or for the same reasons as `identify`, with the name of the log
            before the message.

    """
    if not logs:
        raise InputError("there is no log to identify from")

    def identified(rows: str | None) -> list[IdentifiedLog]:
        found = []
        for name, data in logs.items():
            progress(f"identifying from {name}")
            with prefix_errors(name):
                log = _identified(
                    spacecraft,
                    data,
                    estimator=estimator,
                    rows=rows,
                    sensors=sensors,
                    momentum=momentum,
                    known_bodies=known_bodies,
                    planar=planar,
                    is_part=True,
                )
            found.append(replace(log, name=name))
        return found

    found = identified(rows)
    if len({log.found.rows for log in found}) > 1:  # one of them lacks the base's position
        found = identified(RELATIVE_ROWS.name)
    joint = identify_jointly(found, prior, progress)
    progress("looking for errors that the sensors do not declare")
    return _completed(found, joint, spacecraft)


def _completed(
    logs: Sequence[IdentifiedLog], found: Identification, spacecraft: Spacecraft
) -> Identification:
    """Return a joint estimate with what all logs show, and with what rigid bodies can have."""
    return _of_bodies(with_undeclared(logs, found, found.solution), spacecraft)


def _of_bodies(found: Identification, spacecraft: Spacecraft) -> Identification:
    """Return an identification with what rigid bodies can have of it."""
    return replace(found, consistency=consistency_of(found, spacecraft.tree))


def _identified(
    spacecraft: Spacecraft,
    data: Telemetry | Measurements | MeasurementStream,
    *,
    estimator: str | None,
    rows: str | None,
    sensors: SensorSuite | None,
    momentum: TotalMomentum | None,
    known_bodies: BodyUncertainty | None = None,
    planar: bool | None = None,
    is_final: bool = True,
    is_part: bool = False,
) -> IdentifiedLog:
    """Return a log with its own estimate; see `identify` and, for `is_part`, `gated`."""
    assumed = momentum or TotalMomentum.zero()
    states = None
    if isinstance(data, Telemetry):
        spacecraft.require_joints(data)
        states, log = data, log_of_states(data)
        if planar and spacecraft.tree.normal_B is None:
            spacecraft = spacecraft.on_table(normal_in_base(data.quaternion_WB))
    else:
        log = check_log(spacecraft, data, sensors, planar)
        if log.normal_B is not None:
            spacecraft = spacecraft.on_table(log.normal_B)
    table = spacecraft.tree.normal_C
    R_CF = frame_of(table) if table is not None and is_oblique(table) and not is_part else None
    if R_CF is not None:
        spacecraft = in_frame(spacecraft, R_CF)
    warnings = [*log.warnings, *map("not checked: {}".format, log.unchecked)]
    is_uncertain = known_bodies is not None and states is None
    has_sensors = sensors is not None or is_uncertain
    record, family = choose_method(
        estimator, rows, assumed, has_sensors=has_sensors, has_thrust=log.has_thrust
    )
    if family is None and record.default_rows is not None:
        family = row_family(record.default_rows(log.counts), assumed.is_unknown)
    require_sensors(log.counts, sensors, record, family, assumed)
    added = [name for name, count in log.counts.items() if count and name not in STANDARD_SENSORS]
    unused = [SENSORS[name].label for name in added]
    if unused and not record.uses_added_sensors:
        warnings.append(f"{record.name} does not use the samples of {', '.join(unused)}")
    if known_bodies is not None and not record.uses_known_bodies:
        warnings.append(
            f"{record.name} does not use the uncertainty of the spacecraft: its intervals are "
            "those of an exact model"
        )
    problem = Problem(spacecraft, log, states, sensors, assumed, family, known_bodies)
    try:
        tested = TestedMomentum(record.estimate(problem))
        if is_final and assumed.is_zero:
            is_given = momentum is not None
            tested = with_tested_momentum(record, problem, tested.found, is_given=is_given)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"{record.name} cannot calculate with these samples: they contradict each other, or "
            "are too large or too small; plot them, and compare units"
        ) from error
    found = tested.found
    everything = dict(Counter(log.rejected) + Counter(found.rejected))  # without entries of zero
    found = replace(found, rejected=everything, warnings=(*warnings, *found.warnings))
    if R_CF is not None:
        found = in_capture_frame(found, R_CF)
    elif spacecraft.tree.normal_B is not None:
        found = replace(found, table=TableSetting(table))
    if is_final and not is_part:
        found = _of_bodies(found, spacecraft)
    found = gated(found, tested.doubts, is_part=is_part)
    found = replace(found, doubts=(*log.doubts, *found.doubts))
    if log.has_thrust and not record.uses_thrust:
        text = THRUST_NOT_USED.format(f"{log.first_burn:.4g}", record.name)
        found = replace(found, doubts=(text, *found.doubts))
    if is_final and not log.doubts:  # else the cause is said already
        known = len(found.doubts)
        # Exact states may belong to instants that are not connected.
        is_connected = states is None
        if not is_part and (tested.free is not None or not tested.doubts):
            alone = found
            best = tested.free or tested.found  # a steady force looks like a momentum
            own = found if tested.free is None else replace(best, table=found.table)
            log_alone = IdentifiedLog("", record, problem, own)
            found = with_undeclared([log_alone], found, best.solution)
            if found.solution is not alone.solution:
                found = _of_bodies(found, spacecraft)
        is_noisy = any(LARGER_NOISE in doubt for doubt in found.doubts)
        # The causes know no forces, and larger noise makes all of them likely.
        if len(found.doubts) == known and not (log.has_thrust or is_noisy):
            found = with_cause(spacecraft, log, sensors, found, is_connected=is_connected)
    return IdentifiedLog("", record, problem, found)
