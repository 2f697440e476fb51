"""The tables and figures of the paper's study."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
from rich.console import Console

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.report.page import Cell, Table
from cpid_drake.report.paper_figures import (
    base_response_group,
    configuration_group,
    convergence_group,
    decimals_group,
    error_group,
    joint_motion_group,
)
from cpid_drake.report.pictures import PictureGroup
from cpid_drake.report.terminal import print_table
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.paper_values import (
    EXCITING,
    PAPER_DIGITS,
    PAPER_FIGURE_7,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
)
from cpid_drake.studies.parameter_errors import parameter_errors
from cpid_drake.studies.rounding import RoundedCase

INTRODUCTION = (
    "Reproduces the simulation and the identification of Ning et al. 2016, Coordinated Parameter "
    "Identification Technique for the Inertial Parameters of Non-Cooperative Target (PLoS ONE "
    "11(4): e0153604).",
    "The method is exact: what exact samples leave is the error of the integration. In rounded "
    "samples the error of the mass is proportional to the step of the rounding over the speed of "
    "the base, so a motion that moves the base faster gives a better mass from the same decimals. "
    "The paper gives neither the masses of its spacecraft nor its joint angles; ours need not move "
    "its base as fast. Rounding explains no plateau: here every decimal improves the mass. The "
    "paper says that two instants suffice; two leave one combination open, and three determine "
    "all.",
)
"""What the paper does, and where its results differ from those of any rigid spacecraft."""


def tables(study: PaperStudy) -> dict[str, list[Table]]:
    """Return the study's tables with the paper's values, by section."""
    return {
        "Identified parameters": [_table_1(study), _errors_table(study)],
        "Data of limited precision": [_table_2(study)],
        "Samples needed": [_samples_table(study)],
        "Checks": [_checks_table(study)],
    }


def print_tables(study: PaperStudy, console: Console) -> None:
    """Print the study's tables with the paper's values."""
    for table in chain.from_iterable(tables(study).values()):
        print_table(console, table)


def _compared(study: PaperStudy, caption: str, rows: Sequence[tuple[str, ...]], note: str) -> Table:
    """Return a table whose first row has the heads, and whose last column is the paper's.

    If the target is not the paper's, this column is left out.
    """
    last = None if study.is_papers_target else -1
    heads, *others = (row[:last] for row in rows)
    return Table(heads, [[name, *map(Cell, values)] for name, *values in others], caption, note)


def _table_1(study: PaperStudy) -> Table:
    exact = study.exact.parameters
    rounded = study.rounded_to(PAPER_DIGITS).identification.parameters
    paper = PAPER_TABLE_1.to_vector()
    count = len(study.samples)
    rows: list[tuple[str, ...]] = [
        ("", "true", f"{count} exact samples", "rounded to 6 decimals", "paper (6 decimals)")
    ]
    columns = (PARAMETER_NAMES, PARAMETER_UNITS, study.truth.to_vector(), exact, rounded, paper)
    for name, unit, true, ours, ours_rounded, theirs in zip(*columns, strict=True):
        cells = (f"{true:.7g}", f"{round(ours, 9) + 0:.9f}", f"{round(ours_rounded, 6) + 0:.6f}")
        rows.append((f"{name} [{unit}]", *cells, f"{theirs:.6f}"))
    return _compared(study, "Table 1. Identified parameters", rows, "")


def _errors_table(study: PaperStudy) -> Table:
    """Return the error of each parameter in Table 1."""
    estimates = (
        study.exact.parameters,
        study.rounded_to(PAPER_DIGITS).identification.parameters,
        PAPER_TABLE_1.to_vector(),
    )
    errors = np.array([parameter_errors(values, study.truth) for values in estimates])
    rows: list[tuple[str, ...]] = [
        ("", f"{len(study.samples)} exact samples", "rounded to 6 decimals", "paper")
    ]
    for name, row in zip(PARAMETER_NAMES, errors.T, strict=True):
        rows.append((name, *(f"{error:+.1e}" for error in row)))
    rows.append(("largest", *(f"{error:.1e}" for error in np.abs(errors).max(axis=1))))
    note = "Errors are relative to m for m, to |c| for c, and to the trace of I for I."
    if study.is_papers_target:
        note += (
            " The paper gives errors relative to each value; its largest is 5.2 %, of Ixx. The "
            "paper's inertia violates the triangle inequality: no rigid body has it."
        )
    return _compared(study, "Table 1. Relative error of each parameter", rows, note)


def _table_2(study: PaperStudy) -> Table:
    exciting = study.exciting
    note = f"The columns with Eq. 18 use {len(study.samples)} samples."
    heads = ["decimals", "here, motion of Fig. 5, Eq. 18 [kg]"]
    columns = [{case.decimals: _mass(case) for case in study.rounded}]
    if exciting is not None:
        heads += ["exciting motion, Eq. 18 [kg]", "exciting motion, all samples [kg]"]
        columns.append({case.decimals: _mass(case) for case in exciting.by_rows})
        columns.append({case.decimals: _mass_interval(case) for case in exciting.by_fit})
        note += (
            f" All samples: the trajectory fit of the {exciting.log_size} samples of the log, with "
            "the rounding as their noise (from 8 decimals on that of 7, because splines through "
            "the samples are less precise), and its 95 % interval. Exciting motion: the shipped "
            f"scenario {EXCITING}, of the same spacecraft, target and duration. Values that are "
            "lost in rounding (the base moves less than one step of it) or that failed a check are "
            "no answers; they are shown for comparison only."
        )
    heads.append("paper, printed [kg]")
    columns.append({decimals: f"{mass:.6f}" for decimals, mass in PAPER_TABLE_2.items()})
    rows = [tuple(heads)]
    for case in study.rounded:
        rows.append((str(case.decimals), *(each.get(case.decimals, "") for each in columns)))
    return _compared(study, "Table 2. Mass from data rounded to a number of decimals", rows, note)


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


def _samples_table(study: PaperStudy) -> Table:
    rows: list[list[Cell | str]] = []
    for case in study.by_count:
        error = case.max_relative_error
        text = f"{error:.1e}" if np.isfinite(error) else "not determined"
        rows.append([str(case.n), Cell(str(case.rank)), Cell(text)])
    heads = ("samples", "rank of 10", "largest relative error")
    return Table(heads, rows, "Rank and error by number of samples (the paper uses two)")


def _checks_table(study: PaperStudy) -> Table:
    drift = [np.linalg.norm(x, axis=1).max() for x in (study.linear_drift, study.angular_drift)]
    attitude, position = study.max_attitude_relative_error, study.max_position_relative_error
    theirs = {name: f"{value:.2%}" for name, value in PAPER_FIGURE_7.items()}
    rows = [
        ("", "here", "paper"),
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
    ]
    return _compared(study, "Checks", rows, "")


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
