"""Identification from the files of a request, with everything that a report needs.

The path of a sample, from a file to an interval, is in the docstring of `cpid_drake.estimation`.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.resources import __version__, resolve_model
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import left_out_warnings
from cpid_drake.identification.identify import identify, identify_parts
from cpid_drake.identification.prior import load_prior
from cpid_drake.identification.request import Request, Source, log_names
from cpid_drake.identification.result import History, Identification
from cpid_drake.logs.conversion import LogFile
from cpid_drake.logs.formats import inspect_log, refuse_problems
from cpid_drake.logs.joined import TOGETHER, log_parts
from cpid_drake.logs.log import Log

PARTS_OVER_TIME = 12
"""From so many parts of a log estimates over time are identified."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """An identification with its inputs, and with the log files that were read for it."""

    inputs: Arguments
    files: tuple[LogFile, ...]
    result: Identification

    @property
    def log(self) -> Log:
        """The log, if there is one only."""
        [file] = self.files
        return file.log


def identify_files(
    requests: Sequence[Request], progress: Callable[[str], object] = lambda step: None
) -> Evidence:
    """Identify the target of a spacecraft from one telemetry file, or from several together.

    Args:
        requests: the requests, which differ in telemetry and sensors only.
        progress: see `identify`.

    Raises:
        InputError: what is named cannot be read or used, or two of the files are the same.

    """
    request, paths = requests[0], [each.telemetry for each in requests]
    labels: dict[str, str] = {}
    for path in paths if len(paths) > 1 else ():
        key = file_hash(path) or str(Path(path).resolve())
        if key in labels:
            raise InputError(f"{path}: is the same log as {labels[key]}, and would count twice")
        labels[key] = path
    inputs = opened_inputs(request, progress)
    opened = [open_log(each, inputs.spacecraft.joint_names) for each in requests]
    names = log_names(paths)
    options = vars(inputs)
    if any(each.sensors != request.sensors for each in requests):
        own = zip(names, requests, strict=True)
        options = options | {"sensors": {n: e.sensors for n, e in own if e.sensors is not None}}
    with prefix_errors(paths[0] if len(paths) == 1 else ""):
        data = {name: file.log for name, (_, file) in zip(names, opened, strict=True)}
        result = identify(data=data, **options, progress=progress)
    rejected, warnings = Counter(result.rejected), list[str]()
    for name, (_, file) in zip(names, opened, strict=True):
        rejected += Counter(file.partial) + Counter(rows=len(file.problems))
        where = f"{name}: " if len(opened) > 1 else ""
        warnings += [where + text for text in _sensors_beside(requests[names.index(name)])]
        warnings += [where + text for text in left_out_warnings(file.left_out_joints)]
    result = replace(
        result,
        rejected=dict(rejected),
        warnings=(*warnings, *result.warnings),
        sources=tuple(source for source, _ in opened),
    )
    return Evidence(inputs, tuple(file for _, file in opened), result)


def _sensors_beside(request: Request) -> Iterator[str]:
    """Yield that sensors lie beside a log, as `cpid simulate` writes them, and are not used."""
    log = Path(log_parts(request.telemetry)[0])
    for file in (log.with_name("sensors.yaml"), log.with_name(f"{log.stem}_sensors.yaml")):
        if request.sensors is None and file.is_file():
            yield f"{file} lies beside the log, and is not used: give --sensors {file}"


def converge(evidence: Evidence, progress: Callable[[str], None] = lambda step: None) -> History:
    """Return the estimates from growing parts of the only log.

    A fit has them from one pass; another estimator identifies the parts in the same way as all.
    """
    result, inputs, data = evidence.result, evidence.inputs, evidence.log
    _, end = data.interval
    if result.history is not None:
        return [*result.history(), (end, result)]
    same = replace(inputs, estimator=result.estimator, rows=result.rows, planar=result.is_planar)
    ends = (end * np.arange(1, PARTS_OVER_TIME) / PARTS_OVER_TIME).tolist()
    return [*identify_parts(same, data, ends, progress), (end, result)]


def opened_inputs(request: Request, progress: Callable[[str], object]) -> Arguments:
    """Return the inputs of a request besides its telemetry, or raise an InputError of one."""
    progress("reading the model")
    spacecraft, prior = request.spacecraft.make(), None
    if request.prior is not None:
        prior = load_prior(request.prior, spacecraft, request.spacecraft.capture_frame)
    r = request
    options = r.estimator, r.rows, r.sensors, r.momentum, r.known_bodies, prior, r.planar
    inputs = Arguments.of(spacecraft, *options)
    progress("reading the telemetry")
    return inputs


def open_log(request: Request, joints: tuple[str, ...]) -> tuple[Source, LogFile]:
    """Return the log of a request for a spacecraft with these joints, and its record.

    The log has the samples in the window. Its time starts at the first.

    Raises:
        InputError: the window is empty, has no samples, or the file cannot be read.

    """
    first = -np.inf if request.start is None else request.start
    last = np.inf if request.end is None else request.end
    # A window of a single time is allowed: a result can come from one sample.
    if not first <= last:
        raise InputError(f"--from {first:g} --to {last:g}: the interval is empty")
    file = inspect_log(
        request.telemetry, topics=request.topics, columns=request.columns, joints=joints
    )
    if not request.leave_out_bad:
        refuse_problems(file.problems, request.telemetry)
    data = file.log.between(first, last)
    start, end = data.interval
    if not start <= end:
        limited = request.start is not None or request.end is not None
        raise InputError(
            f"{request.telemetry}: there are no samples"
            + (" between --from and --to" if limited else "")
        )
    hashes = {option: file_hash(name) for option, name in request.files().items()}
    source = Source(request, hashes, start, end, __version__)
    return source, replace(file, log=data.after(start))


def request_of_result(result: Identification, where: str) -> Request:
    """Return the request of a result that was read from the file `where`.

    The telemetry is expected at its recorded place, or beside the result file.

    Raises:
        InputError: the file names no telemetry, or the telemetry is missing or has changed.

    """
    if len(result.sources) != 1:
        raise InputError("the result does not name its telemetry")
    [source] = result.sources
    places: dict[str, Any] = {
        option: _unchanged(name, source.sha256.get(option), Path(where).parent)
        for option, name in source.request.files().items()
    }
    return replace(
        source.request,
        **places,
        estimator=result.estimator,
        rows=result.rows,
        start=source.start,
        end=source.end,
    )


def _unchanged(path: str, sha256: str | None, folder: Path) -> str:
    """Return the place of a recorded file, which may be beside the result file in `folder`."""
    parts = log_parts(path)
    for place in (path, TOGETHER.join(str(folder / part) for part in parts)):
        try:
            if "://" in place or all(Path(part).exists() for part in log_parts(place)):
                break
        except (OSError, ValueError):  # no file can have this name
            continue
    else:
        raise InputError(f"{path} does not exist any more")
    if file_hash(place) != sha256:
        raise InputError(f"{path} has changed since: its SHA-256 differs")
    return place


def file_hash(path: str | Path) -> str | None:
    """Return the SHA-256 of a file, or of the hashes of several; None for a folder."""
    parts = log_parts(path)
    if len(parts) > 1:
        hashes = [file_hash(part) for part in parts]
        return hashlib.sha256(" ".join(map(str, hashes)).encode()).hexdigest()
    if Path(path).is_dir():
        return None
    path = resolve_model(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
