"""Arguments of `identify` and `validate`: objects, or the names and paths of the command line."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rows import RowFamily, row_family
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.checked_yaml import from_tree, load_yaml, parse_yaml
from cpid_drake.files.errors import InputError, choose_from
from cpid_drake.files.resources import resolve_model
from cpid_drake.identification.prior import TargetPrior, load_prior, prior_of_result
from cpid_drake.identification.result import Identification
from cpid_drake.logs.formats import inspect_log, refuse_problems
from cpid_drake.logs.log import Log
from cpid_drake.sensors.presets import load_sensors, sensor_presets
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.spacecraft.spacecraft_argument import require_spacecraft

EXACT_MODEL = "exact"
"""The uncertainty of a spacecraft whose model is exact."""

Kind = TypeVar("Kind")

PathLike = str | Path

LogLike = Motion | Log | PathLike
"""Exact states, a log, or its file."""


@dataclass(frozen=True, eq=False)
class Arguments:
    """The arguments of `identify.identify` besides the logs, by their names.

    Sensors are those of the first log; see `checked_log.CheckedLog.sensors`.
    """

    spacecraft: Spacecraft
    estimator: str | None = None
    rows: str | None = None
    sensors: SensorSuite | None = None
    momentum: TotalMomentum | None = None
    known_bodies: BodyUncertainty | None = None
    prior: TargetPrior | None = None
    planar: bool | None = None

    @classmethod
    def of(
        cls,
        spacecraft: Spacecraft,
        estimator: str | None = None,
        rows: str | None = None,
        sensors: SensorSuite | PathLike | None = None,
        momentum: TotalMomentum | str | None = None,
        known_bodies: BodyUncertainty | PathLike | None = None,
        prior: TargetPrior | Identification | PathLike | None = None,
        planar: bool | None = None,
    ) -> "Arguments":
        """Return the arguments, also from names and paths; raises an InputError of others."""
        require_spacecraft(spacecraft)
        return cls(
            spacecraft,
            estimator,
            rows,
            resolve_sensors(sensors),
            TotalMomentum.of(momentum),
            _resolved(
                "known_bodies", known_bodies, BodyUncertainty, "a text, or a file", read_uncertainty
            ),
            _prior_of(prior, spacecraft),
            _resolved("planar", planar, bool, "or None"),
        )

    @property
    def has_exact_bodies(self) -> bool:
        """Whether no error of the spacecraft's model is included, but by the trajectory fit."""
        return self.known_bodies is None or self.known_bodies.is_zero

    @property
    def family(self) -> RowFamily | None:
        """The row family; None for an estimator that uses none."""
        is_unknown = self.momentum is not None and self.momentum.is_unknown
        return None if self.rows is None else row_family(self.rows, is_unknown)


def resolve_logs(
    data: LogLike | Mapping[str, LogLike] | Sequence[PathLike], spacecraft: Spacecraft
) -> dict[str, Motion | Log]:
    """Return logs by their names; files are read.

    Raises:
        InputError: there is none, or it is no log; see also `inspect_log`.

    """
    if isinstance(data, Sequence) and not isinstance(data, str):
        data = {str(each): each for each in data}
    elif not isinstance(data, Mapping):
        data = {str(data) if isinstance(data, PathLike) else "log": data}
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
    """Return sensors; a preset or a file is read, or an InputError raised."""
    return _resolved("sensors", given, SensorSuite, "a preset, or a file", load_sensors)


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
    read, suites = dict[object, SensorSuite | None](), dict[str, SensorSuite | None]()
    for name in logs:
        own = given.get(name)
        if own is None:
            raise InputError(
                f"sensors: log '{name}' has none; give those of every log, or one suite for all"
            )
        key: object = id(own)
        if isinstance(own, PathLike):
            key = str(own) if str(own) in sensor_presets() else Path(own).resolve()
        suites[name] = read[key] = read.get(key) or resolve_sensors(own)
    return suites


def _prior_of(
    given: TargetPrior | Identification | PathLike | None, spacecraft: Spacecraft
) -> TargetPrior | None:
    """Return what is known of a target, also from a result, or from what `load_prior` reads."""
    frame = spacecraft.capture_frame.name()
    if isinstance(given, Identification):
        frame_of_result = frame if given.spacecraft else None
        return prior_of_result(given, "result", spacecraft.mass, frame_of_result)
    return _resolved(
        "prior",
        given,
        TargetPrior,
        "a result, or a file",
        lambda path: load_prior(path, spacecraft, frame),
    )


def _resolved(
    name: str,
    given: object,
    kind: type[Kind],
    others: str,
    read: Callable[[str], Kind] | None = None,
) -> Kind | None:
    """Return an argument of a kind; its name or its file is read."""
    if read is not None and isinstance(given, PathLike):
        return read(str(given))
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
