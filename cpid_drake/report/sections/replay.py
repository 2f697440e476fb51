"""The section with the replay in three dimensions."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from markupsafe import Markup

from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.identification.requests import Evidence
from cpid_drake.identification.requirements import in_joint_order
from cpid_drake.identification.row_estimator import complete_samples
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section, embedded_json
from cpid_drake.report.replay import replay_html
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.smoothing import smooth


@dataclass(frozen=True, eq=False)
class Replay(Section):
    """The motion in three dimensions: a page in the page, loaded when it is asked for."""

    data: Markup
    title: ClassVar[str] = "Replay"
    template: ClassVar[str] = "replay.html.j2"


def replay_section(findings: Findings) -> Replay:
    """Return the replay of a log and of its estimates.

    Raises:
        InputError: the log does not say how the base moved.

    """
    evidence, convergence = findings.evidence, findings.convergence
    page = replay_html(
        evidence.spacecraft,
        motion_of(evidence),
        convergence.estimates,
        truth=findings.truth,
        visual_model=findings.visual_model,
        title=Path(evidence.request.telemetry).name,
    )
    return Replay(embedded_json(json.dumps(page)))


def motion_of(evidence: Evidence) -> Telemetry:
    """Return the motion in a log, as sampled or else smoothed.

    Raises:
        InputError: there is too little in the log.

    """
    measurements, _ = screen(in_joint_order(evidence.measurements, evidence.spacecraft))
    if len(measurements.attitude):
        for rows in ("standard", "relative"):
            if rows == "relative" and len(measurements.position):
                continue
            complete = complete_samples(measurements, row_family(rows))
            if complete is not None:
                return complete
    suite = evidence.found.sensors or estimate_suite(measurements)
    with_position = bool(len(measurements.position))
    return smooth(measurements, suite, with_position=with_position).telemetry
