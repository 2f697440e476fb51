"""The section that says which files and versions a result comes from."""

from dataclasses import dataclass
from typing import ClassVar

from cpid_drake.report.findings import Findings, source_of
from cpid_drake.report.page import Section
from cpid_drake.scenario.run_files import versions


@dataclass(frozen=True, eq=False)
class Provenance(Section):
    """Where all this comes from."""

    findings: Findings
    title: ClassVar[str] = "Where this comes from"
    template: ClassVar[str] = "provenance.html.j2"

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Names and values."""
        source = source_of(self.findings.result)
        used = ", ".join(f"{name} {number}" for name, number in versions().items())
        return [
            ("Telemetry", str(source.get("telemetry", "not said"))),
            ("SHA-256", str(source.get("sha256") or "not said")),
            ("Identified by", f"cpid-drake {source.get('cpid_drake', 'of unknown version')}"),
            ("Report made by", used),
        ]

    @property
    def command(self) -> str:
        """The command line."""
        return str(source_of(self.findings.result).get("command", ""))
