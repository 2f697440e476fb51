"""Planned motions: tables for the terminal, and the pictures of a plan."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import spearmanr

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.digits import significant
from cpid_drake.files.drafts import draft_of
from cpid_drake.files.pictures import Picture, curves, label_axes, legend_below, save_pictures
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.page import Table
from cpid_drake.simulation.trials import motions_of

LEGEND = (
    "σ: Cramér-Rao bound with all errors that the sensors' file and the spacecraft's uncertainty "
    "state, if all else is calibrated. Plausible: if all else has errors of a plausible size. "
    "Scale: the mass, 0.5 m, and the trace of I of the assumed target."
)
"""The explanation of the tables."""

_SIZE = (4.6, 4.2)  # of each picture of a plan [in]


def motion_table(found: Mapping[str, Prediction], title: str) -> Table:
    """Return what is expected of motions, one column each, and what a fit found in trials."""
    columns = found.values()
    rows = dict[str, Sequence[float]]()
    is_calibrated = all(each.plausible_sigma is each.sigma for each in columns)
    for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)):
        rows[f"σ({name}), {unit}"] = [each.sigma[k] for each in columns]
        if not is_calibrated:
            rows[f"σ({name}), plausible"] = [each.plausible_sigma[k] for each in columns]
    rows["worst σ, % of scale"] = [100 * each.worst for each in columns]
    rows["rotation of the base, deg"] = [np.degrees(each.base_rotation) for each in columns]
    rows["its rate, deg/s"] = [np.degrees(each.base_rate) for each in columns]
    rows["its displacement, m"] = [each.base_displacement for each in columns]
    rows["largest share of a limit"] = [max(each.usage.values()) for each in columns]
    if any(len(each.errors) for each in columns):
        rows["worst error of fits, %"] = [100 * each.realised for each in columns]
        rows["fits that failed"] = [np.isnan(each.errors).any(axis=1).sum() for each in columns]
    cells = [[name, *(_number(value) for value in values)] for name, values in rows.items()]
    return Table(["", *found], cells, title, LEGEND)


def rank_correlation(found: Mapping[str, Prediction]) -> float:
    """Return Spearman's rank correlation of predicted and realised errors of motions."""
    pairs = np.array([(each.worst, each.realised) for each in found.values()])
    return float(spearmanr(pairs[np.isfinite(pairs).all(axis=1)]).statistic)


def save_plan(
    path: Path,
    planner: Planner,
    motions: Mapping[str, JointMotion],
    found: Mapping[str, Prediction],
) -> None:
    """Draw a plan, PNG or SVG: σ of each parameter, the rotation of the base, and the joints.

    The motions are by name, the plan's last; `predictions` makes what is found. The first plausible
    target is assumed.

    Raises:
        InputError: the file cannot be written.

    """
    *_, plan = motions.values()
    times = np.linspace(0.0, plan.duration, 301)
    joints, rotations = plan.evaluate(times), []
    for motion in motions.values():
        case = planner.case(motion, planner.targets[0])
        [moved] = motions_of([case], planner.spacecraft.tree, planner.spacecraft.joint_names, times)
        cosine = np.clip(np.abs(moved.quaternion_WB @ moved.quaternion_WB[0]), 0, 1)
        rotations.append(np.degrees(2 * np.arccos(cosine)))
    rotation, names = np.transpose(rotations), planner.spacecraft.joint_names
    pictures = [
        Picture("predicted σ", partial(_draw_sigma, found), _SIZE),
        curves("Rotation of the base", times, rotation, "deg", [*motions], size=_SIZE),
        curves("Positions", times, joints[:, 0], "rad or m", names, size=_SIZE),
        curves("Rates", times, joints[:, 1], "rad/s or m/s", names, size=_SIZE),
    ]
    with draft_of(path) as draft:
        save_pictures(draft, path.suffix[1:], pictures, 2)


def _draw_sigma(predictions: Mapping[str, Prediction], axes: Axes) -> None:
    for k, (name, each) in enumerate(predictions.items()):
        axes.bar(np.arange(10) + 0.4 * k, 100 * each.sigma / each.scale, 0.4, label=name)
    axes.set_yscale("log")
    axes.set_xticks(np.arange(10) + 0.2, PARAMETER_NAMES)
    label_axes(axes, "Predicted σ", "", "% of scale")
    legend_below(axes)


def _number(value: float) -> str:
    return significant(value, 3) if np.isfinite(value) else "–"
