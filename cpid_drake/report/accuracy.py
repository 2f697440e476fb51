"""The tables and figures of an accuracy study."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.report.style import COLORS, saved_figure
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.statistics import Accuracy

LEGEND = (
    "Scale: the true mass, 0.5 m, and the trace of I. NEES: mean normalized estimation error "
    "squared; ! marks values outside the 95 % band. Bias / spread: the largest of the ten "
    "parameters. Within 1 %: share of trials with an error below 1 % of scale, for the worst "
    "parameter."
)
"""The explanation of the tables."""


def tables(study: AccuracyStudy) -> list[Table]:
    """Return error over bound, NEES and coverage of every estimator, one table for each preset."""
    result = []
    for preset, results in by_preset(study).items():
        table = Table(
            title=f"{preset}: RMS error over Cramér-Rao bound, {study.trials} trials, seed "
            f"{study.seed}",
            title_justify="left",
            title_style="bold",
            header_style="bold",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
            pad_edge=False,
        )
        table.add_column("", no_wrap=True)
        table.add_column("bound, %\nof scale", justify="right")
        for r in results:
            table.add_column(r.estimator.replace("_", "\n"), justify="right")
        bound = 100 * results[0].crlb / study.scale
        for i, name in enumerate(PARAMETER_NAMES):
            table.add_row(name, f"{bound[i]:.2g}", *(_ratio(r.ratio[i]) for r in results))
        table.add_section()
        table.add_row("NEES", "10", *(_nees(r) for r in results))
        table.add_row("95 % coverage", "95 %", *(_percent(r.coverage_all) for r in results))
        table.add_row("  least", "", *(_percent(r.coverage.min()) for r in results))
        table.add_row("  most", "", *(_percent(r.coverage.max()) for r in results))
        table.add_row("bias / spread", "0", *(_largest_bias(r) for r in results))
        table.add_row("within 1 %", "", *(_percent(r.within_one_percent.min()) for r in results))
        table.add_row("failed", "", *(str(r.failed) for r in results))
        result.append(table)
    return result


def notes(study: AccuracyStudy) -> list[str]:
    """Return further findings as sentences."""
    lines = []
    for r in study.results:
        if r.detected is not None and r.detected[0]:
            share, delay = r.detected
            text = f"{r.preset}: momentum change detected in {_percent(share)} of the trials"
            lines.append(text + (f", after at most {delay:.2f} s" if np.isfinite(delay) else ""))
    return [*lines, *study.notes]


def print_table(study: AccuracyStudy, console: Console) -> None:
    """Print the tables and their explanation."""
    for table in tables(study):
        console.print(table)
    for line in (LEGEND, *notes(study)):
        console.print(line)


def write_figures(study: AccuracyStudy, folder: Path) -> list[Path]:
    """Write a figure for each preset into a folder: errors with their bound, and coverage."""
    files = []
    for preset, results in by_preset(study).items():
        path = folder / f"accuracy_{Path(preset).stem}.png"
        shown = [r for r in results if r.failed < r.trials]
        with saved_figure(path, 8.0, 6.2) as figure:
            figure.suptitle(
                f"Sensors “{preset}”, {study.trials} trials", x=0.01, ha="left", weight="bold"
            )
            errors, coverage = figure.subplots(2, 1, height_ratios=[1.7, 1])
            _draw_errors(errors, shown, results[0].crlb / study.scale, study)
            _draw_coverage(coverage, shown)
            for axes in (errors, coverage):
                axes.set_xticks(np.arange(10), PARAMETER_NAMES)
                axes.grid(axis="x", visible=False)
                axes.set_xlim(-0.6, 9.6)
        files.append(path)
    return files


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
    low, high = r.nees_band
    if not np.isfinite(r.nees_mean):
        return "–"
    number = f"{r.nees_mean:.3g}" if r.nees_mean < 1000 else f"{r.nees_mean:.0e}"
    return number + ("" if low <= r.nees_mean <= high else " !")


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
    style = {"markersize": 4, "color": COLORS[k], "elinewidth": 1, "label": label}
    axes.errorbar(x, 100 * share, yerr=bars, fmt="o", **style)
    return x


def _draw_errors(
    axes: Axes, results: list[Accuracy], bound: NDArray[np.float64], study: AccuracyStudy
) -> None:
    bias_style = {"markersize": 7, "markeredgewidth": 1.6}
    for k, r in enumerate(results):
        interval = r.ratio_interval * r.crlb / study.scale
        x = _draw_shares(axes, k, len(results), r.rmse / study.scale, interval, r.estimator)
        biased = np.abs(r.bias) > r.bias_halfwidth
        bias = 100 * np.abs(r.bias / study.scale)[biased]
        axes.plot(x[biased], bias, "_", color=COLORS[k], **bias_style)
    for i, value in enumerate(100 * bound):
        axes.plot([i - 0.42, i + 0.42], 2 * [value], color="black", linewidth=1.2)
    axes.plot([], [], color="black", linewidth=1.2, label="Cramér-Rao bound")
    axes.plot([], [], "_", color="#555555", label="significant |bias|", **bias_style)
    axes.set_yscale("log")
    axes.set_ylabel("% of scale")
    axes.set_title("Root mean square error (scale: m, 0.5 m, trace of I)")
    axes.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.1))


def _draw_coverage(axes: Axes, results: list[Accuracy]) -> None:
    axes.axhspan(92, 98, color="#dddddd", zorder=0)
    axes.axhline(95, color="black", linewidth=0.8)
    for k, r in enumerate(results):
        _draw_shares(axes, k, len(results), r.coverage, r.coverage_interval)
    lowest = min((100 * r.coverage_interval[0].min() for r in results), default=0.0)
    axes.set_ylim(max(lowest - 5, -3), 103)
    axes.set_ylabel("trials [%]")
    axes.set_title("Share of 95 % intervals that contain the true value (grey: 92–98 %)")
