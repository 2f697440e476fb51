"""The contents of a report: a result, and the log that it was identified from."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.errors import InputError
from cpid_drake.identification.identify_files import (
    Evidence,
    converge,
    identify_files,
    request_of_result,
)
from cpid_drake.identification.result import History, Identification
from cpid_drake.identification.result_files import read_result
from cpid_drake.report.run_folder import Run

Progress = Callable[[str], None]
"""A function that is called before every step with a short description of it."""


@dataclass(frozen=True, eq=False)
class ReportContents:
    """A result, and its log if that can be read again.

    Attributes:
        result: the result that is reported.
        evidence: the log, identified again; None if it cannot be read, and for several logs.
        estimates: the estimates from growing parts of this log.
        missing: why the log cannot be read; empty if it can.
        run: the simulated run with the log; None for another log.

    """

    result: Identification
    evidence: Evidence | None = None
    estimates: History = ()
    missing: str = ""
    run: Run | None = None

    @property
    def truth(self) -> InertialParameters | None:
        """The true target, if it is known from a simulation."""
        return None if self.run is None else self.run.truth

    def differences(self) -> list[str]:
        """Return a warning if the log, identified again, gives other values than the result."""
        if self.evidence is None or self.evidence.result is self.result:
            return []
        sigma = np.sqrt(np.nan_to_num(np.diag(self.result.covariance)))
        before, again = self.result.parameters, self.evidence.result.parameters
        close = np.abs(again - before) <= 1e-3 * sigma + 1e-9 * np.abs(again)
        if np.all(close | (np.isnan(again) & np.isnan(before))):
            return []
        return [
            "For this report the log was identified again; the values differ from those of the "
            "result file, and the figures show the new ones. The model, the sensors or the "
            "software have changed since the result file was written."
        ]

    def files(self) -> list[str | Path | None]:
        """Return the files that the report was made from, as far as they exist."""
        files: list[str | Path | None] = [*self.result.files()]
        if self.evidence is not None:
            files.append(self.evidence.result.sources[0].request.telemetry)
        return files if self.run is None else [*files, self.run.scenario.target.visual_model]


def collect_contents(
    evidence: Evidence, progress: Progress = lambda step: None, run: Run | None = None
) -> ReportContents:
    """Return the contents of a report on logs that have just been identified."""
    if len(evidence.files) > 1:
        return ReportContents(evidence.result)
    return ReportContents(evidence.result, evidence, converge(evidence, progress), run=run)


def collect_contents_of_file(
    path: str | Path, progress: Progress = lambda step: None
) -> ReportContents:
    """Return the contents of a report on a result file; its log is identified again if possible.

    Raises:
        InputError: for the same reasons as `read_result`.

    """
    result = read_result(path)
    if len(result.logs) > 1:
        return ReportContents(result)
    try:
        evidence = identify_files([request_of_result(result, str(path))], progress)
    except InputError as error:
        return ReportContents(result, missing=str(error))
    return replace(collect_contents(evidence, progress), result=result)
