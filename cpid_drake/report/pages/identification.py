"""The report of an identification."""

import json
from pathlib import Path

from cpid_drake.files.errors import InputError
from cpid_drake.identification.estimators import estimator_label
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
    result_section,
)


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
    sections = [
        *([] if run is None else [simulated_section(run)]),
        result_section(result, contents.truth),
        *([logs_section(result)] if result.logs else []),
        checks_section(result, None if evidence is None else evidence.found),
        *([budget_section(result)] if result.budget else []),
        *([effects_section(result)] if result.effects else []),
        identifiability_section(result),
    ]
    missing = contents.missing and f"the log cannot be read: {contents.missing}"
    if evidence is not None:
        sections += [
            convergence_section(contents.estimates, contents.truth),
            residuals_section(evidence.found),
            sensors_section(evidence),
            base_motion_section(evidence.log),
        ]
        progress("making the replay")
        try:
            page = replay_html(
                evidence.inputs.spacecraft,
                motion_of(evidence.log, evidence.inputs.spacecraft, evidence.found.sensors),
                contents.estimates,
                truth=contents.truth,
                visual_model=run.scenario.target.visual_model if run else None,
                title=log_name(result.sources[0].request.telemetry),
            )
            text = f"The motion with the estimate over time, of at most {LONGEST_REPLAY:g} s."
            replay = embedded_json(json.dumps(page))
            sections.append(Section("Replay", texts=[text], inner_page=replay))
        except InputError as error:
            missing = f"the replay cannot be made: {error}"
    if missing:
        sections.append(Section("Not shown", texts=[f"Some sections are not shown: {missing}."]))
    sections.append(request_section(result))
    craft = result.spacecraft
    title = f"Target held by {craft.capture_frame if craft else 'a spacecraft'}"
    data = {"result": result_text(result, "the result")}
    if run is not None:
        title, data = f"Simulated run “{run.folder.resolve().name}”", {**data, **run.texts}
    model = craft.model.rsplit("/", 1)[-1] if craft else "a spacecraft"
    known = "All ten parameters" if result.is_identifiable else f"{result.rank} of ten combinations"
    subtitle = f"{known} identified with {model} by {estimator_label(result.estimator)}"
    if result.failures:
        title = f"{title}: a check failed"
        subtitle = f"Do not use this estimate: {result.failures[0]}. {subtitle}"
    return Report(title, subtitle, sections, data)
