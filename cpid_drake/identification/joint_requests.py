"""Identification of one target from several telemetry files."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cpid_drake.errors import InputError
from cpid_drake.identification.identify import identify_together
from cpid_drake.identification.requests import file_hash, open_log, opened_inputs
from cpid_drake.identification.result import Request
from cpid_drake.identification.solved import SolvedIdentification


@dataclass(frozen=True, eq=False)
class JointEvidence:
    """An identification from several logs.

    Attributes:
        requests: the requests, which differ in the telemetry only.
        found: the joint identification.
        ignored: columns of the files with unknown names.

    """

    requests: tuple[Request, ...]
    found: SolvedIdentification
    ignored: tuple[str, ...]


def identify_files(
    requests: Sequence[Request], progress: Callable[[str], None] = lambda step: None
) -> JointEvidence:
    """Identify one target of a spacecraft from several telemetry files.

    Args:
        requests: the requests, which differ in the telemetry only.
        progress: called before every step with a short description of the step.

    Raises:
        InputError: for the same reasons as `identify_file`; also if two of the files are the same.

    """
    request, paths = requests[0], [each.telemetry for each in requests]
    _check_different(paths)
    inputs = opened_inputs(request, progress)
    spacecraft = inputs.spacecraft
    logs = [open_log(each, spacecraft.joint_names) for each in requests]
    short = [Path(path).name for path in paths]
    names = short if len(set(short)) == len(short) else paths
    found = identify_together(
        spacecraft,
        {name: log.data for name, log in zip(names, logs)},
        estimator=request.estimator,
        rows=request.rows,
        sensors=inputs.sensors,
        momentum=inputs.momentum,
        known_bodies=inputs.known_bodies,
        prior=inputs.prior,
        planar=request.planar,
        progress=progress,
    )
    rejected = sum((log.rejected for log in logs), Counter(found.rejected))
    warnings = [f"{name}: {text}" for name, log in zip(names, logs) for text in log.warnings]
    found = replace(
        found,
        rejected=dict(rejected),
        warnings=(*warnings, *found.warnings),
        sources=tuple(log.source() for log in logs),
    )
    ignored = tuple(dict.fromkeys(name for log in logs for name in log.file.ignored))
    return JointEvidence(tuple(requests), found, ignored)


def _check_different(paths: Sequence[str]) -> None:
    """Refuse one log twice, which would count twice.

    Raises:
        InputError: two files have the same content, or are the same folder.

    """
    seen: dict[str, str] = {}
    for path in paths:
        key = file_hash(path) or str(Path(path).resolve())
        if key in seen:
            raise InputError(f"{path}: is the same log as {seen[key]}, and would count twice")
        seen[key] = path
