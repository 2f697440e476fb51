"""The tables of the paper's study."""

from collections.abc import Sequence

import numpy as np

from cpid_drake import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.report.page import Section, Table
from paper.rounding import RoundedCase, max_relative_error
from paper.study import PaperStudy
from paper.values import (
    EXCITING,
    PAPER_FIGURE_7,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
)

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


def sections(study: PaperStudy) -> list[Section]:
    """Return the sections with the study's tables, beside the paper's values."""
    return [
        Section("Identified parameters", tables=[_table_1(study)]),
        Section("Data of limited precision", tables=[_table_2(study)]),
        Section("Samples needed", tables=[_samples_table(study)]),
        Section("Checks", tables=[_checks_table(study)]),
    ]


def _compared(
    study: PaperStudy, caption: str, heads: Sequence[str], rows: Sequence[list[str]], note: str = ""
) -> Table:
    """Return a table whose last column is the paper's; it goes if the target is another."""
    last = None if study.is_papers_target else -1
    return Table(heads[:last], [row[:last] for row in rows], caption, note)


def _table_1(study: PaperStudy) -> Table:
    columns = (study.exact.parameters, study.six_decimals.parameters, PAPER_TABLE_1.to_vector())
    heads = ["", "true", f"{len(study.samples)} exact samples", "rounded to 6 decimals", "paper"]
    rows = [
        [
            f"{name} [{unit}]",
            f"{true:.7g}",
            *(f"{value + 0:.{n}f}" for value, n in zip(row, (9, 6, 6))),
        ]
        for name, unit, true, row in zip(
            PARAMETER_NAMES, PARAMETER_UNITS, study.truth.to_vector(), np.transpose(columns)
        )
    ]
    errors = [max_relative_error(np.asarray(values), study.truth) for values in columns]
    rows.append(["largest relative error", "", *(f"{error:.1e}" for error in errors)])
    note = (
        "Errors are relative to m for m, to |c| for c, and to the trace of I for I. The paper "
        "gives errors relative to each value; its largest is 5.2 %, of Ixx. The paper's inertia "
        "violates the triangle inequality: no rigid body has it."
    )
    return _compared(study, "Table 1. Identified parameters", heads, rows, note)


def _table_2(study: PaperStudy) -> Table:
    heads = ["decimals", "here, motion of Fig. 5, Eq. 18 [kg]"]
    columns = [{case.decimals: _mass(case) for case in study.rounded}]
    if study.exciting:
        heads += ["exciting motion, Eq. 18 [kg]", "exciting motion, all samples [kg]"]
        by_rows, by_fit = study.exciting
        columns.append({case.decimals: _mass(case) for case in by_rows})
        columns.append({case.decimals: _mass(case, with_interval=True) for case in by_fit})
    heads.append("paper, printed [kg]")
    columns.append({decimals: f"{mass:.6f}" for decimals, mass in PAPER_TABLE_2.items()})
    rows = [
        [str(case.decimals), *(each.get(case.decimals, "") for each in columns)]
        for case in study.rounded
    ]
    note = (
        f"The columns with Eq. 18 use {len(study.samples)} samples. All samples: the trajectory "
        "fit of the whole log with the rounding as its noise (from 8 decimals on that of 7, "
        "because splines through the samples are less precise), and its 95 % interval. Exciting "
        f"motion: the shipped scenario {EXCITING}, of the same spacecraft, target and duration. "
        "Values that are lost in rounding (the base moves less than one step of it) or that "
        "failed a check are no answers; they are shown for comparison only."
    )
    caption = "Table 2. Mass from data rounded to a number of decimals"
    return _compared(study, caption, heads, rows, note)


def _mass(case: RoundedCase, with_interval: bool = False) -> str:
    """Return the mass with the decimals that the data have, and why it is no answer."""
    if np.isnan(case.mass):
        return case.objection
    text = f"{case.mass:.{min(max(case.decimals, 2), 9)}f}"
    if case.objection:
        return f"{text} ({case.objection})"
    low, high = case.identification.intervals[0]
    half = np.format_float_positional((high - low) / 2, 2, False, False, "-")
    return f"{text} ± {half}" if with_interval else text


def _samples_table(study: PaperStudy) -> Table:
    rows = []
    for n, found in enumerate(study.by_count, 1):
        error = max_relative_error(found.parameters, study.truth)
        text = f"{error:.1e}" if np.isfinite(error) else "not identifiable"
        rows.append([str(n), str(found.rank), text])
    heads = ("samples", "rank of 10", "largest relative error")
    return Table(heads, rows, "Rank and error by number of samples (the paper uses two)")


def _checks_table(study: PaperStudy) -> Table:
    (linear, angular), rounded = study.drift, study.rounded_momentum[1]
    rows = [
        ["momentum drift in the simulation, linear [N·s]", f"{linear:.1e}", ""],
        ["momentum drift in the simulation, angular [N·m·s]", f"{angular:.1e}", ""],
        ["angular momentum in data of 6 decimals [N·m·s]", f"{rounded:.1e}", "1e-2"],
        *(
            [
                f"{name} error after re-simulation (Fig. 7)",
                f"{x:.4%}",
                f"{PAPER_FIGURE_7[name]:.2%}",
            ]
            for name, x in study.figure_7.items()
        ),
        ["online minus batch, relative", f"{study.online_minus_batch:.1e}", ""],
    ]
    return _compared(study, "Checks", ["", "here", "paper"], rows)
