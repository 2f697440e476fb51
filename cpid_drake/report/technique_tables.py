"""Tables and figures of the comparison of techniques."""

import csv
import io
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from cpid_drake.report.page import Section, Table
from cpid_drake.report.pictures import COLORS, INK, Picture, label_axes, legend_below
from cpid_drake.studies.techniques.claims import CLAIMS, judge
from cpid_drake.studies.techniques.comparison import ONE_JOINT, Cell, Comparison

INTRODUCTION = (
    "Every technique gets the same samples of the same motion with the same noise, only the known "
    "spacecraft besides, and its best form: unknowns in which no acceleration of the base is "
    "needed, weights from residuals, zeros and calibrations estimated with their priors. What is "
    "called naive has a row of its own.",
    "Errors are those of the worst of the ten parameters, relative to m, 0.5 m and the trace of I: "
    "RMS over the trials, with its 95 % interval by resampling. Two errors that differ by less "
    "than a factor of 1.5 are equal. Exact is the error without noise, with a dash for techniques "
    "that filter samples. The bound is the Cramér–Rao bound of momentum, or, for sensors of "
    "forces, that of an exact motion.",
)
"""What the tables show."""


def sections(found: Comparison) -> list[Section]:
    """Return the page's sections: claims, errors of each cell, other results, failures."""
    errors = [_errors(found, cell) for cell in dict.fromkeys(each.cell for each in found.scores)]
    return [
        Section("What is compared", texts=INTRODUCTION),
        Section("The paper’s claims", facts=claims(found)),
        Section("Errors at a glance", pictures=pictures(found)),
        Section("Errors of each technique", tables=errors),
        Section("Motions, training and control of their own", tables=[_extras(found)]),
        Section("What each needs", tables=[_needs(found)]),
        Section("Failures", texts=_failures(found)),
    ]


def claims(found: Comparison) -> list[tuple[str, str]]:
    """Return the claims, each with its verdict and the numbers that it follows from."""
    result = []
    for claim in CLAIMS:
        values, verdict = judge(claim, found)
        ours = "; ".join(f"{name}: {number(value)}" for name, value in values.items())
        text = f"{verdict}. The paper: {claim.papers}. Here, {claim.quantity}: {ours}."
        result.append((claim.text, text[0].upper() + text[1:]))
    return result


def short_table(found: Comparison) -> str:
    """Return six lines of Markdown, for the README."""
    names = {
        "trajectory_fit": "momentum, `trajectory_fit`",
        "accelerations": "accelerations, relative form",
        "torques 0.1 %": "joint torques of 0.1 % of full scale",
        "wrist 0.1 % estimated": "wrist sensor, calibrated to 0.1 %",
    }
    first = "RMS error, worst parameter ([all techniques](docs/explanation-techniques.md))"
    lines = [[first, *(f"`{m}`, `{s}`" for m, s in _COLUMNS)], ["---"] * 5]
    for name, label in names.items():
        lines.append([label, *(number(found.error(name, m, s)) for m, s in _COLUMNS)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


_COLUMNS = [(m, s) for m in ("paper", "exciting_motion") for s in ("flight", "servicer")]


def _errors(found: Comparison, cell: Cell) -> Table:
    rows = []
    for score in found.scores:
        if score.cell is cell:
            low, high = score.interval
            [record] = [each for each in found.techniques if each.name == score.technique]
            share = f"{np.isfinite(score.errors).sum()}/{len(score.errors)}"
            span = f"{number(low)} – {number(high)}" if np.isfinite(low) else ""
            numbers = [number(score.exact), number(score.bound), number(score.rms), span]
            rows.append([record.label, *numbers, share, number(score.seconds)])
    heads = ["", "exact", "bound", "RMS error", "95 %", "estimates", "seconds"]
    return Table(heads, rows, _title(cell))


def _title(cell: Cell) -> str:
    target = "the scenario’s target" if cell.target == "paper" else "a target without symmetry"
    return f"{cell.motion} ({cell.case.duration:.3g} s), {cell.suite}, {target}"


def _extras(found: Comparison) -> Table:
    rows = [
        [extra, name, number(value)]
        for extra, numbers in found.extras.items()
        for name, value in numbers.items()
    ]
    note = (
        "The planar relations of one joint at a time have an error of the model, with exact data; "
        "three axes determine m, c and three moments. Turns of the base are in degrees, tracking "
        "errors in radians. "
    ) + ("A fast run leaves out the network and adaptive control." if found.is_fast else "")
    return Table(["", "quantity", "value"], rows, note=note)


def _needs(found: Comparison) -> Table:
    rows = [[each.label, each.measures or "nothing", each.reference] for each in found.techniques]
    return Table(["", "besides attitude, gyro, encoders", "from"], rows)


def _failures(found: Comparison) -> list[str]:
    return [
        f"{score.technique} ({_title(score.cell)}): {score.problem}"
        for score in found.scores
        if score.problem
    ] or ["No technique failed in a trial."]


def pictures(found: Comparison) -> list[Picture]:
    """Return a picture of the errors of all techniques, and of adaptive control over time."""
    result = []
    by_motion: dict[str, list[Cell]] = {}
    for cell in dict.fromkeys(score.cell for score in found.scores):
        if cell.motion != ONE_JOINT:
            by_motion.setdefault(cell.motion, []).append(cell)
    for motion, cells in by_motion.items():
        draw = partial(_draw_errors, found, cells)
        result.append(Picture(f"errors of {motion}", draw, (8.0, 5.2)))
    if found.runs:
        draw = partial(_draw_runs, found)
        result.append(Picture("errors of adaptive control", draw, (8.0, 3.2)))
    return result


def _draw_errors(found: Comparison, cells: Sequence[Cell], axes: Axes) -> None:
    labels = {each.name: each.label for each in found.techniques}
    place = {name: k for k, name in enumerate(labels)}
    for k, cell in enumerate(cells):
        scores = [score for score in found.scores if score.cell is cell]
        y = np.array([place[score.technique] for score in scores])
        y = y + 0.2 * (k - (len(cells) - 1) / 2)
        rms = np.array([score.rms for score in scores])
        spans = np.array([score.interval for score in scores])
        spread = np.maximum(np.abs(spans.T - rms), 0.0)
        color = COLORS[k]
        name = f"{cell.suite}, {cell.target} target"
        axes.errorbar(rms, y, xerr=spread, fmt="o", color=color, label=name, markersize=4)
        bounds = [score.bound for score in scores]
        axes.plot(bounds, y, "|", color=color if k else INK, markersize=9)
    axes.set_xscale("log")
    axes.set_yticks(np.arange(len(labels)), list(labels.values()))
    axes.invert_yaxis()
    label_axes(axes, cells[0].motion, "RMS error of the worst parameter (| bound)", "")
    legend_below(axes, 3)


def _draw_runs(found: Comparison, axes: Axes) -> None:
    for (name, run), color in zip(found.runs.items(), COLORS):
        axes.semilogy(run.time, run.error, color=color, label=name)
        axes.semilogy(run.time, run.tracking, ":", color=color)
    label_axes(axes, "Adaptive control", "time [s]", "worst parameter; dotted: joints [rad]")
    legend_below(axes, 2)


def number(value: float) -> str:
    """Return a number with two digits; a dash if there is none."""
    if not np.isfinite(value):
        return "–"
    if 100 <= abs(value) < 1e4:
        return f"{value:.0f}"
    return f"{value:.2g}" if 0.01 <= abs(value) < 100 or not value else f"{value:.1e}"


def as_csv(found: Comparison) -> str:
    """Return all scores, and the numbers of all extras, as CSV."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    heads = ["technique", "motion", "sensors", "target", "exact", "bound", "rms", "low", "high"]
    writer.writerow([*heads, "trials", "estimates", "seconds"])
    for score in found.scores:
        cell, (low, high) = score.cell, score.interval
        numbers = [score.exact, score.bound, score.rms, low, high]
        counts = [len(score.errors), int(np.isfinite(score.errors).sum())]
        names = [score.technique, cell.motion, cell.suite, cell.target]
        shown = [f"{value:.6g}" for value in numbers]
        writer.writerow([*names, *shown, *counts, f"{score.seconds:.3g}"])
    for extra, values in found.extras.items():
        for name, value in values.items():
            writer.writerow([extra, name, "", "", "", "", f"{value:.6g}", "", "", "", "", ""])
    return file.getvalue()
