"""The report of a simulated run, with an identification from its telemetry."""

from dataclasses import replace

from cpid_drake.identification.identify_files import identify_files
from cpid_drake.identification.request import Request
from cpid_drake.report.findings import Findings, Progress, findings_of
from cpid_drake.report.page import Report
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.run_folder import Run
from cpid_drake.report.sections.simulated import simulated_section


def run_report(run: Run, request: Request, progress: Progress) -> tuple[Report, Findings]:
    """Return the report of a run's folder, and the findings from its log.

    Args:
        run: the contents of the folder.
        request: the request to identify the run's log.
        progress: called before every step with a short description of it.

    Raises:
        InputError: for the same reasons as `identify_files`.

    """
    findings = replace(
        findings_of(identify_files([request], progress), progress),
        truth=run.truth,
        visual_model=run.scenario.target.visual_model,
    )
    report = identification_report(
        findings,
        before=(simulated_section(run),),
        title=f"Simulated run “{run.folder.resolve().name}”",
        progress=progress,
    )
    return replace(report, data={**report.data, **run.texts}), findings
