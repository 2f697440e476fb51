"""The report of a simulated run, with an identification from its telemetry."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cpid_drake.identification.requests import identify_files
from cpid_drake.identification.result import Request
from cpid_drake.report.findings import Findings, Progress, findings_of
from cpid_drake.report.page import Report
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.run_folder import read_run
from cpid_drake.report.sections.simulated import simulated_section
from cpid_drake.scenario.run_files import request_of_run


def run_report(
    folder: Path, progress: Progress, change: Callable[[Request], Request] = lambda request: request
) -> tuple[Report, Findings]:
    """Return the report of a run's folder, and the findings from its telemetry.

    Args:
        folder: the folder.
        progress: called before every step with a short description of it.
        change: returns the request to use in place of the run's own.

    Raises:
        InputError: for the same reasons as `read_run` and `identify_files`.

    """
    run = read_run(folder)
    request = change(request_of_run(run.scenario, folder))
    findings = replace(
        findings_of(identify_files([request], progress), progress),
        truth=run.truth,
        visual_model=run.scenario.target.visual_model,
    )
    report = identification_report(
        findings,
        before=(simulated_section(run),),
        title=f"Simulated run “{folder.resolve().name}”",
        progress=progress,
    )
    return replace(report, data={**report.data, **run.texts}), findings
