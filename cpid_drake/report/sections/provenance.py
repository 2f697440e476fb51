"""The section that lists the files and versions from which a report was made."""

from collections.abc import Sequence

from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section
from cpid_drake.scenario.run_files import versions


def provenance_section(facts: Sequence[tuple[str, str | Cell]], command: str) -> Section:
    """Return the section with facts, versions and the command that repeats the work."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return Section("Provenance", facts=[*facts, ("Report written by", used)], command=command)


def provenance_of(result: Identification) -> Section:
    """Return the provenance of an identification; without sources if the file names none."""
    facts: list[tuple[str, str | Cell]] = []
    for source in result.sources:
        facts.append(("Telemetry", source.request.telemetry))
        facts.append(("SHA-256", source.sha256.get("telemetry") or "none (a folder)"))
    for source in result.sources[:1]:
        request = source.request
        facts += [("Map of columns", request.columns)] if request.columns else []
        facts += [("Prior", request.prior)] if request.prior else []
        facts.append(("Identified by", f"cpid-drake {source.cpid_drake or '(not installed)'}"))
    return provenance_section(facts, result.command)
