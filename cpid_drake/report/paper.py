"""The tables and figures of the paper's study."""

from itertools import chain

import numpy as np
from rich.console import Console
from rich.table import Table

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.report.paper_conclusions import conclusions
from cpid_drake.report.paper_figures import (
    base_response_group,
    configuration_group,
    convergence_group,
    decimals_group,
    error_group,
    joint_motion_group,
)
from cpid_drake.report.pictures import PictureGroup
from cpid_drake.report.terminal import print_in_parts
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.paper_values import (
    LIVELIER,
    PAPER_DIGITS,
    PAPER_FIGURE_7,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    PAPER_TARGET,
)
from cpid_drake.studies.parameter_errors import parameter_errors
from cpid_drake.studies.rounding import RoundedCase


def tables(study: PaperStudy) -> dict[str, list[tuple[Table, str]]]:
    """Return the study's tables with the paper's values, and a note for each, by section."""
    return {
        "Identified parameters": [
            (_table_1(study), ""),
            (_errors_table(study), _errors_note(study)),
        ],
        "Data of limited precision": [(_table_2(study), _table_2_note(study))],
        "Any set of instants": [
            (_samples_table(study), ""),
            (_sets_table(study), _SETS_NOTE),
        ],
        "Checks": [(_checks_table(study), "")],
    }


def print_tables(study: PaperStudy, console: Console) -> None:
    """Print the study's conclusions, and its tables with the paper's values."""
    for sentence in conclusions(study):
        console.print(sentence, highlight=False)
    for table, note in chain.from_iterable(tables(study).values()):
        console.print()
        print_in_parts(console, table)
        if note:
            console.print(note, style="dim", highlight=False)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", header_style="bold")
    table.add_column(columns[0])
    for column in columns[1:]:
        table.add_column(column, justify="right")
    return table


def _comparable(study: PaperStudy, *cells: str) -> tuple[str, ...]:
    """Drop the last cell, the paper's value, if the target is not the paper's."""
    return cells if study.is_papers_target else cells[:-1]


def _table_1(study: PaperStudy) -> Table:
    exact = study.exact.parameters
    rounded = study.rounded_to(PAPER_DIGITS).identification.parameters
    paper = PAPER_TABLE_1.to_vector()
    table = _table(
        "Table 1. Identified parameters",
        *_comparable(
            study,
            "",
            "true",
            f"{len(study.samples)} exact samples",
            "rounded to 6 decimals",
            "paper (6 decimals)",
        ),
    )
    rows = zip(PARAMETER_NAMES, PARAMETER_UNITS, study.truth.to_vector(), exact, rounded, paper)
    for name, unit, true, ours, ours_rounded, theirs in rows:
        cells = (
            f"{name} [{unit}]",
            f"{true:.7g}",
            f"{round(ours, 9) + 0:.9f}",
            f"{round(ours_rounded, 6) + 0:.6f}",
            f"{theirs:.6f}",
        )
        table.add_row(*_comparable(study, *cells))
    return table


def _errors_table(study: PaperStudy) -> Table:
    """Return the error of each parameter in Table 1."""
    columns = ("", f"{len(study.samples)} exact samples", "rounded to 6 decimals", "paper")
    table = _table("Table 1. Relative error of each parameter", *_comparable(study, *columns))
    estimates = (
        study.exact.parameters,
        study.rounded_to(PAPER_DIGITS).identification.parameters,
        PAPER_TABLE_1.to_vector(),
    )
    errors = np.array([parameter_errors(values, study.truth) for values in estimates])
    for name, row in zip(PARAMETER_NAMES, errors.T, strict=True):
        table.add_row(*_comparable(study, name, *(f"{error:+.1e}" for error in row)))
    table.add_section()
    largest = (f"{error:.1e}" for error in np.abs(errors).max(axis=1))
    table.add_row(*_comparable(study, "largest", *largest))
    return table


def _errors_note(study: PaperStudy) -> str:
    note = "Errors are relative to m for m, to |c| for c, and to the trace of I for I."
    if study.is_papers_target:
        worst = PAPER_TABLE_1.to_vector()[4] / PAPER_TARGET.to_vector()[4] - 1
        note += (
            f" The paper gives errors relative to each value; its largest is {abs(worst):.1%}, of "
            "Ixx. The paper's inertia violates the triangle inequality: no rigid body has it."
        )
    return note


def _table_2(study: PaperStudy) -> Table:
    columns = ["decimals", "paper, printed [kg]", "here, motion of Fig. 5, Eq. 18 [kg]"]
    livelier = study.livelier
    if livelier is not None:
        columns += ["livelier motion, Eq. 18 [kg]", "livelier motion, all samples [kg]"]
    if not study.is_papers_target:
        columns.remove("paper, printed [kg]")
    table = _table("Table 2. Mass from data rounded to a number of decimals", *columns)
    for case in study.rounded:
        cells = [str(case.decimals)]
        if study.is_papers_target:
            theirs = PAPER_TABLE_2.get(case.decimals)
            cells.append("" if theirs is None else f"{theirs:.6f}")
        cells.append(_mass(case))
        if livelier is not None:
            for cases, write in ((livelier.by_rows, _mass), (livelier.by_fit, _mass_interval)):
                cells.append(next((write(c) for c in cases if c.decimals == case.decimals), ""))
        table.add_row(*cells)
    return table


def _mass(case: RoundedCase) -> str:
    """Return the mass with the decimals that the data have, and why it is no answer."""
    if np.isnan(case.mass):
        return case.objection
    places = min(max(case.decimals, 2), 9)
    text = f"{case.mass:.{places}f}"
    return f"{text} ({case.objection})" if case.objection else text


def _mass_interval(case: RoundedCase) -> str:
    """Return the mass with its 95 % interval if it is an answer, else why it is none."""
    low, high = case.identification.intervals[0]
    return _mass(case) if case.objection else f"{_mass(case)} ± {(high - low) / 2:.2g}"


def _table_2_note(study: PaperStudy) -> str:
    note = f"The columns with Eq. 18 use {len(study.samples)} samples."
    if study.livelier is None:
        return note
    return (
        f"{note} All samples: the trajectory fit of the {study.livelier.log_size} samples of the "
        "log, with the rounding as their noise (from 8 decimals on that of 7, because splines "
        "through the samples are less precise), and its 95 % interval. Livelier motion: the "
        f"shipped scenario {LIVELIER}, of the same spacecraft, target and duration. "
        "Values that are lost in rounding (the base moves less than one step of it) or "
        "that failed a check are no answers; they are shown for comparison only."
    )


def _samples_table(study: PaperStudy) -> Table:
    table = _table(
        "Rank and error by number of samples (the paper uses two)",
        "samples",
        "rank of 10",
        "largest relative error",
    )
    for case in study.by_count:
        error = case.max_relative_error
        table.add_row(
            str(case.n), str(case.rank), f"{error:.1e}" if np.isfinite(error) else "not determined"
        )
    return table


_SETS_NOTE = (
    "Disagreement: the largest difference of any parameter between two sets of the same size, "
    "relative to m, |c| or the trace of I; – if there are no two sets, or not all of the sets with "
    "rank 10 determine all parameters after rounding."
)


def _sets_table(study: PaperStudy) -> Table:
    table = _table(
        "Identifications from any set of instants",
        "instants",
        "sets",
        "rank of 10",
        "sets that determine all",
        "disagreement, exact",
        "disagreement, 6 decimals",
    )
    for sets in study.sets:
        low, high = sets.ranks
        differences = (sets.disagreement, sets.disagreement_rounded)
        table.add_row(
            str(sets.n),
            str(sets.count),
            str(low) if low == high else f"{low} to {high}",
            str(sets.complete),
            *(f"{value:.1e}" if np.isfinite(value) else "–" for value in differences),
        )
    return table


def _checks_table(study: PaperStudy) -> Table:
    table = _table("Checks", *_comparable(study, "", "here", "paper"))
    drift = [np.linalg.norm(x, axis=1).max() for x in (study.linear_drift, study.angular_drift)]
    attitude, position = study.max_attitude_relative_error, study.max_position_relative_error
    share = study.update_seconds / study.simulation.scenario.identification.period
    theirs = {name: f"{value:.2%}" for name, value in PAPER_FIGURE_7.items()}
    for cells in (
        ("momentum drift in the simulation, linear [N·s]", f"{drift[0]:.1e}", ""),
        ("momentum drift in the simulation, angular [N·m·s]", f"{drift[1]:.1e}", ""),
        (
            "angular momentum in data rounded to 6 decimals [N·m·s]",
            f"{study.rounded_angular_momentum:.1e}",
            "1e-2",
        ),
        ("attitude error after re-simulation (Fig. 7)", f"{attitude:.4%}", theirs["attitude"]),
        ("position error after re-simulation (Fig. 7)", f"{position:.4%}", theirs["position"]),
        ("online minus batch, relative", f"{study.online_minus_batch:.1e}", ""),
        ("Eq. 17, largest entry of AᵀA − 1 of the attitudes", f"{study.orthonormality:.1e}", ""),
        (
            "time of one update on this machine [µs]",
            f"{1e6 * study.update_seconds:.0f}",
            "“can be ignored”",
        ),
        ("the same, as a share of the time between samples", f"{share:.4%}", ""),
    ):
        table.add_row(*_comparable(study, *cells))
    return table


FIGURES = {
    "table2_decimals.png": decimals_group,
    "figure3_configurations.png": configuration_group,
    "figure5_joint_motion.png": joint_motion_group,
    "figure6_base_response.png": base_response_group,
    "figure7_errors.png": error_group,
    "online_convergence.png": convergence_group,
}
"""The function that draws each figure, by file name, in the order of the page."""


def figures(study: PaperStudy) -> dict[str, PictureGroup]:
    """Return the study's figures, by file name."""
    return {name: draw(study) for name, draw in FIGURES.items()}
