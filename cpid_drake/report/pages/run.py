"""The report of a simulated run, with an identification from its telemetry."""

from dataclasses import replace
from pathlib import Path

from cpid_drake.identification.requests import Request, identify_file
from cpid_drake.identification.result_files import SpacecraftReference
from cpid_drake.report.findings import Findings, Progress, findings_of
from cpid_drake.report.page import Report
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.run_folder import read_run
from cpid_drake.report.sections.simulated import simulated_section


def run_report(folder: Path, progress: Progress) -> tuple[Report, Findings]:
    """Return the report of a run's folder, and the findings from its telemetry.

    Raises:
        InputError: as `read_run` and `identify_file`.

    """
    run = read_run(folder)
    craft, sensors = run.scenario.spacecraft, folder / "sensors.yaml"
    request = Request(
        str(folder / "telemetry.csv"),
        SpacecraftReference(
            str(craft.model), craft.base, craft.capture_frame, dict(craft.packages)
        ),
        sensors=str(sensors) if sensors.is_file() else None,
        momentum="unknown" if run.scenario.identification.unknown_momentum else "zero",
    )
    findings = replace(
        findings_of(identify_file(request, progress), progress),
        truth=run.truth,
        visual_model=run.scenario.target.visual_model,
    )
    report = identification_report(
        findings,
        before=(simulated_section(run),),
        title=f"Simulated run “{folder.resolve().name}”",
        progress=progress,
    )
    return Report(
        report.title, report.subtitle, report.sections, {**report.data, **run.texts}
    ), findings
