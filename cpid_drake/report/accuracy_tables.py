"""The tables and figures of an accuracy study."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.report.page import Table
from cpid_drake.report.pictures import COLORS, INK, WIDE, Picture, legend_below
from cpid_drake.studies.accuracy import Accuracy, AccuracyStudy

LEGEND = (
    "Scale: the true mass, 0.5 m, and the trace of I. NEES: mean normalized estimation error "
    "squared, 10 if the covariance agrees with the errors and larger if they are larger than it "
    "says; ! marks values outside the 95 % band. Bias / spread: the largest of the ten parameters. "
    "The ratios of fewer than 50 trials are uncertain by over a tenth. The bound is that of an "
    "estimator that knows the spacecraft exactly, without firings that are not logged."
)
"""The explanation of the tables."""


def tables(study: AccuracyStudy) -> list[Table]:
    """Return error over bound, NEES and coverage of every estimator, one table for each suite."""
    result = []
    for preset, results in _by_preset(study).items():
        bound = 100 * results[0].crlb / study.scale
        rows = [
            [name, f"{bound[i]:.2g}", *(_number(r.ratio[i]) for r in results)]
            for i, name in enumerate(PARAMETER_NAMES)
        ]
        spread = [np.sqrt(np.maximum(r.rmse**2 - r.bias**2, 1e-300)) for r in results]
        bias = [np.abs(r.bias / s).max() for r, s in zip(results, spread)]
        rows += [
            ["NEES", "10", *(_nees(r) for r in results)],
            ["95 % coverage", "95 %", *(_percent(r.coverage.mean()) for r in results)],
            ["  least", "", *(_percent(r.coverage.min()) for r in results)],
            ["bias / spread", "0", *map(_number, bias)],
            ["failed", "", *(str(r.failed) for r in results)],
        ]
        heads = ["", "bound, % of scale", *(r.estimator.replace("_", " ") for r in results)]
        caption = f"{preset}: RMS error over Cramér-Rao bound, {study.trials} trials"
        problems = "; ".join(f"{r.estimator}: {r.problem}" for r in results if r.problem)
        result.append(Table(heads, rows, f"{caption}, seed {study.seed}", problems))
    return result


def pictures(study: AccuracyStudy) -> list[Picture]:
    """Return a picture of each suite: errors with their bound."""
    return [
        Picture(
            f"Sensors “{Path(preset).stem}”, {study.trials} trials",
            partial(_draw_errors, results, study),
            WIDE,
        )
        for preset, results in _by_preset(study).items()
    ]


def _by_preset(study: AccuracyStudy) -> dict[str, list[Accuracy]]:
    groups: dict[str, list[Accuracy]] = {}
    for result in study.results:
        groups.setdefault(result.preset, []).append(result)
    return groups


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "–"


def _nees(r: Accuracy) -> str:
    if not np.isfinite(r.nees):
        return "–"
    low, high = r.nees_band
    return f"{r.nees:.3g}" + ("" if low <= r.nees <= high else " !")


def _draw_errors(results: list[Accuracy], study: AccuracyStudy, axes: Axes) -> None:
    for k, r in enumerate(results):
        x = np.arange(10) - 0.4 + (k + 0.5) * 0.8 / len(results)
        style = {"color": COLORS[k % 6], "markersize": 5}
        axes.plot(x, 100 * r.rmse / study.scale, "o", label=r.estimator, **style)
    bound = 100 * results[0].crlb / study.scale
    axes.hlines(bound, np.arange(10) - 0.42, np.arange(10) + 0.42, color=INK, label="bound")
    axes.set_yscale("log")
    axes.set_ylabel("% of scale")
    axes.set_title("Root mean square error (scale: m, 0.5 m, trace of I)")
    axes.set_xticks(np.arange(10), PARAMETER_NAMES)
    axes.grid(axis="x", visible=False)
    axes.set_xlim(-0.6, 9.6)
    legend_below(axes, 6)
