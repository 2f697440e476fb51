"""The section that says which files and versions a result comes from."""

from dataclasses import dataclass
from typing import ClassVar

from cpid_drake.report.findings import Findings
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
        source = self.findings.result.source
        used = ", ".join(f"{name} {number}" for name, number in versions().items())
        facts = [("Report made by", used)]
        if source is not None:
            facts += [
                ("Telemetry", source.telemetry),
                ("SHA-256", source.sha256 or "a folder has none"),
                ("Identified by", f"cpid-drake {source.cpid_drake}"),
            ]
        return facts

    @property
    def command(self) -> str:
        """The command line."""
        source = self.findings.result.source
        return "" if source is None else source.command
