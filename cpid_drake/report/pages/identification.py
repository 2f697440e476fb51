"""The report of an identification: its sections, and what is said in each."""

from collections.abc import Sequence

from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import estimator_label
from cpid_drake.report.findings import Findings, Progress, no_progress
from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.answer import Answer
from cpid_drake.report.sections.asked import Asked
from cpid_drake.report.sections.base_motion import BaseMotion
from cpid_drake.report.sections.convergence import ConvergenceSection
from cpid_drake.report.sections.missing import Missing
from cpid_drake.report.sections.observability import Observability
from cpid_drake.report.sections.provenance import Provenance
from cpid_drake.report.sections.replay import replay_section
from cpid_drake.report.sections.residuals import Residuals
from cpid_drake.report.sections.sensors import Sensors
from cpid_drake.report.sections.warnings import Warnings


def identification_report(
    findings: Findings,
    *,
    before: Sequence[Section] = (),
    title: str = "",
    progress: Progress = no_progress,
) -> Report:
    """Return the report of an identification.

    Args:
        findings: what is reported.
        before: sections that come first.
        title: of the page; default: what was identified.
        progress: called with a few words before every step.

    """
    result, evidence = findings.result, findings.evidence
    sections: list[Section] = [*before, Asked(findings), Answer(findings), Warnings(findings)]
    if evidence is None:
        reason = f"What needs the log, which could not be read again: {findings.missing}."
        sections += [Observability(result), Missing(reason)]
    else:
        sections += [
            ConvergenceSection(findings),
            Residuals(evidence),
            Observability(result),
            Sensors(evidence),
            BaseMotion(evidence),
        ]
        progress("making the replay")
        try:
            sections.append(replay_section(findings))
        except InputError as error:
            sections.append(Missing(f"The replay: {error}."))
    sections.append(Provenance(findings))
    title = title or f"What {result.spacecraft.capture_frame} holds"
    model = result.spacecraft.model.rsplit("/", 1)[-1]
    known = "All ten parameters" if result.rank == 10 else f"{result.rank} of ten combinations"
    how = estimator_label(result.estimator)
    subtitle = f"{known} identified with {model} by {how}"
    return Report(title, subtitle, sections, {"result": findings.text})
