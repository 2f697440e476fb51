"""What a report is about: a result, and the log that it was identified from."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.identification.convergence import Convergence, converge
from cpid_drake.identification.requests import Evidence, identify_file, request_of_result
from cpid_drake.identification.result_files import IdentificationResult, read_result, result_text

Progress = Callable[[str], None]
"""Called with a few words before every step."""


def no_progress(step: str) -> None:
    """Ignore progress."""


@dataclass(frozen=True, eq=False)
class Findings:
    """A result, and what could be read again of where it came from.

    Attributes:
        result: the result whose numbers are shown.
        text: the same as JSON.
        evidence: the log identified again; None if it is not there any more.
        missing: why it is not.
        convergence: from the evidence.
        truth: the true target, of a simulation.
        visual_model: how the target looks, if there is a model of that.

    """

    result: IdentificationResult
    text: str
    evidence: Evidence | None
    missing: str
    convergence: Convergence | None
    truth: InertialParameters | None = None
    visual_model: str | None = None


def findings_of(evidence: Evidence, progress: Progress = no_progress) -> Findings:
    """Return what there is to report of a log that has just been identified."""
    text = result_text(evidence.result, evidence.request.telemetry)
    return Findings(evidence.result, text, evidence, "", converge(evidence, progress))


def findings_of_file(path: str | Path, progress: Progress = no_progress) -> Findings:
    """Return what there is to report of a result file; its log is read again if it is there.

    Raises:
        InputError: as `read_result`.

    """
    result = read_result(path)
    text = result_text(result, str(path))
    try:
        evidence = identify_file(request_of_result(result, str(path)), progress)
    except InputError as error:
        return Findings(result, text, None, str(error), None)
    return Findings(result, text, evidence, "", converge(evidence, progress))
