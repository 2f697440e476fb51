"""The section that lists the files and versions from which a report was made."""

from collections.abc import Sequence

from cpid_drake.identification.result import Source
from cpid_drake.report.page import Cell, Section
from cpid_drake.scenario.run_files import versions


def provenance_section(facts: Sequence[tuple[str, str | Cell]], command: str) -> Section:
    """Return the section with facts, versions and the command that repeats the work."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return Section("Provenance", facts=[*facts, ("Report written by", used)], command=command)


def provenance_of(sources: Sequence[Source]) -> Section:
    """Return the provenance of an identification; without sources if the file names none."""
    if not sources:
        return provenance_section([], "")
    facts: list[tuple[str, str | Cell]] = []
    for source in sources:
        facts += [
            ("Telemetry", source.telemetry),
            ("SHA-256", source.sha256 or "none (a folder)"),
        ]
    first = sources[0]
    facts += [("Map of columns", first.columns)] if first.columns else []
    facts += [("Prior", first.prior)] if first.prior else []
    facts.append(("Identified by", f"cpid-drake {first.cpid_drake}"))
    return provenance_section(facts, first.command)
