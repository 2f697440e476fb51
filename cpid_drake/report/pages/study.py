"""The reports of the studies: tables and figures on one page."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from cpid_drake.output_files.drafts import write_text
from cpid_drake.report import paper_figures, paper_tables, technique_tables
from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.data import written_by
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.techniques.comparison import Comparison


def paper_report(study: PaperStudy, scenario: str) -> Report:
    """Return the report of the study of Ning et al. 2016 on a scenario of this name or path."""
    words = ["cpid", "study", "paper", "--scenario", scenario]
    introduction = Section("The paper and this study", texts=paper_tables.INTRODUCTION)
    sections = [introduction, *paper_tables.sections(study), *paper_figures.sections(study)]
    return _report("Study of Ning et al. 2016", f"Scenario {scenario}", sections, scenario, words)


def technique_report(found: Comparison, scenarios: Sequence[str], words: Sequence[str]) -> Report:
    """Return the report of a comparison of techniques on scenarios, made by the command `words`."""
    subtitle = f"{', '.join(scenarios)}, {found.trials} trials, seed {found.seed}"
    contents = technique_tables.sections(found)
    return _report("Techniques side by side", subtitle, contents, ", ".join(scenarios), words)


def _report(
    title: str, subtitle: str, sections: Sequence[Section], scenario: str, words: Sequence[str]
) -> Report:
    command = shlex.join([*words, "--out", "OUT"])
    facts = [("Scenario", scenario), written_by()]
    provenance = Section("Provenance", facts=facts, command=command)
    return Report(title, subtitle, [*sections, provenance])


def write_study(folder: Path, page: Report, summary: Mapping[str, object]) -> None:
    """Write a study's page, its figures and its numbers, `summary.json`, into a folder."""
    page.save_figures(folder)
    page.write(folder / "report.html")
    write_text(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")


def write_techniques(folder: Path, page: Report, found: Comparison) -> None:
    """Write the page of a comparison, its figures, its numbers and the README's table."""
    page.save_figures(folder)
    page.write(folder / "report.html")
    write_text(folder / "techniques.csv", technique_tables.as_csv(found))
    write_text(folder / "techniques.md", technique_tables.short_table(found))
