"""`identify`: a target from any data with any estimator."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain

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
    resolve_bodies,
    resolve_logs,
    resolve_planar,
    resolve_prior,
    resolve_sensors_by_log,
)
from cpid_drake.identification.checked_log import CheckedLog, check_logs
from cpid_drake.identification.checks import Check
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.estimators import (
    Estimator,
    choose,
)
from cpid_drake.identification.log_conventions import with_conventions
from cpid_drake.identification.log_sensors import exact_sensors, excluded_bias
from cpid_drake.identification.planar import PROPOSED, could_be_planar
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import SPACECRAFT, Identification
from cpid_drake.identification.words import label_of
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.log import Log
from cpid_drake.sensors.error_kinds import bodies_of as errors_of_bodies
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.spacecraft.spacecraft_argument import require_spacecraft

THRUST_NOT_USED = (
    "thrusters fired from {} s on, and {} does not use the log of thrust: identify with "
    "--estimator trajectory_fit"
)
"""The failed check of an estimator that assumes a constant momentum while thrusters fire."""

HELD_BY_BASE = (
    "the capture frame is fixed to the base: no joint moves the target relative to the base, and "
    "only the base's reaction to the joints, or to thrusters, shows it"
)
"""The warning about a target that the base itself holds."""


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
    suites, momentum = resolve_sensors_by_log(sensors, data), TotalMomentum.of(momentum)
    [suite, *_] = suites.values()
    known_bodies, prior = resolve_bodies(known_bodies), resolve_prior(prior, spacecraft)
    planar = resolve_planar(planar)
    given = Arguments(spacecraft, estimator, rows, suite, momentum, known_bodies, prior, planar)
    method, arguments, logs = _prepared(given, data, suites, progress)
    # Fit and answer.
    progress("identifying")
    try:
        result = _estimated(method, arguments, logs, progress)
    except (np.linalg.LinAlgError, InputError) as error:
        raise _explained(error, method, arguments, logs) from error
    return _with_hints(result, arguments.spacecraft, list(logs.values()), planar)


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
    result = checked(_with_logs(result, logs, method, arguments), tree)
    suites = (log.sensors or SensorSuite() for log in logs.values())
    if method.uses_rows or errors_of_bodies(arguments.known_bodies, *suites) is None:
        result = replace(result, given=(SPACECRAFT,))
    return result


def _explained(
    error: Exception, method: Estimator, arguments: Arguments, logs: Mapping[str, CheckedLog]
) -> InputError:
    """Return the error of an estimator with what most likely causes it."""
    text = str(error)
    if isinstance(error, np.linalg.LinAlgError):
        text = (
            f"{method.name} cannot calculate with these samples ({error}): plot them, and "
            "compare units with the sensors' file and the model"
        )
    reasons = (log.failures or [_convention(log, arguments.spacecraft)] for log in logs.values())
    causes = "; ".join(dict.fromkeys(filter(None, chain.from_iterable(reasons))))
    return InputError(f"most likely, {causes}: {text}" if causes else text)


def _convention(log: CheckedLog, spacecraft: Spacecraft) -> str:
    """Return the convention that explains a log of which the identification failed; or nothing."""
    if spacecraft.tree.normal_B is not None:
        return ""  # the plane's few equations do not distinguish conventions
    return check_conventions(log.measurements, spacecraft.tree).sentence


def _with_logs(
    result: Identification,
    logs: Mapping[str, CheckedLog],
    method: Estimator,
    arguments: Arguments,
) -> Identification:
    """Return an identification with what the checks of its logs say."""
    warnings, checks, rejected = list[str](), list[Check](), Counter(result.rejected)
    for log in logs.values():
        texts = [*log.warnings, *(f"not checked: {text}" for text in log.conventions.unchecked)]
        failed = list(log.failures)
        if not method.uses_rows:
            texts += [
                f"the {label_of(name)} of the log is not used: the sensors' file has no '{name}:' "
                "with its rate and noise"
                for name in SENSORS
                if log.sensors and len(log.measurements[name]) and name not in log.sensors.present()
            ]
            texts += exact_sensors(log.sensors or SensorSuite())
        elif log.measurements.has_thrust:
            failed.append(THRUST_NOT_USED.format(f"{log.measurements.first_burn:.4g}", method.name))
        warnings += [log.where + text for text in texts]
        checks += [Check("log", log.where + text) for text in failed]
        for name in [each for each in SENSORS if log.rejected.get(each)]:
            count = log.rejected[name]
            total = count + log.counts.get(name, 0)
            text = f"{log.where}{count} of {total} samples of {name} could not be used"
            checks.append(Check.of(f"rejected share of {name}", text, count / total, 0.5))
        rejected.update(log.rejected)
    if method.uses_rows and not arguments.has_exact_bodies:
        warnings.append(
            f"{method.name} does not use the uncertainty of the spacecraft: its intervals are "
            "those of an exact model"
        )
    return replace(
        result,
        warnings=(*dict.fromkeys(warnings), *result.warnings),
        checks=(*checks, *result.checks),
        rejected={name: count for name, count in rejected.items() if count},
    )


def _with_hints(
    result: Identification, spacecraft: Spacecraft, logs: Sequence[CheckedLog], planar: bool | None
) -> Identification:
    """Return an identification with what may explain that it failed, or is not whole."""
    tree, [log, *others] = spacecraft.tree, logs
    could_be = planar is None and could_be_planar(tree, log.measurements.attitude.value)
    if could_be and not (result.passed and result.is_complete):
        result = replace(result, warnings=(*result.warnings, PROPOSED))
    if tree.jointed and tree.lumped.capture_body == 0:
        result = replace(result, warnings=(*result.warnings, HELD_BY_BASE))
    biases = [text for each in logs if (text := excluded_bias(each))]
    if result.passed:
        result = replace(result, warnings=(*result.warnings, *biases))
    else:
        causes = (Check("log", f"most likely, {text}") for text in biases)
        result = replace(result, checks=(*causes, *result.checks))
    if result.passed or others or log.failures or biases:
        return result
    convention = _convention(log, spacecraft)
    if not convention:
        return result
    return replace(result, checks=(Check("log", f"most likely, {convention}"), *result.checks))
