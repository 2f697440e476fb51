"""Tables and figures of the comparison of techniques."""

import numpy as np
import plotly.graph_objects as go

from cpid_drake.files.figures import COLORS, new_figure
from cpid_drake.report.page import Section, Table
from techniques.claims import CLAIMS, judge
from techniques.comparison import ONE_JOINT, Cell, TechniqueComparison
from techniques.records import FIT

INTRODUCTION = (
    "Every technique gets the same samples of the same motion with the same noise, only the known "
    "spacecraft besides, and its best form: unknowns in which no acceleration of the base is "
    "needed, weights from residuals, zeros and calibrations estimated with their priors. What is "
    "called naive has a row of its own.",
    "Errors are those of the worst of the ten parameters, relative to m, 0.5 m and the trace of I: "
    "RMS over the trials, with its 95 % interval by resampling. Two errors that differ by less "
    "than a factor of 1.5 are equal. Exact is the error without noise, with a dash for techniques "
    "that filter samples. The bound is the Cramér–Rao bound of momentum, or, for sensors of "
    "forces, that of an exact motion. Instants are those whose exact rows determine all ten.",
)
"""What the tables show."""

_QUANTITIES = ("exact", "instants", "bound", "rms", "low", "high", "estimates", "seconds")


def sections(found: TechniqueComparison) -> list[Section]:
    """Return the page's sections: claims, errors of each cell, other results, failures."""
    needs = [[each.name, each.measures or "nothing", each.reference] for each in found.records]
    failures = [f"{', '.join(key)}: {problem}" for key, problem in found.problems.items()]
    errors = [_errors(found, cell) for cell in found.cells]
    return [
        Section("What is compared", texts=INTRODUCTION),
        Section("Errors at a glance", figures=figures(found), columns=1),
        Section("The paper’s claims", facts=claims(found)),
        Section(
            "Errors of each technique", tables=[each for each in errors if each.rows], folded=True
        ),
        Section(
            "Motions, training and control of their own", tables=[_experiments(found)], folded=True
        ),
        Section(
            "What each needs",
            tables=[Table(["", "besides attitude, gyro, encoders", "from"], needs)],
            folded=True,
        ),
        Section("Failures", texts=failures or ["No technique failed in a trial."], folded=True),
    ]


def claims(found: TechniqueComparison) -> list[tuple[str, str]]:
    """Return the claims, each with its verdict and the numbers that it follows from."""
    result = []
    for claim in CLAIMS:
        values, verdict = judge(claim, found)
        ours = "; ".join(f"{name}: {number(value)}" for name, value in values.items())
        text = f"{verdict.capitalize()}. The paper: {claim.papers}."
        result.append((claim.text, f"{text} Here: {ours}." if ours else text))
    return result


def short_table(found: TechniqueComparison) -> str:
    """Return six lines of Markdown, for the README."""
    names = {
        FIT: "momentum, `trajectory_fit`",
        "accelerations, relative": "accelerations, relative form",
        "joint torques, 0.1 % of full scale": "joint torques of 0.1 % of full scale",
        "wrist sensor, 0.1 % estimated": "wrist sensor, calibrated to 0.1 %",
    }
    columns = [(m, "rms", s) for m in ("paper", "exciting_motion") for s in ("flight", "servicer")]
    first = "RMS error, worst parameter ([all techniques](docs/explanation/techniques.md))"
    lines = [[first, *(f"`{m}`, `{s}`" for m, _, s in columns)], ["---"] * 5]
    for name, label in names.items():
        lines.append([label, *(number(found.number(name, *column)) for column in columns)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _errors(found: TechniqueComparison, cell: Cell) -> Table:
    rows = []
    for name in cell.techniques:
        values = found.numbers[name, cell.motion, cell.sensors, cell.target]
        if "rms" in values:
            shown = [number(values.get(each, np.nan)) for each in _QUANTITIES]
            rows.append([name, *shown])
    title = (
        f"{cell.motion} ({cell.truth.case.duration:.3g} s), {cell.sensors}, {cell.target} target"
    )
    return Table(["", *_QUANTITIES], rows, f"{title}, {found.trials} trials")


def _experiments(found: TechniqueComparison) -> Table:
    rows = [
        [
            f"{technique}, {motion}",
            name if target == "scenario" else f"{name} ({target})",
            number(value),
        ]
        for (technique, motion, _, target), values in found.numbers.items()
        if "rms" not in values
        for name, value in values.items()
    ]
    note = (
        "The planar relations of one joint at a time have an error of the model, with exact data; "
        "three axes determine m, c and three moments. A fast run leaves out the network and "
        "adaptive control."
    )
    return Table(["", "quantity", "value"], rows, note=note)


def figures(found: TechniqueComparison) -> list[go.Figure]:
    """Return a figure of the errors of all techniques for each motion."""
    motions = dict.fromkeys(cell.motion for cell in found.cells if cell.motion != ONE_JOINT)
    return [_error_figure(found, each) for each in motions]


def _error_figure(found: TechniqueComparison, motion: str) -> go.Figure:
    cells = [cell for cell in found.cells if cell.motion == motion]
    names = [each.name for each in found.records if each.experiment is None]
    label = "RMS error of the worst parameter (| bound)"
    figure = new_figure(motion, label, height=36 * len(names) + 160)
    for k, cell in enumerate(cells):
        place = (motion, cell.sensors, cell.target)
        rms, low, high, bounds = (
            np.array([found.numbers.get((name, *place), {}).get(each, np.nan) for name in names])
            for each in ("rms", "low", "high", "bound")
        )
        y = np.arange(len(names)) + 0.5 * (k + 0.5) / len(cells)  # below the name of the row
        color, title = COLORS[k % 6], f"{cell.sensors}, {cell.target} target"
        spread = {"array": np.maximum(high - rms, 0), "arrayminus": np.maximum(rms - low, 0)}
        marker = {"color": color, "size": 7}
        figure.add_scatter(
            x=rms, y=y, error_x=spread, mode="markers", name=title, text=names, marker=marker
        )
        marker = {"symbol": "line-ns", "size": 9, "line": {"color": color, "width": 2}}
        name = f"bound of {title}"
        figure.add_scatter(x=bounds, y=y, mode="markers", name=name, text=names, marker=marker)
    figure.update_xaxes(type="log", exponentformat="power")
    figure.update_layout(legend={"y": -0.1})
    for row, name in enumerate(names):  # inside the axes, so that they need no width
        corner = {"x": 0, "xref": "paper", "xanchor": "left", "yanchor": "bottom"}
        figure.add_annotation(text=name, y=row, showarrow=False, font={"size": 11}, **corner)
    rows = {"tickvals": np.arange(len(names)), "range": [len(names), -0.7]}
    return figure.update_yaxes(**rows, showticklabels=False)


def number(value: float) -> str:
    """Return a number with two digits; a dash if there is none."""
    if not np.isfinite(value):
        return "–"
    if 100 <= abs(value) < 1e4:
        return f"{value:.0f}"
    return f"{value:.2g}" if 0.01 <= abs(value) < 100 or not value else f"{value:.1e}"


def numbers(found: TechniqueComparison) -> Table:
    """Return the table of all numbers, one in each row."""
    heads = ["technique", "motion", "sensors", "target", "quantity", "value"]
    rows = [
        [*key, name, f"{value:.6g}"]
        for key, values in found.numbers.items()
        for name, value in values.items()
    ]
    return Table(heads, rows)
