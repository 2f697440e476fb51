"""`identify`: a target from any data with any estimator."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.one_thread import one_thread
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.identification.arguments import (
    LogLike,
    PathLike,
    require_spacecraft,
    resolve_bodies,
    resolve_logs,
    resolve_momentum,
    resolve_planar,
    resolve_prior,
    resolve_sensors_by_log,
)
from cpid_drake.identification.checked_log import Arguments, CheckedLog, check_log
from cpid_drake.identification.checks import Check, label_of, rejection_checks
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.estimators import (
    ESTIMATORS,
    Estimator,
    require_sensors,
    with_method,
)
from cpid_drake.identification.log_conventions import with_conventions
from cpid_drake.identification.model_sensitivity import hidden_sensitivity
from cpid_drake.identification.planar import PROPOSED, could_be_planar, one_normal
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import SPACECRAFT, Identification
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.sensors.error_kinds import bodies_of as errors_of_bodies
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

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
    require_spacecraft(spacecraft)
    named = resolve_logs(data, spacecraft)
    suites, momentum = resolve_sensors_by_log(sensors, named), resolve_momentum(momentum)
    [suite, *_] = suites.values()
    known_bodies, prior = resolve_bodies(known_bodies), resolve_prior(prior, spacecraft)
    planar = resolve_planar(planar)
    where, logs = {name: name if len(named) > 1 else "" for name in named}, dict[str, CheckedLog]()
    for name, each in named.items():
        progress(f"checking {name}")
        with prefix_errors(where[name]):
            own = check_log(spacecraft, each, suites[name], planar)
        logs[name] = replace(own, sensors=suites[name])
    normals = {name: log.normal_B for name, log in logs.items() if log.normal_B is not None}
    if normals and len(normals) < len(logs):
        free = next(name for name in logs if name not in normals)
        raise InputError(
            f"{next(iter(normals))} has x, y and yaw only, as on a table, and {free} has not: say "
            "--planar or --no-planar"
        )
    if normals:
        spacecraft = spacecraft.on_table(one_normal(normals))
    arguments = Arguments(
        spacecraft, estimator, rows, suite, momentum, known_bodies, prior, bool(normals)
    )
    arguments = with_method(arguments, logs)
    assert arguments.estimator is not None
    method = ESTIMATORS[arguments.estimator]
    for name, log in logs.items():
        with prefix_errors(where[name]):
            require_sensors(log, arguments)
            if wrong := with_conventions(log, arguments).conventions.failures:
                raise InputError("; ".join(wrong))
    progress("identifying")
    try:
        found = method.estimate(arguments, logs, progress)
    except (np.linalg.LinAlgError, InputError) as error:
        text = str(error)
        if isinstance(error, np.linalg.LinAlgError):
            text = (
                f"{method.name} cannot calculate with these samples ({error}): plot them, and "
                "compare units with the sensors' file and the model"
            )
        found_causes = (log.failures or [_convention(log, spacecraft)] for log in logs.values())
        causes = "; ".join(dict.fromkeys(filter(None, chain.from_iterable(found_causes))))
        raise InputError(f"most likely, {causes}: {text}" if causes else text) from error
    tree = spacecraft.tree
    found = replace(found, is_planar=tree.normal_B is not None, normal_C=tree.normal_C)
    found = checked(_with_logs(found, logs, method, not arguments.has_exact_bodies), tree)
    given = (each or SensorSuite() for each in suites.values())
    is_exact = method.uses_rows or errors_of_bodies(known_bodies, *given) is None
    if is_exact:
        found = replace(found, given=(SPACECRAFT,))
    if is_exact and arguments.has_exact_bodies:
        has_thrust = any(log.measurements.has_thrust for log in logs.values())
        has_scale = has_thrust or found.momentum == "known"
        beyond = hidden_sensitivity(found.parameters, tree, has_scale=has_scale)
        found = replace(found, sensitivity={**found.sensitivity, **beyond})
    [log, *others] = logs.values()
    could_be = planar is None and could_be_planar(tree, log.measurements.attitude.value)
    if could_be and not (found.passed and found.is_complete):
        found = replace(found, warnings=(*found.warnings, PROPOSED))
    if tree.jointed and tree.lumped.capture_body == 0:
        found = replace(found, warnings=(*found.warnings, HELD_BY_BASE))
    if others or not found.failures or log.failures:
        return found
    convention = _convention(log, spacecraft)
    if not convention:
        return found
    return replace(found, checks=(Check("log", f"most likely, {convention}"), *found.checks))


def _convention(log: CheckedLog, spacecraft: Spacecraft) -> str:
    """Return the convention that explains a log of which the identification failed; or nothing."""
    if spacecraft.tree.normal_B is not None:
        return ""  # the plane's few equations do not distinguish conventions
    return check_conventions(log.measurements, spacecraft.tree).sentence


def _without_errors(log: CheckedLog) -> Iterator[str]:
    """Yield the sensors of a log that are not used, because the sensors' file has no errors."""
    if log.sensors is None:
        return
    for name in SENSORS:
        if len(log.measurements[name]) and name not in log.sensors.present():
            yield (
                f"the {label_of(name)} of the log is not used: the sensors' file has no "
                f"'{name}:' with its rate and noise"
            )


def _with_logs(
    found: Identification, logs: Mapping[str, CheckedLog], method: Estimator, is_uncertain: bool
) -> Identification:
    """Return an identification with what the checks of its logs say."""
    warnings, checks, rejected = list[str](), list[Check](), Counter(found.rejected)
    for name, log in logs.items():
        where = f"{name}: " if len(logs) > 1 else ""
        failed = list(log.failures)
        if log.measurements.has_thrust and method.uses_rows:
            failed.append(THRUST_NOT_USED.format(f"{log.measurements.first_burn:.4g}", method.name))
        said = [*log.warnings, *(f"not checked: {text}" for text in log.conventions.unchecked)]
        said += [] if method.uses_rows else _without_errors(log)
        warnings += [where + text for text in said]
        checks += [Check("log", where + text) for text in failed]
        checks += rejection_checks(log.rejected, log.counts, where)
        rejected.update(log.rejected)
    if is_uncertain and method.uses_rows:
        warnings.append(
            f"{method.name} does not use the uncertainty of the spacecraft: its intervals are "
            "those of an exact model"
        )
    return replace(
        found,
        warnings=(*dict.fromkeys(warnings), *found.warnings),
        checks=(*checks, *found.checks),
        rejected={name: count for name, count in rejected.items() if count},
    )
