"""The tables and figures of an accuracy study."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.report.page import Cell, Table
from cpid_drake.report.pictures import Picture, PictureGroup
from cpid_drake.report.style import COLORS, INK
from cpid_drake.report.terminal import print_table
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.statistics import Accuracy

LEGEND = (
    "Scale: the true mass, 0.5 m, and the trace of I. NEES: mean normalized estimation error "
    "squared, 10 if the covariance agrees with the errors and larger if they are larger than it "
    "says; ! marks values outside the 95 % band. Bias / spread: the largest of the ten parameters. "
    "Within 1 %: share of trials with an error below 1 % of scale, for the worst parameter. The "
    "ratios of fewer than 50 trials are uncertain by over a tenth."
)
"""The explanation of the tables."""

_SIZE = (8.0, 3.4)  # of the figures [in]


def tables(study: AccuracyStudy) -> list[Table]:
    """Return error over bound, NEES and coverage of every estimator, one table for each preset."""
    result = []
    for preset, results in by_preset(study).items():
        bound = 100 * results[0].crlb / study.scale
        rows = [
            (name, f"{bound[i]:.2g}", *(_ratio(r.ratio[i]) for r in results))
            for i, name in enumerate(PARAMETER_NAMES)
        ]
        rows += [
            ("NEES", "10", *(_nees(r) for r in results)),
            ("95 % coverage", "95 %", *(_percent(r.coverage_all) for r in results)),
            ("  least", "", *(_percent(r.coverage.min()) for r in results)),
            ("  most", "", *(_percent(r.coverage.max()) for r in results)),
            ("bias / spread", "0", *(_largest_bias(r) for r in results)),
            ("within 1 %", "", *(_percent(r.within_one_percent.min()) for r in results)),
            ("failed", "", *(str(r.failed) for r in results)),
        ]
        heads = ["", "bound, %\nof scale", *(r.estimator.replace("_", "\n") for r in results)]
        caption = (
            f"{preset}: RMS error over Cramér-Rao bound, {study.trials} trials, seed {study.seed}"
        )
        result.append(Table(heads, [[name, *map(Cell, rest)] for name, *rest in rows], caption))
    return result


def _nees_is_right(r: Accuracy) -> bool:
    return bool(r.nees_band[0] <= r.nees_mean <= r.nees_band[1])


def notes(study: AccuracyStudy) -> list[str]:
    """Return further findings as sentences."""
    lines = []
    for r in study.results:
        if r.detected is not None and r.detected[0]:
            share, delay = r.detected
            text = f"{r.preset}: momentum change detected in {_percent(share)} of the trials"
            lines.append(text + (f", after at most {delay:.2f} s" if np.isfinite(delay) else ""))
    return [*lines, *study.notes]


def print_tables(study: AccuracyStudy, console: Console) -> None:
    """Print the tables and their explanation."""
    for table in tables(study):
        print_table(console, table)
    for line in (LEGEND, *notes(study)):
        console.print(line)


def figures(study: AccuracyStudy) -> dict[str, PictureGroup]:
    """Return the figures of each preset, by file name: errors with their bound, and coverage."""
    groups = {}
    for preset, results in by_preset(study).items():
        shown = [r for r in results if r.failed < r.trials]
        name = Path(preset).stem
        bound = results[0].crlb / study.scale
        errors = partial(_draw_errors, shown, bound, study)
        what = f"sensors “{name}”, {study.trials} trials"
        pictures = [
            Picture(f"errors-{name}", f"Errors: {what}", errors, _SIZE),
            Picture(f"coverage-{name}", f"Coverage: {what}", partial(_draw_coverage, shown), _SIZE),
        ]
        groups[figure_name(preset)] = PictureGroup(what.capitalize(), pictures, 1)
    return groups


def figure_name(preset: str) -> str:
    """Return the file name of a preset's figure."""
    return f"accuracy_{Path(preset).stem}.png"


def by_preset(study: AccuracyStudy) -> dict[str, list[Accuracy]]:
    """Return the results grouped by preset."""
    groups: dict[str, list[Accuracy]] = {}
    for result in study.results:
        groups.setdefault(result.preset, []).append(result)
    return groups


def _ratio(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "–"


def _nees(r: Accuracy) -> str:
    if not np.isfinite(r.nees_mean):
        return "–"
    number = f"{r.nees_mean:.3g}" if r.nees_mean < 1000 else f"{r.nees_mean:.0e}"
    return number + ("" if _nees_is_right(r) else " !")


def _largest_bias(r: Accuracy) -> str:
    if r.trials < r.failed + 2:
        return "–"
    spread = np.sqrt(np.maximum(r.rmse**2 - r.bias**2, 1e-300))
    return f"{np.max(np.abs(r.bias) / spread):.2g}"


def _draw_shares(
    axes: Axes,
    k: int,
    count: int,
    share: NDArray[np.float64],
    interval: NDArray[np.float64],
    label: str = "",
) -> np.ndarray:
    """Draw ten shares (10,) with their intervals (2, 10) in %, as series k of `count`.

    Returns:
        The places (10,) of the points on the axis of the parameters.

    """
    x = np.arange(10) - 0.4 + (k + 0.5) * 0.8 / count
    bars = 100 * np.abs(interval - share)
    style = {"markersize": 4, "color": COLORS[k % 6], "elinewidth": 1, "label": label}
    axes.errorbar(x, 100 * share, yerr=bars, fmt="o", **style)
    return x


def _draw_errors(
    results: list[Accuracy], bound: NDArray[np.float64], study: AccuracyStudy, figure: Figure
) -> None:
    axes = figure.subplots()
    bias_style = {"markersize": 7, "markeredgewidth": 1.6}
    is_biased = False
    for k, r in enumerate(results):
        interval = r.ratio_interval * r.crlb / study.scale
        x = _draw_shares(axes, k, len(results), r.rmse / study.scale, interval, r.estimator)
        biased = np.abs(r.bias) > r.bias_halfwidth
        bias = 100 * np.abs(r.bias / study.scale)[biased]
        axes.plot(x[biased], bias, "_", color=COLORS[k % 6], **bias_style)
        is_biased |= bool(biased.any())
    for i, value in enumerate(100 * bound):
        axes.plot([i - 0.42, i + 0.42], 2 * [value], color=INK, linewidth=1.2)
    axes.plot([], [], color=INK, linewidth=1.2, label="Cramér-Rao bound")
    if is_biased:
        axes.plot([], [], "_", color=INK, label="significant |bias|", **bias_style)
    axes.set_yscale("log")
    axes.set_ylabel("% of scale")
    axes.set_title("Root mean square error (scale: m, 0.5 m, trace of I)")
    _finish(axes, figure)


def _draw_coverage(results: list[Accuracy], figure: Figure) -> None:
    axes = figure.subplots()
    axes.axhspan(92, 98, color=INK, alpha=0.12, linewidth=0, zorder=0)
    axes.axhline(95, color=INK, linewidth=0.8)
    for k, r in enumerate(results):
        _draw_shares(axes, k, len(results), r.coverage, r.coverage_interval, r.estimator)
    lowest = min((100 * r.coverage_interval[0].min() for r in results), default=0.0)
    axes.set_ylim(max(lowest - 5, -3), 103)
    axes.set_ylabel("trials [%]")
    axes.set_title("Share of 95 % intervals that contain the true value (grey: 92–98 %)")
    _finish(axes, figure)


def _finish(axes: Axes, figure: Figure) -> None:
    """Name the parameters, and put the legend below."""
    axes.set_xticks(np.arange(10), PARAMETER_NAMES)
    axes.grid(axis="x", visible=False)
    axes.set_xlim(-0.6, 9.6)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=4)
