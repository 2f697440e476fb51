"""From a telemetry file to a result, with all that was read on the way: what a report is about."""

import hashlib
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cpid_drake.errors import InputError
from cpid_drake.identification.description import result_of
from cpid_drake.identification.result_files import IdentificationResult, SpacecraftReference
from cpid_drake.identification.telemetry_identification import LogIdentification, identify_log
from cpid_drake.resources import resolve_model
from cpid_drake.sensing.files.telemetry_files import inspect_telemetry, refuse_problems
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True)
class Request:
    """What is to be identified from what, as `cpid identify` is told.

    Attributes:
        telemetry: a file or a bag's folder.
        spacecraft: the known spacecraft.
        estimator, rows: see `telemetry_identification.identify_log`.
        sensors: name of a preset or a YAML file; None if nothing is known about them.
        unknown_momentum: whether the total momentum is unknown instead of zero.
        start, end: first and last time to use [s]; None for all.
        topics: of a bag, by kind.
        leave_out_bad: whether to leave out rows that have a problem.

    """

    telemetry: str
    spacecraft: SpacecraftReference
    estimator: str | None = None
    rows: str | None = None
    sensors: str | None = None
    unknown_momentum: bool = False
    start: float | None = None
    end: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    leave_out_bad: bool = False

    def command(self) -> str:
        """Return the line for a shell that asks the same."""
        craft = self.spacecraft
        words = ["cpid", "identify", self.telemetry, "--spacecraft", craft.model]
        words += ["--base", craft.base, "--capture-frame", craft.capture_frame]
        options = {
            "--estimator": self.estimator,
            "--rows": self.rows,
            "--sensors": self.sensors,
            "--from": self.start,
            "--to": self.end,
        }
        for option, value in options.items():
            words += [] if value is None else [option, str(value)]
        for name, folder in craft.packages.items():
            words += ["--package", f"{name}={folder}"]
        for kind, name in self.topics.items():
            words += ["--topic", f"{kind}={name}"]
        words += ["--unknown-momentum"] if self.unknown_momentum else []
        words += ["--leave-out-bad"] if self.leave_out_bad else []
        return shlex.join(words)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was identified, and what from.

    Attributes:
        request: what was asked.
        spacecraft: the known spacecraft.
        measurements: the samples in the window; their time starts at the first.
        suite: the sensors that were given, if any.
        found: the identification.
        result: the same as it is written to a file.
        ignored: columns of the file without a meaning.

    """

    request: Request
    spacecraft: Spacecraft
    measurements: Measurements
    suite: SensorSuite | None
    found: LogIdentification
    result: IdentificationResult
    ignored: tuple[str, ...]


def identify_file(
    request: Request, progress: Callable[[str], None] = lambda step: None
) -> Evidence:
    """Identify what a spacecraft holds from a telemetry file.

    Args:
        request: what is asked.
        progress: called with a few words before every step.

    Raises:
        InputError: a model, sensors or telemetry that cannot be read or used; see the functions
            that read them.

    """
    craft, where = request.spacecraft, request.telemetry
    progress("reading the model")
    spacecraft = Spacecraft(
        craft.model, base=craft.base, capture_frame=craft.capture_frame, packages=craft.packages
    )
    suite = load_sensors(request.sensors) if request.sensors is not None else None
    progress("reading the telemetry")
    file = inspect_telemetry(where, topics=request.topics)
    if not request.leave_out_bad:
        refuse_problems(file, where)
    measurements, times = _window(file.measurements, request)
    progress("identifying")
    try:
        found = identify_log(
            spacecraft,
            measurements,
            estimator=request.estimator,
            rows=request.rows,
            suite=suite,
            unknown_momentum=request.unknown_momentum,
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    for name, count in file.partial.items():
        found.rejected[name] = found.rejected.get(name, 0) + count
    if file.problems.count:
        found.rejected["rows"] = file.problems.count
    source = {
        "telemetry": where,
        "sha256": file_hash(where),
        "sensors": request.sensors,
        "unknown_momentum": request.unknown_momentum,
        "topics": dict(request.topics),
        "leave_out_bad": request.leave_out_bad,
        "command": request.command(),
        **times,
    }
    result = result_of(found, craft, source)
    return Evidence(request, spacecraft, measurements, suite, found, result, file.ignored)


def request_of_result(result: IdentificationResult, where: str) -> Request:
    """Return what a result file says was asked.

    Its telemetry is looked for where it was, and beside the result file.

    Args:
        result: as read from the file.
        where: the result file.

    Raises:
        InputError: it does not say what from, or that is not there any more, or has changed since.

    """
    source = result.details.get("source")
    if not isinstance(source, dict):
        raise InputError("the result does not say what it was made from")

    def take(key: str, *kinds: type, default: object = None) -> object:
        value = source.get(key, default)
        if not isinstance(value, kinds) or isinstance(value, bool) != (bool in kinds):
            raise InputError(f"the result's source.{key} is {value!r:.60}, which cannot be")
        return value

    telemetry, sha256 = str(take("telemetry", str)), take("sha256", str, type(None))
    topics = take("topics", dict, default={})
    if not all(isinstance(name, str) for name in topics.values()):
        raise InputError("the result's source.topics are not names")
    for place in (telemetry, str(Path(where).parent / telemetry)):
        try:
            if "://" in place or Path(place).exists():
                break
        except (OSError, ValueError):  # a name that no file can have
            continue
    else:
        raise InputError(f"{telemetry} is not there any more")
    if file_hash(place) != sha256:
        raise InputError(f"{telemetry} has changed since: its SHA-256 is another")
    return Request(
        place,
        result.spacecraft,
        estimator=result.estimator,
        rows=result.rows,
        sensors=take("sensors", str, type(None)),
        unknown_momentum=take("unknown_momentum", bool, default=False),
        start=take("from", float, int),
        end=take("to", float, int),
        topics=topics,
        leave_out_bad=take("leave_out_bad", bool, default=False),
    )


def file_hash(path: str | Path) -> str | None:
    """Return the SHA-256 of a file; None of a folder."""
    if Path(path).is_dir():
        return None
    path = resolve_model(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _window(measurements: Measurements, request: Request) -> tuple[Measurements, dict[str, float]]:
    """Return the samples in the window, times from the first on, and what times they are.

    The estimators' clock starts at the first sample: seconds since 1970 would cost digits.
    """
    limited = request.start is not None or request.end is not None
    if limited:
        first = -np.inf if request.start is None else request.start
        last = np.inf if request.end is None else request.end
        # One instant is a window for whom reads a result of one; none is not.
        if not first <= last:
            raise InputError(f"--from {first:g} --to {last:g}: nothing lies between them")
        measurements = measurements.between(first, last)
    parts = dict(measurements.items())
    times = np.concatenate([samples.time for samples in parts.values()])
    if not times.size:
        raise InputError(
            f"{request.telemetry}: there are no samples"
            + (" between --from and --to" if limited else "")
        )
    zero = times.min()
    moved = {name: Samples(samples.time - zero, samples.value) for name, samples in parts.items()}
    return measurements.updated(moved), {"from": float(zero), "to": float(times.max())}
