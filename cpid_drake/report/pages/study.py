"""The reports of the studies: tables and figures on one page."""

import json
import shlex
from collections.abc import Mapping
from pathlib import Path

from cpid_drake.output_files.drafts import write_text
from cpid_drake.output_files.overwriting import PAGE, SUMMARY
from cpid_drake.report import accuracy, paper
from cpid_drake.report.page import Report, Section
from cpid_drake.report.pictures import PictureGroup
from cpid_drake.report.sections.provenance import provenance_section
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.paper import PaperStudy

STUDY_FILES = (("report.html", PAGE), ("summary.json", SUMMARY))
"""Names and kinds of a study's files, except its figures."""


def paper_report(
    study: PaperStudy,
    figures: Mapping[str, PictureGroup],
    summary: Mapping[str, object],
    scenario: str,
) -> Report:
    """Return the report of the study of Ning et al. 2016.

    Args:
        study: the results.
        figures: the figures, by file name.
        summary: contents of summary.json.
        scenario: name or path of the simulated scenario.

    """
    sections = [
        Section("The paper and this study", texts=paper.INTRODUCTION),
        *(Section(title, tables=tables) for title, tables in paper.tables(study).items()),
        _figures(figures),
        provenance_section(
            [("Scenario", scenario)],
            shlex.join(["cpid", "paper", "--scenario", scenario, "--out", "OUT"]),
        ),
    ]
    return Report(
        "Study of Ning et al. 2016", f"Scenario {scenario}", sections, {"summary": _json(summary)}
    )


def accuracy_report(
    study: AccuracyStudy,
    figures: Mapping[str, PictureGroup],
    summary: Mapping[str, object],
    scenario: str,
) -> Report:
    """Return the report of an accuracy study; arguments as for `paper_report`."""
    words = ["cpid", "accuracy", scenario, "--trials", str(study.trials)]
    words += ["--seed", str(study.seed)]
    for option, name in (("--preset", "preset"), ("--estimator", "estimator")):
        for value in dict.fromkeys(getattr(result, name) for result in study.results):
            words += [option, value]
    sections = [
        Section(
            "Tables",
            texts=[accuracy.LEGEND, *accuracy.notes(study)],
            tables=accuracy.tables(study),
        ),
        _figures(figures),
        provenance_section(
            [("Scenario", scenario), ("Trials", str(study.trials)), ("Seed", str(study.seed))],
            shlex.join([*words, "--out", "OUT"]),
        ),
    ]
    subtitle = f"Scenario {scenario}, {study.trials} trials, seed {study.seed}"
    return Report("Accuracy of the estimators", subtitle, sections, {"summary": _json(summary)})


def write_study(folder: Path, page: Report, figures: Mapping[str, PictureGroup]) -> None:
    """Write a study's figures, and the files `STUDY_FILES`, into a folder.

    Args:
        folder: an existing folder.
        page: the report, with the summary.
        figures: the figures, by file name.

    """
    for name, group in figures.items():
        group.save(folder / name)
    page.write(folder / "report.html")
    write_text(folder / "summary.json", page.data["summary"] + "\n")


def _figures(groups: Mapping[str, PictureGroup]) -> Section:
    return Section("Figures", groups=list(groups.values()))


def _json(summary: Mapping[str, object]) -> str:
    return json.dumps(summary, indent=2, allow_nan=False)
