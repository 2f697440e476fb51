"""`identify`: a target from any data with any estimator."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.arguments import (
    Arguments,
    LogLike,
    PathLike,
    resolve_logs,
    resolve_sensors_by_log,
)
from cpid_drake.identification.checked_log import CheckedLog, check_logs
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.estimators import (
    Estimator,
    choose,
)
from cpid_drake.identification.log_conventions import with_conventions
from cpid_drake.identification.log_notes import explained, with_causes, with_logs
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import SPACECRAFT, Identification
from cpid_drake.logs.log import Log
from cpid_drake.sensors.error_kinds import bodies_of as errors_of_bodies
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.spacecraft.spacecraft_argument import require_spacecraft


@one_thread
def identify(
    spacecraft: Spacecraft,
    data: LogLike | Mapping[str, LogLike] | Sequence[PathLike],
    *,
    estimator: str | None = None,
    rows: str | None = None,
    sensors: SensorSuite | PathLike | Mapping[str, SensorSuite | PathLike] | None = None,
    momentum: TotalMomentum | str | None = None,
    known_bodies: BodyUncertainty | PathLike | None = None,
    prior: TargetPrior | Identification | PathLike | None = None,
    planar: bool | None = None,
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Identify the target held by a spacecraft, from one log or from several.

    Each of several logs has its own start, momentum, forces and biases; all share the target and
    the errors of sensors and of the spacecraft. The result then has a test whether the logs agree,
    and their separate estimates (`Identification.logs`).

    Names and paths are accepted where the command line accepts them: of logs, sensors, the
    momentum, uncertainty of the spacecraft and the prior.

    Args:
        spacecraft: the spacecraft model.
        data: exact states at common times, or samples of sensors, each at its own times, as from
            `read_log`, or the path of a log in the package's own columns; of several logs by their
            names, or several paths. The joints of measurements may be in
            any order. Exact states may belong to unconnected instants; measurements must belong to
            one motion.
        estimator: name of an estimator (`cpid_drake.identification.estimators.ESTIMATORS`) or of a
            row family, which means least squares on these rows. Default: the trajectory fit, but
            least squares if rows are given, without attitude, and for exact states: also for
            samples, without sensors and uncertain bodies, whose momentum is constant to 1e-5.
        rows: row family of least squares (`cpid_drake.dynamics.rows.ROW_FAMILIES`); default:
            "standard", or "relative" for data without position and velocity.
        sensors: the sensors' errors, or those of each log by its name: logs with the same object,
            preset or file have the same hardware, and others have constant errors of their own. Of
            errors whose σ is not stated, the trajectory fit takes a plausible σ. Default: all
            complete samples have the same weight, and an estimator that needs the noise estimates
            it from the data.
        momentum: the total momentum of spacecraft and target, or "zero" or "unknown"; default: zero
            if the samples agree with this, else unknown.
        known_bodies: uncertainty of the spacecraft's bodies, of the arm's geometry and of the
            grasp, whose errors the trajectory fit and the recursive fit estimate with these σ as
            prior, and include in their covariance; `BodyUncertainty()` if they are exact. Default:
            the trajectory fit includes 1 % of masses and inertias and 5 mm of each centre of mass,
            unless the sensors of all logs say `unstated: exact`.
        prior: what is known about the target, such as another result; default: nothing.
        planar: whether the spacecraft floats on a table whose normal is W's z axis, such as an
            air-bearing table: only momentum in the plane is then used, because the table holds the
            others (`dynamics.plane`). Default: measurements whose tilts and heights are exactly
            zero, as those of a log of x, y and yaw, are identified in the plane, with a warning.
        progress: called before every step with a short description of the step; if it returns
            False, the trajectory fit ends with the result so far, which fails the check of
            convergence.

    Raises:
        InputError: an argument is of another type; there is no log, or it cannot be read; a name of
            sensors is no log, or a log has none; the estimator or the rows are unknown, or cannot
            handle this momentum; the data contain other joints than the spacecraft's; another
            convention explains a log clearly better than the one it is read in; a sensor that
            the estimator needs is missing (the message lists the estimators that could use the
            data); there are too few samples; the prior determines combinations of other unknowns
            than the estimator's.

    """
    # Arguments: objects, of names and paths too.
    require_spacecraft(spacecraft)
    data = resolve_logs(data, spacecraft)
    suites = resolve_sensors_by_log(sensors, data)
    [suite, *_] = suites.values()
    options = estimator, rows, suite, momentum, known_bodies, prior, planar
    given = Arguments.of(spacecraft, *options)
    method, arguments, logs = _prepared(given, data, suites, progress)
    # Fit and answer.
    progress("identifying")
    try:
        result = _estimated(method, arguments, logs, progress)
    except (np.linalg.LinAlgError, InputError) as error:
        raise explained(error, method.name, arguments.spacecraft, logs.values()) from error
    return with_causes(result, arguments.spacecraft, [*logs.values()], planar)


@one_thread
def identify_parts(
    given: Arguments,
    data: Log,
    ends: Sequence[float],
    progress: Callable[[str], object] = lambda step: None,
) -> list[tuple[float, Identification]]:
    """Return the estimates from growing parts of one log, each with the end of its part.

    The parts are screened with the whole log and have its conventions. Parts that are too short to
    say anything are left out.

    Args:
        given: the arguments of `identify`.
        data: the log.
        ends: ends of the parts [s]; all start at 0.
        progress: see `identify`.

    Raises:
        InputError: see `identify`.

    """
    method, arguments, logs = _prepared(given, {"log": data}, {"log": given.sensors}, progress)
    estimates = []
    for end in ends:
        progress(f"identifying from the first {end:.4g} s")
        part = {name: log.between(0.0, end) for name, log in logs.items()}
        with suppress(InputError, np.linalg.LinAlgError):
            estimates.append((end, _estimated(method, arguments, part, progress)))
    return estimates


def _prepared(
    given: Arguments,
    data: Mapping[str, Motion | Log],
    suites: Mapping[str, SensorSuite | None],
    progress: Callable[[str], object],
) -> tuple[Estimator, Arguments, dict[str, CheckedLog]]:
    """Return the estimator, its arguments, and the checked logs, which contradict no convention."""
    # Logs: screened samples, and whether a table carries the spacecraft.
    spacecraft, logs = check_logs(given.spacecraft, data, suites, given.planar, progress)
    is_planar = spacecraft.tree.normal_B is not None
    # Estimator: the named one, or the best for these logs.
    method, arguments = choose(replace(given, spacecraft=spacecraft, planar=is_planar), logs)
    for log in logs.values():
        with prefix_errors(log.label):
            if wrong := with_conventions(log, arguments).conventions.failures:
                raise InputError("; ".join(wrong))
    return method, arguments, logs


def _estimated(
    method: Estimator,
    arguments: Arguments,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object],
) -> Identification:
    """Return the answer with what its logs, its body and its assumptions say."""
    result, tree = method.estimate(arguments, logs, progress), arguments.spacecraft.tree
    result = replace(result, is_planar=tree.normal_B is not None, normal_C=tree.normal_C)
    result = checked(with_logs(result, logs.values(), method, arguments), tree)
    suites = (log.sensors or SensorSuite() for log in logs.values())
    if method.uses_rows or errors_of_bodies(arguments.known_bodies, *suites) is None:
        result = replace(result, given=(SPACECRAFT,))
    return result
