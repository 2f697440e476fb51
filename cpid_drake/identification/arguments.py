"""Arguments of `identify` and `validate`: objects, or the names and paths of the command line."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.checked_yaml import from_tree, load_yaml, parse_yaml
from cpid_drake.files.errors import InputError, choose_from
from cpid_drake.files.resources import resolve_model
from cpid_drake.identification.prior import TargetPrior, load_prior, prior_of_result
from cpid_drake.identification.result import Identification
from cpid_drake.logs.files import inspect_log, refuse_problems
from cpid_drake.logs.log import Log
from cpid_drake.sensors.presets import load_sensors, sensor_presets
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

EXACT_MODEL = "exact"
"""The uncertainty of a spacecraft whose model is exact."""

Kind = TypeVar("Kind")

PathLike = str | Path

LogLike = Motion | Log | PathLike
"""Exact states, a log, or its file."""


def require_spacecraft(given: object) -> None:
    """Refuse what is no spacecraft.

    Raises:
        InputError: it is a path, or anything else.

    """
    if isinstance(given, Spacecraft):
        return
    remedy = f"Spacecraft({str(given)!r}, base=..., capture_frame=...)"
    if not isinstance(given, PathLike):
        remedy = "Spacecraft(model, base=..., capture_frame=...)"
    raise InputError(
        f"the spacecraft must be a Spacecraft, not {given!r:.80}: a model alone does not say which "
        f"body is the base and which frame holds the target; give {remedy}"
    )


def resolve_logs(
    data: LogLike | Mapping[str, LogLike] | Sequence[PathLike], spacecraft: Spacecraft
) -> dict[str, Motion | Log]:
    """Return logs by their names; files are read.

    Raises:
        InputError: there is none, or it is no log; see also `inspect_log`.

    """
    if isinstance(data, Sequence) and not isinstance(data, str):
        data = {str(each): each for each in data}
    elif isinstance(data, PathLike):
        data = {str(data): data}
    elif not isinstance(data, Mapping):
        data = {"log": data}
    if not data:
        raise InputError("there is no log to identify from")
    return {name: _log_of(name, each, spacecraft) for name, each in data.items()}


def _log_of(name: str, given: LogLike, spacecraft: Spacecraft) -> Motion | Log:
    if isinstance(given, PathLike):
        file = inspect_log(given, joints=spacecraft.joint_names)
        refuse_problems(file.problems, str(given))
        return file.log
    if not isinstance(given, (Motion, Log)):
        raise InputError(
            f"'{name}' must be a Log, a Motion, or the path of a log, not {type(given).__name__}: "
            "`from_columns` makes a log of columns in memory"
        )
    return given


def resolve_sensors(given: SensorSuite | PathLike | None) -> SensorSuite | None:
    """Return sensors; a preset or a file is read.

    Raises:
        InputError: they are no sensors; see also `load_sensors`.

    """
    if isinstance(given, PathLike):
        return load_sensors(given)
    return _checked("sensors", given, SensorSuite, "a preset, or a file")


def resolve_sensors_by_log(
    given: SensorSuite | PathLike | Mapping[str, SensorSuite | PathLike] | None,
    logs: Collection[str],
) -> dict[str, SensorSuite | None]:
    """Return the sensors of each log: one object for each preset and each file.

    Raises:
        InputError: a name is no log, or a log has no sensors; see also `resolve_sensors`.

    """
    if not isinstance(given, Mapping):
        return dict.fromkeys(logs, resolve_sensors(given))
    for name in given:
        if name not in logs:
            raise InputError(f"sensors: there is no log '{name}'; {choose_from(name, logs)}")
    read, found = dict[object, SensorSuite | None](), dict[str, SensorSuite | None]()
    for name in logs:
        own = given.get(name)
        if own is None:
            raise InputError(
                f"sensors: log '{name}' has none; give those of every log, or one suite for all"
            )
        key: object = id(own)
        if isinstance(own, PathLike):
            key = str(own) if str(own) in sensor_presets() else Path(own).resolve()
        found[name] = read[key] = read.get(key) or resolve_sensors(own)
    return found


def resolve_bodies(given: BodyUncertainty | PathLike | None) -> BodyUncertainty | None:
    """Return the uncertainty of a spacecraft; a text or a file is read.

    Raises:
        InputError: it is none; see also `read_uncertainty`.

    """
    if isinstance(given, PathLike):
        return read_uncertainty(str(given))
    return _checked("known_bodies", given, BodyUncertainty, "a text, or a file")


def resolve_prior(
    given: TargetPrior | Identification | PathLike | None, spacecraft: Spacecraft
) -> TargetPrior | None:
    """Return what is known of a target, also from a result; a file is read.

    Raises:
        InputError: it is none; see also `load_prior`.

    """
    if isinstance(given, PathLike):
        return load_prior(str(given), spacecraft, spacecraft.capture_frame.name())
    if isinstance(given, Identification):
        frame = spacecraft.capture_frame.name() if given.spacecraft else None
        return prior_of_result(given, "result", spacecraft, frame)
    return _checked("prior", given, TargetPrior, "a result, or a file")


def resolve_momentum(given: TotalMomentum | str | None) -> TotalMomentum | None:
    """Return a total momentum, also by its name.

    Raises:
        InputError: there is none of this name.

    """
    if isinstance(given, str):
        return TotalMomentum.named(given)
    return _checked("momentum", given, TotalMomentum, "zero, or unknown")


def resolve_planar(given: bool | None) -> bool | None:
    """Return whether a table carries a spacecraft.

    Raises:
        InputError: it is neither true, false nor None.

    """
    return _checked("planar", given, bool, "or None")


def _checked(name: str, given: object, kind: type[Kind], others: str) -> Kind | None:
    if given is None or isinstance(given, kind):
        return given
    raise InputError(f"{name} must be a {kind.__name__}, {others}, not {given!r:.80}")


def read_uncertainty(text: str) -> BodyUncertainty:
    """Return an uncertainty from a YAML file, or from a text such as "mass=0.01,grasp_mm=2".

    Args:
        text: the path of a YAML file with the attributes of `BodyUncertainty` as keys, pairs
            KEY=NUMBER with commas between them, or "exact".

    Raises:
        InputError: no such file, not YAML, unknown keys, or values that are not numbers >= 0.

    """
    whole = "the uncertainty of the spacecraft model"
    if text == EXACT_MODEL:
        return BodyUncertainty()
    if "=" not in text:
        return load_yaml(BodyUncertainty, resolve_model(Path(text)), text, whole)
    tree = parse_yaml(f"{{{text.replace('=', ': ')}}}".encode(), text)
    return from_tree(BodyUncertainty, tree, text, whole)
