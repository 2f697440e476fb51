"""Identification from a telemetry file, with everything that a report needs."""

import hashlib
import shlex
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.identification.description import result_of
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.identification.result_files import IdentificationResult, Source, SpacecraftReference
from cpid_drake.resources import resolve_model, version_of
from cpid_drake.sensing.files.telemetry_files import inspect_telemetry, refuse_problems
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True)
class Request:
    """The request of `cpid identify`: data, spacecraft, estimator and options.

    Attributes:
        telemetry: a file or a bag's folder.
        spacecraft: the known spacecraft.
        estimator, rows: see `cpid_drake.identification.identify.identify`.
        sensors: name of a preset or a YAML file; None if they are unknown.
        momentum: name of the total momentum; see `TotalMomentum.named`.
        start, end: first and last time to use [s]; None for all.
        topics: topics of a bag, by kind.
        leave_out_bad: whether to leave out rows that have a problem.

    """

    telemetry: str
    spacecraft: SpacecraftReference
    estimator: str | None = None
    rows: str | None = None
    sensors: str | None = None
    momentum: str = "zero"
    start: float | None = None
    end: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    leave_out_bad: bool = False

    def command(self) -> str:
        """Return the command line of this request."""
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
        words += [] if self.momentum == "zero" else ["--momentum", self.momentum]
        words += ["--leave-out-bad"] if self.leave_out_bad else []
        return shlex.join(words)


@dataclass(frozen=True, eq=False)
class Evidence:
    """An identification with its request and its data.

    Attributes:
        request: the request.
        spacecraft: the known spacecraft.
        measurements: the samples in the window; their time starts at the first.
        sensors: the sensors that were given, if any.
        found: the identification.
        result: the same in the form of a result file.
        ignored: columns of the file with unknown names.

    """

    request: Request
    spacecraft: Spacecraft
    measurements: Measurements
    sensors: SensorSuite | None
    found: Identification
    result: IdentificationResult
    ignored: tuple[str, ...]


def identify_file(
    request: Request, progress: Callable[[str], None] = lambda step: None
) -> Evidence:
    """Identify the target of a spacecraft from a telemetry file.

    Args:
        request: the request.
        progress: called before every step with a short description of the step.

    Raises:
        InputError: a model, sensors or telemetry that cannot be read or used; see the functions
            that read them.

    """
    craft, where = request.spacecraft, request.telemetry
    progress("reading the model")
    spacecraft = Spacecraft(
        craft.model, base=craft.base, capture_frame=craft.capture_frame, packages=craft.packages
    )
    momentum = TotalMomentum.named(request.momentum)
    sensors = load_sensors(request.sensors) if request.sensors is not None else None
    progress("reading the telemetry")
    file = inspect_telemetry(where, topics=request.topics)
    if not request.leave_out_bad:
        refuse_problems(file, where)
    measurements, start, end = _window(file.measurements, request)
    progress("identifying")
    with prefix_errors(where):
        found = identify(
            spacecraft,
            measurements,
            estimator=request.estimator,
            rows=request.rows,
            sensors=sensors,
            momentum=momentum,
        )
    rejected = dict(Counter(found.rejected) + Counter(file.partial))
    if file.problems.count:
        rejected["rows"] = file.problems.count
    found = replace(found, rejected=rejected)
    source = Source(
        telemetry=where,
        sha256=file_hash(where),
        sensors=request.sensors,
        momentum=request.momentum,
        topics=dict(request.topics),
        leave_out_bad=request.leave_out_bad,
        command=request.command(),
        start=start,
        end=end,
        cpid_drake=version_of("cpid-drake") or "not installed",
    )
    result = result_of(found, craft, source)
    return Evidence(request, spacecraft, measurements, sensors, found, result, file.ignored)


def request_of_result(result: IdentificationResult, where: str) -> Request:
    """Return the request that a result file records.

    The telemetry is expected at its recorded place, or beside the result file.

    Args:
        result: the result as read from its file.
        where: the result file.

    Raises:
        InputError: the file names no telemetry, or the telemetry is missing or has changed.

    """
    source = result.source
    if source is None:
        raise InputError("the result does not name its telemetry")
    for place in (source.telemetry, str(Path(where).parent / source.telemetry)):
        try:
            if "://" in place or Path(place).exists():
                break
        except (OSError, ValueError):  # no file can have this name
            continue
    else:
        raise InputError(f"{source.telemetry} does not exist any more")
    if file_hash(place) != source.sha256:
        raise InputError(f"{source.telemetry} has changed since: its SHA-256 differs")
    return Request(
        place,
        result.spacecraft,
        estimator=result.estimator,
        rows=result.rows,
        sensors=source.sensors,
        momentum=source.momentum,
        start=source.start,
        end=source.end,
        topics=source.topics,
        leave_out_bad=source.leave_out_bad,
    )


def file_hash(path: str | Path) -> str | None:
    """Return the SHA-256 of a file; None for a folder."""
    if Path(path).is_dir():
        return None
    path = resolve_model(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _window(measurements: Measurements, request: Request) -> tuple[Measurements, float, float]:
    """Return the samples in the window, and the times of the first and the last one [s].

    The time of the samples returned starts at zero: seconds since 1970 would lose digits.
    """
    limited = request.start is not None or request.end is not None
    if limited:
        first = -np.inf if request.start is None else request.start
        last = np.inf if request.end is None else request.end
        # A window of a single time is allowed: a result can come from one sample.
        if not first <= last:
            raise InputError(f"--from {first:g} --to {last:g}: the interval is empty")
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
    return measurements.updated(moved), float(zero), float(times.max())
