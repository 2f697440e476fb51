"""The page of a campaign: tables, which are CSV files too, figures, and the worst trials."""

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from cpid_drake.campaign.statistics import CONFIDENCE, Statistics, Tally, clopper_pearson, verdict
from cpid_drake.campaign.trial import replayed
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.digits import significant
from cpid_drake.files.figures import COLORS, INK, new_figure
from cpid_drake.report.page import Report, Section, Table
from cpid_drake.report.pages.study import study_report
from cpid_drake.simulation.scenario_files import dump_scenario

LEGEND = (
    "Scale: the true mass, 0.5 m, and the trace of I. Bound: Cramér-Rao, with an "
    "exact spacecraft model and all thrust. NEES / n: squared error in units of the "
    "covariance, for each known parameter; 1 if the covariance is right, ! outside the 95 % "
    "band. Behind the coverage, its 95 % interval. Bias / spread: the largest of the parameters."
)
"""The explanation of the tables of errors."""

MOST_POINTS = 12
"""Largest number of points of the grids with a table of their own; files have all."""


def campaign_report(statistics: Statistics, folder: Path) -> Report:
    """Return the report of the campaign in a folder."""
    campaign = statistics.plan.campaign
    subtitle = (
        f"Scenario {campaign.scenario}, {statistics.done} of {statistics.plan.total} trials, seed "
        f"{campaign.seed}"
    )
    points = [errors(statistics, point) for point in range(len(statistics.plan.points))]
    tables = {f"errors-{point}": table for point, table in enumerate(points)}
    for each in (requirements, checks, failures, axes, worst):
        tables[each.__name__] = each(statistics)
    files = {f"{name}.csv": table.csv() for name, table in tables.items()}
    for number in {each.trial for cases in statistics.worst.values() for each in cases}:
        files[scenario_name(number)] = dump_scenario(replayed(statistics.plan, number))
    facts = [("Scenario", campaign.scenario), ("Campaign", statistics.plan.hash)]
    words = ["cpid", "campaign", "report", str(folder)]
    return study_report("Campaign", subtitle, sections(statistics), facts, words, files)


def sections(statistics: Statistics) -> list[Section]:
    """Return the sections of a campaign's page."""
    points = [
        errors(statistics, point) for point in range(len(statistics.plan.points))[:MOST_POINTS]
    ]
    result = [
        Section("Requirements", tables=[requirements(statistics)]),
        Section("Errors", figures=_error_figures(statistics), columns=1),
        Section("Errors in numbers", texts=[LEGEND], tables=points),
        Section("Checks", tables=[checks(statistics), failures(statistics)]),
        Section("Axes", tables=[axes(statistics)], figures=_axis_figures(statistics), columns=1),
        Section("Worst cases", tables=[worst(statistics)]),
        Section("Drake's simulation", texts=[compared(statistics)]),
    ]
    if not statistics.plan.campaign.requirements:
        result = result[1:]
    result = [replace(each, tables=[t for t in each.tables if t.rows]) for each in result]
    return [each for each in result if each.tables or each.texts or each.figures]


def requirements(statistics: Statistics) -> Table:
    """Return the verdict on each requirement, for each point and estimator."""
    heads = ["", "estimator", "error at most", "in trials", "met in", "at least", "verdict"]
    rows = []
    for (point, estimator), tally in sorted(statistics.by_point.items()):
        for name, each in statistics.plan.campaign.requirements.items():
            text, low = verdict(tally.met[name], tally.trials, each.probability)
            shares = [f"{tally.met[name]} of {tally.trials}", f"{100 * low:.4g} %", text]
            limit = f"{each.limit:g} m" if name == "com" else f"{100 * each.limit:g} %"
            where = _where(statistics, point)
            rows.append(
                [f"{name} {where}", estimator, limit, f"{100 * each.probability:g} %", *shares]
            )
    note = "At least: the share with a probability of 95 % (one-sided, Clopper and Pearson)."
    return Table(
        heads, rows, "Requirements", f"{note} A trial without an estimate does not meet them."
    )


def errors(statistics: Statistics, point: int) -> Table:
    """Return error over bound, NEES and coverage of every estimator in a point of the grids."""
    names = statistics.plan.campaign.estimators
    tallies = [statistics.by_point.get((point, name), Tally()) for name in names]
    bound = next((t for t in tallies if t.bounded.any()), Tally()).beside_bound()[1]
    has_bound, rows = bool(np.isfinite(bound).any()), []
    for i, name in enumerate(PARAMETER_NAMES):
        shown = [t.over_bound()[i] if has_bound else 100 * t.rms()[i] for t in tallies]
        rows.append([name, _number(100 * bound[i]), *map(_number, shown)])
    rows += [
        ["NEES / n", "1", *map(_nees, tallies)],
        ["95 % coverage", "95 %", *map(_coverage, tallies)],
        ["bias / spread", "0", *(_number(_bias(t)) for t in tallies)],
        ["largest error, % of scale", "", *(_number(100 * _size(t)) for t in tallies)],
        ["without estimate", "", *(f"{t.failed} of {t.trials}" for t in tallies)],
    ]
    heads = ["", "bound, % of scale", *(name.replace("_", " ") for name in names)]
    what = "RMS error over Cramér-Rao bound" if has_bound else "RMS error, % of scale"
    caption = f"{what}, {tallies[0].trials} trials {_where(statistics, point)}".strip()
    problems = "; ".join(f"{n}: {t.problem}" for n, t in zip(names, tallies) if t.problem)
    return Table(heads, rows, f"{caption}, seed {statistics.plan.campaign.seed}", problems)


def checks(statistics: Statistics) -> Table:
    """Return how often the checks are right, for each estimator over all points."""
    rows = []
    for name in statistics.plan.campaign.estimators:
        tallies = [t for (_, own), t in statistics.by_point.items() if own == name]
        count = {
            key: sum(t.verdicts[key] for t in tallies)
            for key in ((True, True), (True, False), (False, False), (False, True))
        }
        rows.append([name, *map(str, count.values()), str(sum(t.failed for t in tallies))])
    heads = [
        "",
        "passed, right",
        "passed, wrong",
        "failed rightly",
        "failed wrongly",
        "no estimate",
    ]
    note = "Wrong: by its own covariance, an error as large has a probability below 0.001."
    return Table(heads, rows, "Checks", note)


def failures(statistics: Statistics) -> Table:
    """Return how often each check failed, rightly and wrongly, over all points."""
    counts: dict[tuple[str, str], list[int]] = {}
    for (_, estimator), tally in statistics.by_point.items():
        for (name, is_right), count in tally.checks.items():
            counts.setdefault((estimator, name), [0, 0])[is_right] += count
    rows = [[check, name, *map(str, count)] for (name, check), count in sorted(counts.items())]
    return Table(["", "estimator", "rightly", "wrongly"], rows, "Failed checks")


def axes(statistics: Statistics) -> Table:
    """Return the errors in each part of each axis."""
    rows = [
        [f"{axis}: {part}", estimator, str(t.trials), str(t.failed), _number(100 * _size(t)),
         _nees(t), _coverage(t)]
        for (axis, part, estimator), t in statistics.by_axis.items() if t.trials
    ]  # fmt: skip
    heads = ["", "estimator", "trials", "without estimate", "error, % of scale", "NEES / n"]
    return Table([*heads, "95 % coverage"], rows, "RMS of the largest error along each axis")


def worst(statistics: Statistics) -> Table:
    """Return the trials with the largest errors, and the command that shows each in Meshcat."""
    rows = [
        [str(each.trial), name, _number(100 * each.error), _number(each.nees),
         each.failed_checks or "passed", shlex.join(["cpid", "view", scenario_name(each.trial)])]
        for name, cases in statistics.worst.items() for each in cases
    ]  # fmt: skip
    heads = ["trial", "estimator", "error, % of scale", "NEES", "checks", "in this folder"]
    note = "The scenarios have the trial's target, momentum, motion and noise."
    return Table(heads, rows, "Worst cases", note)


def scenario_name(trial: int) -> str:
    """Return the name of the file of a trial's scenario in the folder of its campaign."""
    return f"trial-{trial:09d}.yaml"


def compared(statistics: Statistics) -> str:
    """Return a sentence on how the propagated trials compare with Drake's simulation."""
    if not statistics.compared:
        return (
            "No trial was repeated with Drake's plant. The propagator takes "
            f"{1e3 * statistics.truth_seconds:.3g} ms of the processor for a trial."
        )
    ratio = statistics.drake_seconds / statistics.truth_seconds
    return (
        f"{statistics.compared} of {statistics.done} trials were repeated with Drake's plant of "
        f"the nominal spacecraft: the base's pose differs by at most {statistics.position:.2g} m "
        f"and {statistics.angle:.2g} rad. Drake takes {statistics.drake_seconds:.3g} s of the "
        f"processor for a trial, the propagator {1e3 * statistics.truth_seconds:.3g} ms, "
        f"{ratio:.0f} times less."
    )


def _where(statistics: Statistics, point: int) -> str:
    values = statistics.plan.points[point]
    return "".join(f"{key} {value} " for key, value in values.items()).strip()


def _size(tally: Tally) -> float:
    return float(np.sqrt(tally.scaled / tally.good)) if tally.good else np.nan


def _bias(tally: Tally) -> float:
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = tally.error / tally.counted
        spread = np.sqrt(np.maximum(tally.rms() ** 2 - mean**2, 1e-300))
        ratio = np.abs(mean) / spread
    return float(np.nanmax(ratio)) if tally.good > 1 else np.nan


def _nees(tally: Tally) -> str:
    if not tally.freedom:
        return "–"
    (low, high), value = tally.nees_band(), tally.nees / tally.freedom
    return significant(value, 3) + ("" if low <= value <= high else " !")


def _coverage(tally: Tally) -> str:
    inside, counted = tally.inside.sum(), tally.counted.sum()
    if not counted:
        return "–"
    # The parameters of a trial are not independent: as many as there are trials are counted.
    count = inside / counted * tally.good
    low, high = clopper_pearson(count, tally.good, (1 - CONFIDENCE) / 2)
    return f"{100 * inside / counted:.0f} % ({100 * low:.0f}–{100 * high:.0f})"


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.2g}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.0f}"


def _error_figures(statistics: Statistics) -> list[go.Figure]:
    """Return a figure of the errors of all estimators for each point of the grids."""
    return [_error_figure(statistics, k) for k in range(len(statistics.plan.points))[:MOST_POINTS]]


def _error_figure(statistics: Statistics, point: int) -> go.Figure:
    names, bounds = statistics.plan.campaign.estimators, list[np.ndarray]()
    title = f"RMS error {_where(statistics, point)}".strip()
    figure = new_figure(title, "", "% of scale (m, 0.5 m, trace of I)", height=330)
    for k, name in enumerate(names):
        tally = statistics.by_point.get((point, name), Tally())
        x = np.arange(10) - 0.4 + (k + 0.5) * 0.8 / len(names)
        error, bound = tally.beside_bound()
        marker = {"color": COLORS[k % 6], "size": 7}
        text = [f"{each} {name}" for each in PARAMETER_NAMES]
        figure.add_scatter(x=x, y=100 * error, mode="markers", name=name, marker=marker, text=text)
        bounds += [bound] if np.isfinite(bound).any() else []
    if bounds:
        ends = np.arange(10)[:, None] + [-0.42, 0.42, np.nan]
        height, line = 100 * np.repeat(bounds[0], 3), {"color": INK, "width": 2}
        figure.add_scatter(x=ends.ravel(), y=height, mode="lines", name="bound", line=line)
    figure.update_yaxes(type="log", exponentformat="power")
    names_at = {"tickvals": np.arange(10), "ticktext": PARAMETER_NAMES, "range": [-0.6, 9.6]}
    return figure.update_xaxes(showgrid=False, zeroline=False, **names_at)


def _axis_figures(statistics: Statistics) -> list[go.Figure]:
    """Return a figure of the errors along each axis."""
    figures = []
    for key in statistics.plan.campaign.axes:
        figure = new_figure(f"RMS of the largest error along {key}", key, "% of scale", height=330)
        parts = list(dict.fromkeys(part for axis, part, _ in statistics.by_axis if axis == key))
        for k, name in enumerate(statistics.plan.campaign.estimators):
            sizes = [100 * _size(statistics.by_axis[key, part, name]) for part in parts]
            line = {"color": COLORS[k % 6]}
            figure.add_scatter(x=parts, y=sizes, mode="lines+markers", name=name, line=line)
        figure.update_xaxes(type="category")
        figures.append(figure.update_yaxes(type="log", exponentformat="power"))
    return figures
