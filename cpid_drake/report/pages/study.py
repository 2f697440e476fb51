"""The reports of the studies: tables and figures on one page."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rich.table

from cpid_drake.report import accuracy, paper
from cpid_drake.report.page import Cell, Report, Section, Table
from cpid_drake.scenario.run_files import versions
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.paper import PaperStudy


@dataclass(frozen=True, eq=False)
class StudySection(Section):
    """A section of texts, tables with notes, and figure files with labels."""

    title: str
    texts: Sequence[str] = ()
    tables: Sequence[tuple[Table, str]] = ()
    files: Sequence[tuple[Path, str]] = ()
    template = "study.html.j2"


@dataclass(frozen=True, eq=False)
class StudyProvenance(Section):
    """Versions, and the command that repeats the study."""

    facts: Sequence[tuple[str, str]]
    command: str
    title = "Provenance"
    template = "provenance.html.j2"


def paper_report(
    study: PaperStudy, files: Sequence[Path], summary: dict[str, Any], scenario: str
) -> Report:
    """Return the report of the study of Ning et al. 2016.

    Args:
        study: the results.
        files: PNG files of the figures.
        summary: contents of summary.json.
        scenario: name or path of the simulated scenario.

    """
    introduction = (
        "Reproduces the simulation and the identification of Ning et al. 2016, Coordinated "
        "Parameter Identification Technique for the Inertial Parameters of Non-Cooperative Target "
        "(PLoS ONE 11(4): e0153604)."
    )
    sections = [
        StudySection(
            "Tables", [introduction], [(page_table(t), note) for t, note in paper.tables(study)]
        ),
        _figures(files),
        StudyProvenance(
            _facts(scenario), shlex.join(["cpid", "paper", "--scenario", scenario, "--out", "OUT"])
        ),
    ]
    return Report(
        "Study of Ning et al. 2016", f"Scenario {scenario}", sections, {"summary": _json(summary)}
    )


def accuracy_report(
    study: AccuracyStudy, files: Sequence[Path], summary: dict[str, Any], scenario: str
) -> Report:
    """Return the report of an accuracy study; arguments as for `paper_report`."""
    tables = [(page_table(table), "") for table in accuracy.tables(study)]
    words = ["cpid", "accuracy", scenario, "--trials", str(study.trials)]
    words += ["--seed", str(study.seed)]
    for option, name in (("--preset", "preset"), ("--estimator", "estimator")):
        for value in dict.fromkeys(getattr(result, name) for result in study.results):
            words += [option, value]
    sections = [
        StudySection("Tables", [accuracy.LEGEND, *accuracy.notes(study)], tables),
        _figures(files),
        StudyProvenance(
            [*_facts(scenario), ("Trials", str(study.trials)), ("Seed", str(study.seed))],
            shlex.join([*words, "--out", "OUT"]),
        ),
    ]
    subtitle = f"Scenario {scenario}, {study.trials} trials, seed {study.seed}"
    return Report("Accuracy of the estimators", subtitle, sections, {"summary": _json(summary)})


def page_table(table: rich.table.Table) -> Table:
    """Return a table of the terminal as a table of a page."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    rows = [[first, *map(Cell, rest)] for first, *rest in zip(*columns)]
    heads = [str(column.header).replace("\n", " ") for column in table.columns]
    return Table(heads, rows, str(table.title or ""))


def _figures(files: Sequence[Path]) -> StudySection:
    labels = [(file, file.stem.replace("_", " ")) for file in files]
    return StudySection("Figures", files=labels)


def _facts(scenario: str) -> list[tuple[str, str]]:
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return [("Scenario", scenario), ("Versions", used)]


def _json(summary: dict[str, Any]) -> str:
    return json.dumps(summary, indent=2, allow_nan=False)
