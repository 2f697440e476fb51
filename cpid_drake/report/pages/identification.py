"""The report of an identification."""

import json
from dataclasses import replace
from pathlib import Path

from cpid_drake.files.errors import InputError
from cpid_drake.identification.description import origin, verdict
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.identification.result_files import result_text
from cpid_drake.logs.joined import log_name
from cpid_drake.report.contents import Progress, ReportContents, collect_contents
from cpid_drake.report.page import Report, Section, embedded_json
from cpid_drake.report.replay import LONGEST_REPLAY, motion_of, replay_html
from cpid_drake.report.run_folder import simulated_section
from cpid_drake.report.sections.data import (
    base_motion_section,
    checks_section,
    convergence_section,
    request_section,
    residuals_section,
    sensors_section,
)
from cpid_drake.report.sections.estimate import (
    budget_section,
    effects_section,
    identifiability_section,
    logs_section,
    numbers_section,
    parameters_section,
)
from cpid_drake.report.sections.next_steps import next_sections


def write_report(
    path: str | Path, evidence: Evidence, progress: Progress = lambda step: None
) -> None:
    """Write the report of logs that have just been identified, one HTML page.

    Args:
        path: the page.
        evidence: what `identify_files` returned.
        progress: called before every step with a short description of it.

    Raises:
        InputError: the file cannot be written.

    """
    identification_report(collect_contents(evidence, progress), progress).write(path)


def identification_report(
    contents: ReportContents, progress: Progress = lambda step: None
) -> Report:
    """Return the report of an identification; see `write_report`."""
    result, evidence, run = contents.result, contents.evidence, contents.run
    missing = contents.missing and f"the log cannot be read: {contents.missing}"
    scene = convergence = None
    if evidence is not None:
        progress("making the scene")
        try:
            scene = _scene(contents, evidence)
        except InputError as error:
            missing = f"the scene cannot be made: {error}"
        convergence = convergence_section(contents.estimates, contents.truth)
    warnings = [*result.warnings, *contents.differences()]
    if missing:
        warnings.append(f"Some sections are not shown: {missing}.")
    sections = [
        replace(parameters_section(result, contents.truth), half=scene is not None),
        scene,
        convergence,
        *next_sections(result, warnings),
        None if run is None else simulated_section(run),
        numbers_section(result, contents.truth),
        logs_section(result) if result.logs else None,
        identifiability_section(result),
        residuals_section(evidence.result) if evidence else None,
        budget_section(result) if result.budget else None,
        effects_section(result) if result.effects else None,
        sensors_section(evidence) if evidence else None,
        base_motion_section(evidence.log) if evidence else None,
        checks_section(result) if result.checks else None,
        request_section(result),
    ]
    title, subtitle, data = verdict(result), origin(result), {"result": result_text(result, "")}
    if run is not None:
        subtitle = f"Simulated run “{run.folder.resolve().name}”. {subtitle}"
        data |= run.texts
    if result.failures:
        subtitle = f"Do not use this estimate: {result.failures[0]}. {subtitle}"
    return Report(title, subtitle, [each for each in sections if each is not None], data)


def _scene(contents: ReportContents, evidence: Evidence) -> Section:
    """Return the section with the motion and the estimate over time."""
    spacecraft, run = evidence.inputs.spacecraft, contents.run
    page = replay_html(
        spacecraft,
        motion_of(evidence.log, spacecraft, evidence.result.sensors),
        contents.estimates,
        truth=contents.truth,
        visual_model=run.scenario.target.visual_model if run else None,
        title=log_name(contents.result.sources[0].request.telemetry),
    )
    text = f"The first {LONGEST_REPLAY:g} s at most. Click it to turn it."
    return Section("Scene", texts=[text], inner_page=embedded_json(json.dumps(page)), half=True)
