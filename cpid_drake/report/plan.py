"""Planned motions: tables for the terminal, and the pictures of a plan and of a front."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import spearmanr

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.planning.comparison import Compared
from cpid_drake.planning.prediction import MotionSetting, Prediction
from cpid_drake.report.page import Table
from cpid_drake.report.pictures import COLORS, Picture, PictureGroup, label_axes

LEGEND = (
    "σ: Cramér-Rao bound with all errors that the sensors declare and the spacecraft's "
    "uncertainty. Scale: the mass, 0.5 m, and the trace of I of the assumed target."
)
"""The explanation of the tables."""

_SIZE = (4.2, 3.0)  # of each picture of a plan [in]


def prediction_table(predictions: Mapping[str, Prediction], title: str) -> Table:
    """Return the predicted σ of each parameter, one column for each motion.

    Args:
        predictions: the predictions for one target, by the motions' names.
        title: of the table.

    """
    columns = predictions.values()
    rows = [
        (f"σ({name}), {unit}", *(each.sigma[k] for each in columns))
        for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True))
    ]
    rows += [
        ("worst σ, % of scale", *(100 * each.worst for each in columns)),
        ("turn of the base, deg", *(np.degrees(each.base_angle) for each in columns)),
        ("its rate, deg/s", *(np.degrees(each.base_rate) for each in columns)),
        ("its shift, m", *(each.base_shift for each in columns)),
    ]
    cells = [[name, *(_number(value) for value in values)] for name, *values in rows]
    return Table(["", *predictions], cells, title, LEGEND)


def comparison_table(compared: Mapping[str, Compared], title: str) -> Table:
    """Return what is expected of motions, one row each, and what a fit found in trials."""
    heads = ["motion", "worst σ, %", "largest share of a limit", "turn of the base, deg"]
    has_trials = any(len(each.errors) for each in compared.values())
    rows = []
    for name, each in compared.items():
        expected = each.prediction
        values = [100 * expected.worst, each.usage, np.degrees(expected.base_angle)]
        failed = np.count_nonzero(np.isnan(each.errors).any(axis=1))
        values += [100 * each.realised, failed] if has_trials else []
        rows.append([name, *(_number(value) for value in values)])
    heads += ["worst error of fits, %", "fits that failed"] if has_trials else []
    return Table(heads, rows, title, LEGEND)


def rank_correlation(compared: Mapping[str, Compared]) -> float:
    """Return Spearman's rank correlation of predicted and realised errors of motions."""
    pairs = np.array([(each.prediction.worst, each.realised) for each in compared.values()])
    return float(spearmanr(pairs[np.isfinite(pairs).all(axis=1)]).statistic)


def plan_pictures(
    name: str,
    setting: MotionSetting,
    motions: Mapping[str, JointMotion],
    predictions: Mapping[str, Prediction],
    target: NDArray[np.float64],
) -> PictureGroup:
    """Return the pictures of a plan: σ of each parameter, the turn of the base, and the joints.

    Args:
        name: of their file.
        setting: spacecraft and sensors.
        motions: the motions by name, the plan's last.
        predictions: the predictions for them.
        target: (10,) π of the assumed target.

    """
    *_, plan = motions.values()
    pictures = [
        Picture("sigma", "predicted σ", partial(_draw_sigma, predictions), _SIZE),
        Picture("base", "turn of the base", partial(_draw_base, setting, motions, target), _SIZE),
        Picture("positions", "positions of the joints", partial(_draw_joints, plan, 0), _SIZE),
        Picture("rates", "rates of the joints", partial(_draw_joints, plan, 1), _SIZE),
    ]
    return PictureGroup(name, "Planned motion", pictures)


def _draw_sigma(predictions: Mapping[str, Prediction], axes: Axes) -> None:
    width = 0.8 / len(predictions)
    for k, (name, each) in enumerate(predictions.items()):
        x = np.arange(10) + (k - (len(predictions) - 1) / 2) * width
        axes.bar(x, 100 * each.sigma / each.scale, width, color=COLORS[k], label=name)
    axes.set_yscale("log")
    axes.set_xticks(np.arange(10), PARAMETER_NAMES)
    axes.legend()
    label_axes(axes, "Predicted σ", "", "% of scale")


def _draw_base(
    setting: MotionSetting,
    motions: Mapping[str, JointMotion],
    target: NDArray[np.float64],
    axes: Axes,
) -> None:
    for k, (name, motion) in enumerate(motions.items()):
        times = np.linspace(0.0, motion.duration, 301)
        [moved] = setting.telemetries(motion, target[None], times)
        cosine = np.clip(np.abs(moved.quaternion_WB @ moved.quaternion_WB[0]), 0, 1)
        axes.plot(times, np.degrees(2 * np.arccos(cosine)), color=COLORS[k], label=name)
    label_axes(axes, "Turn of the base", "time [s]", "deg")


def _draw_joints(motion: JointMotion, derivative: int, axes: Axes) -> None:
    times = np.linspace(0.0, motion.duration, 301)
    for j, values in enumerate(motion.evaluate(times)[:, derivative].T):
        axes.plot(times, values, ("-", "--", ":")[j // 6 % 3], color=COLORS[j % 6], linewidth=1.0)
    what, unit = (("Positions", "rad or m"), ("Rates", "rad/s or m/s"))[derivative]
    label_axes(axes, f"{what} of the plan's joints", "time [s]", unit)


def front_picture(values: NDArray[np.float64]) -> Picture:
    """Return the picture of a front.

    Args:
        values: (N, 2) turn of the base [deg] and worst σ [% of scale] of N motions.

    """
    draw = partial(_draw_front, values)
    return Picture("front", "worst σ of motions over their turn of the base", draw, (4.5, 3.2))


def _draw_front(values: NDArray[np.float64], axes: Axes) -> None:
    axes.plot(values[:, 0], values[:, 1], "o-", color=COLORS[0])
    axes.set_ylim(0.0, 1.1 * values[:, 1].max())
    title = "Precision against disturbance of the base"
    label_axes(axes, title, "largest turn of the base [deg]", "worst σ [% of scale]")


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
