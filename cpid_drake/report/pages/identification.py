"""The report of an identification."""

from collections.abc import Sequence
from pathlib import Path

from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import estimator_label
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.report.findings import Findings, Progress, findings_of, no_progress
from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.base_motion import base_motion_section
from cpid_drake.report.sections.convergence import convergence_section
from cpid_drake.report.sections.effects import effects_section, undeclared_section
from cpid_drake.report.sections.logs import logs_section
from cpid_drake.report.sections.observability import observability_section
from cpid_drake.report.sections.provenance import provenance_of
from cpid_drake.report.sections.replay import replay_section
from cpid_drake.report.sections.request import request_section
from cpid_drake.report.sections.residuals import residuals_section
from cpid_drake.report.sections.result import result_section
from cpid_drake.report.sections.sensors import sensors_section
from cpid_drake.report.sections.warnings import warnings_section


def write_report(evidence: Evidence, path: str | Path, progress: Progress = no_progress) -> None:
    """Write the report of logs that have just been identified, one HTML page.

    Args:
        evidence: what `identify_files` returned.
        path: the page.
        progress: called before every step with a short description of it.

    Raises:
        InputError: the file cannot be written.

    """
    identification_report(findings_of(evidence, progress), progress=progress).write(path)


def identification_report(
    findings: Findings,
    *,
    before: Sequence[Section] = (),
    title: str = "",
    progress: Progress = no_progress,
) -> Report:
    """Return the report of an identification.

    Args:
        findings: the contents.
        before: sections that come first.
        title: heading of the page; default: the capture frame.
        progress: called before every step with a short description of it.

    """
    result, log = findings.result, findings.log
    sections = [
        *before,
        request_section(result),
        result_section(result, findings.truth),
        *([logs_section(result)] if result.logs else []),
        warnings_section(result, None if log is None else log.evidence.found),
    ]
    if result.effects:
        sections.append(effects_section(result))
    if result.undeclared is not None and result.undeclared.effects:
        sections.append(undeclared_section(result.undeclared))
    if log is None and not findings.missing:
        sections.append(observability_section(result))
    elif log is None:
        reason = f"The report has no sections that need the log: {findings.missing}."
        sections += [observability_section(result), Section("Not shown", texts=[reason])]
    else:
        sections += [
            convergence_section(log.estimates, findings.truth),
            residuals_section(log.evidence.found),
            observability_section(result),
            sensors_section(log.evidence),
            base_motion_section(log.evidence.log.data),
        ]
        progress("making the replay")
        try:
            sections.append(replay_section(findings, log))
        except InputError as error:
            reason = f"The replay cannot be made: {error}."
            sections.append(Section("Not shown", texts=[reason]))
    sections.append(provenance_of(result))
    craft = result.spacecraft
    title = title or f"Target held by {craft.capture_frame if craft else 'a spacecraft'}"
    model = craft.model.rsplit("/", 1)[-1] if craft else "a spacecraft"
    known = "All ten parameters" if result.rank == 10 else f"{result.rank} of ten combinations"
    subtitle = f"{known} identified with {model} by {estimator_label(result.estimator)}"
    if result.failures:
        title = f"{title}: a check failed"
        subtitle = f"Do not use this estimate: {result.failures[0]}. {subtitle}"
    return Report(title, subtitle, sections, {"result": findings.text})
