"""The contents of a report: a result, and the log that it was identified from."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.identification.identify_files import (
    Estimates,
    Evidence,
    converge,
    identify_files,
    request_of_result,
)
from cpid_drake.identification.result import Identification
from cpid_drake.identification.result_files import read_result, result_text

Progress = Callable[[str], None]
"""A function that is called before every step with a short description of it."""


def no_progress(step: str) -> None:
    """Ignore progress."""


@dataclass(frozen=True, eq=False)
class Findings:
    """A result, and its log if that can be read again.

    Attributes:
        result: the result that is reported.
        text: the result as JSON text.
        evidence: the log, identified again; None if it cannot be read, and for several logs.
        estimates: the estimates from growing parts of this log.
        missing: why the log cannot be read; empty if it can.
        truth: the true target, if it is known from a simulation.
        visual_model: model file with the target's shape, if there is one.

    """

    result: Identification
    text: str
    evidence: Evidence | None = None
    estimates: Estimates = ()
    missing: str = ""
    truth: InertialParameters | None = None
    visual_model: str | None = None

    def files(self) -> list[Path]:
        """Return the files that the report was made from, as far as they exist."""
        found = self.result.files()
        if self.evidence is not None:
            found.append(Path(self.evidence.log.source.request.telemetry))
        return found if self.visual_model is None else [*found, Path(self.visual_model)]


def findings_of(evidence: Evidence, progress: Progress = no_progress) -> Findings:
    """Return the contents of a report on logs that have just been identified."""
    text = result_text(evidence.found, evidence.logs[0].source.request.telemetry)
    if len(evidence.logs) > 1:
        return Findings(evidence.found, text)
    return Findings(evidence.found, text, evidence, converge(evidence, progress))


def findings_of_file(path: str | Path, progress: Progress = no_progress) -> Findings:
    """Return the contents of a report on a result file; its log is identified again if possible.

    Raises:
        InputError: for the same reasons as `read_result`.

    """
    result = read_result(path)
    found = Findings(result, result_text(result, str(path)))
    if len(result.logs) > 1:
        return found
    try:
        evidence = identify_files([request_of_result(result, str(path))], progress)
    except InputError as error:
        return replace(found, missing=str(error))
    return replace(found, evidence=evidence, estimates=converge(evidence, progress))
