"""The section that repeats what was asked."""

from dataclasses import dataclass
from typing import ClassVar

from cpid_drake.identification.estimators import estimator_label
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Cell, Section
from cpid_drake.report.sections.cells import value_cell


@dataclass(frozen=True, eq=False)
class Asked(Section):
    """What was asked."""

    findings: Findings
    title: ClassVar[str] = "What was asked"
    template: ClassVar[str] = "asked.html.j2"

    @property
    def question(self) -> str:
        """The question in a sentence."""
        return (
            "Mass, centre of mass and inertia of what a free-floating spacecraft holds, from the "
            "way its base reacts to its arms."
        )

    @property
    def facts(self) -> list[tuple[str, str | Cell]]:
        """Names and values."""
        result = self.findings.result
        source = result.source
        craft = result.spacecraft
        how = estimator_label(result.estimator)
        facts: list[tuple[str, str | Cell]] = []
        if source is not None:
            facts += [
                ("Telemetry", source.telemetry),
                ("Window", f"{source.start:.6g} to {source.end:.6g} s"),
                ("Sensors", source.sensors or "not given"),
                ("Total momentum", source.momentum),
            ]
        facts += [
            ("Spacecraft", craft.model),
            ("Base body", craft.base),
            ("Capture frame", craft.capture_frame),
            ("Estimator", how + (f" ({result.rows})" if result.rows else "")),
            ("Samples used", value_cell(result.samples_used, "samples_used")),
            ("Samples left out", value_cell(result.samples_rejected, "samples_rejected")),
        ]
        return facts
