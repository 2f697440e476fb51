"""The reports of the studies: tables and figures on one page."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import rich.table

from cpid_drake.report import accuracy, paper
from cpid_drake.report.page import Cell, Report, Section, Table
from cpid_drake.report.sections.provenance import provenance_section
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.paper import PaperStudy


def paper_report(
    study: PaperStudy, files: Sequence[Path], summary: Mapping[str, object], scenario: str
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
        Section(
            "Tables",
            texts=[introduction],
            tables=[page_table(table, note) for table, note in paper.tables(study)],
        ),
        _figures(files),
        provenance_section(
            [("Scenario", scenario)],
            shlex.join(["cpid", "paper", "--scenario", scenario, "--out", "OUT"]),
        ),
    ]
    return Report(
        "Study of Ning et al. 2016", f"Scenario {scenario}", sections, {"summary": _json(summary)}
    )


def accuracy_report(
    study: AccuracyStudy, files: Sequence[Path], summary: Mapping[str, object], scenario: str
) -> Report:
    """Return the report of an accuracy study; arguments as for `paper_report`."""
    tables = [page_table(table) for table in accuracy.tables(study)]
    words = ["cpid", "accuracy", scenario, "--trials", str(study.trials)]
    words += ["--seed", str(study.seed)]
    for option, name in (("--preset", "preset"), ("--estimator", "estimator")):
        for value in dict.fromkeys(getattr(result, name) for result in study.results):
            words += [option, value]
    sections = [
        Section("Tables", texts=[accuracy.LEGEND, *accuracy.notes(study)], tables=tables),
        _figures(files),
        provenance_section(
            [("Scenario", scenario), ("Trials", str(study.trials)), ("Seed", str(study.seed))],
            shlex.join([*words, "--out", "OUT"]),
        ),
    ]
    subtitle = f"Scenario {scenario}, {study.trials} trials, seed {study.seed}"
    return Report("Accuracy of the estimators", subtitle, sections, {"summary": _json(summary)})


def page_table(table: rich.table.Table, note: str = "") -> Table:
    """Convert a table of the terminal to a table of a page."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    rows = [[first, *map(Cell, rest)] for first, *rest in zip(*columns)]
    heads = [str(column.header).replace("\n", " ") for column in table.columns]
    return Table(heads, rows, str(table.title or ""), note)


def _figures(files: Sequence[Path]) -> Section:
    labels = [(file, file.stem.replace("_", " ")) for file in files]
    return Section("Figures", files=labels)


def _json(summary: Mapping[str, object]) -> str:
    return json.dumps(summary, indent=2, allow_nan=False)
