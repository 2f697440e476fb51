"""The reports of the studies: tables and figures on one page, and files with their numbers."""

import json
import shlex
from collections.abc import Mapping, Sequence

from cpid_drake.report import paper_figures, paper_tables, technique_tables
from cpid_drake.report.page import Report, Section
from cpid_drake.report.sections.data import written_by
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.techniques.comparison import Comparison


def paper_report(study: PaperStudy, scenario: str, summary: Mapping[str, object]) -> Report:
    """Return the report of the study of Ning et al. 2016 on a scenario of this name or path."""
    words = ["cpid", "study", "paper", "--scenario", scenario, "--out", "OUT"]
    introduction = Section("The paper and this study", texts=paper_tables.INTRODUCTION)
    sections = [introduction, *paper_tables.sections(study), *paper_figures.sections(study)]
    files = {"summary.json": json.dumps(summary, indent=2, allow_nan=False) + "\n"}
    title, facts = "Study of Ning et al. 2016", [("Scenario", scenario)]
    return study_report(title, f"Scenario {scenario}", sections, facts, words, files)


def technique_report(found: Comparison, scenarios: Sequence[str], words: Sequence[str]) -> Report:
    """Return the report of a comparison of techniques on scenarios, made by the command `words`."""
    subtitle = f"{', '.join(scenarios)}, {found.trials} trials, seed {found.seed}"
    files = {
        "techniques.csv": technique_tables.numbers(found).csv(),
        "techniques.md": technique_tables.short_table(found),
    }
    sections, facts = technique_tables.sections(found), [("Scenario", ", ".join(scenarios))]
    words = [*words, "--out", "OUT"]
    return study_report("Techniques side by side", subtitle, sections, facts, words, files)


def study_report(
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    facts: Sequence[tuple[str, str]],
    words: Sequence[str],
    files: Mapping[str, str],
) -> Report:
    """Return a page that ends with facts, the software's versions, and the command `words`."""
    provenance = Section("Provenance", facts=[*facts, written_by()], command=shlex.join(words))
    return Report(title, subtitle, [*sections, provenance], files=files)
