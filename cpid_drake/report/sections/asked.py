"""The section that repeats what was asked."""

from dataclasses import dataclass
from typing import ClassVar

from cpid_drake.report.findings import ESTIMATOR_LABELS, Findings, is_number, source_of
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
        source = source_of(result)
        craft = result.spacecraft
        how = ESTIMATOR_LABELS.get(result.estimator, result.estimator)
        facts: list[tuple[str, str | Cell]] = [
            ("Telemetry", str(source.get("telemetry", "not said"))),
        ]
        if is_number(source.get("from")) and is_number(source.get("to")):
            facts.append(("Window", f"{source['from']:.6g} to {source['to']:.6g} s"))
        facts += [
            ("Spacecraft", craft.model),
            ("Base body", craft.base),
            ("Capture frame", craft.capture_frame),
            ("Estimator", how + (f" ({result.rows})" if result.rows else "")),
            ("Sensors", str(source.get("sensors") or "not given")),
            (
                "Total momentum",
                "constant, unknown" if source.get("unknown_momentum") else "zero",
            ),
            ("Samples used", value_cell(result.samples_used, "samples_used")),
            ("Samples left out", value_cell(result.samples_rejected, "samples_rejected")),
        ]
        return facts
