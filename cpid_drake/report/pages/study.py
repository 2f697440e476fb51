"""The reports of the studies: tables and figures on one page."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from cpid_drake.output_files.drafts import write_text
from cpid_drake.report import accuracy_tables, paper_tables
from cpid_drake.report.page import Report, Section
from cpid_drake.report.pictures import PictureGroup
from cpid_drake.report.sections.data import provenance_section
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.paper import PaperStudy

STUDY_FILES = ("report.html", "summary.json")
"""Names of a study's files, except its figures."""


def paper_report(study: PaperStudy, figures: Sequence[PictureGroup], scenario: str) -> Report:
    """Return the report of the study of Ning et al. 2016.

    Args:
        study: the results.
        figures: the figures.
        scenario: name or path of the simulated scenario.

    """
    tables = paper_tables.tables(study).items()
    command = ["cpid", "study", "paper", "--scenario", scenario, "--out", "OUT"]
    sections = [
        Section("The paper and this study", texts=paper_tables.INTRODUCTION),
        *(Section(title, tables=contents) for title, contents in tables),
        Section("Figures", groups=figures),
        provenance_section([("Scenario", scenario)], shlex.join(command)),
    ]
    return Report("Study of Ning et al. 2016", f"Scenario {scenario}", sections)


def accuracy_report(study: AccuracyStudy, figures: Sequence[PictureGroup], scenario: str) -> Report:
    """Return the report of an accuracy study; arguments as for `paper_report`."""
    words = ["cpid", "study", "accuracy", scenario, "--trials", str(study.trials)]
    words += ["--seed", str(study.seed)]
    for option, name in (("--sensors", "preset"), ("--estimator", "estimator")):
        for value in dict.fromkeys(getattr(result, name) for result in study.results):
            words += [option, value]
    tables = accuracy_tables.tables(study)
    sections = [
        Section("Tables", texts=[accuracy_tables.LEGEND], tables=tables),
        Section("Figures", groups=figures),
        provenance_section([("Scenario", scenario)], shlex.join([*words, "--out", "OUT"])),
    ]
    subtitle = f"Scenario {scenario}, {study.trials} trials, seed {study.seed}"
    return Report("Accuracy of the estimators", subtitle, sections)


def write_study(
    folder: Path, page: Report, figures: Sequence[PictureGroup], summary: Mapping[str, object]
) -> None:
    """Write a study's page, its figures and its numbers, `summary.json`, into a folder."""
    for group in figures:
        group.save(folder, "png")
    page.write(folder / "report.html")
    write_text(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
