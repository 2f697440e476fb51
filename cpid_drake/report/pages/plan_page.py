"""The page of a planned motion: what to expect of it, and how joints and base move."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.digits import significant
from cpid_drake.files.figures import COLORS, curves, new_figure
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.page import Report, Section, Table
from cpid_drake.report.sections.data import written_by
from cpid_drake.simulation.trials import motions_of

_HEIGHT = 340  # of each figure [px]


def plan_report(
    planner: Planner,
    motions: Mapping[str, JointMotion],
    predictions: Mapping[str, Prediction],
    table: Table,
    facts: Sequence[tuple[str, str]],
) -> Report:
    """Return the page of a plan: σ of each parameter, rotation of the base, joints, numbers.

    Args:
        planner: the planner; its first plausible target is assumed.
        motions: by name; the plan is the last.
        predictions: what `predictions` makes of them.
        table: the predictions as a table.
        facts: names and values about the plan.

    """
    *_, (name, plan) = motions.items()
    times = np.linspace(0.0, plan.duration, 301)
    joints, rotations = plan.evaluate(times), []
    for motion in motions.values():
        case = planner.case(motion, planner.targets[0])
        [moved] = motions_of([case], planner.spacecraft.tree, planner.spacecraft.joint_names, times)
        cosine = np.clip(np.abs(moved.quaternion_WB @ moved.quaternion_WB[0]), 0, 1)
        rotations.append(np.degrees(2 * np.arccos(cosine)))
    rotation, names = np.transpose(rotations), planner.spacecraft.joint_names
    figures = [
        _sigma_figure(predictions),
        curves("Rotation of the base", times, rotation, "deg", [*motions], height=_HEIGHT),
        curves("Positions", times, joints[:, 0], "rad or m", names, height=_HEIGHT),
        curves("Rates", times, joints[:, 1], "rad/s or m/s", names, height=_HEIGHT),
    ]
    worst = significant(100 * predictions[name].worst, 3)
    return Report(
        f"Planned motion: worst σ {worst} % of scale",
        f"{plan.duration:g} s, a target of {planner.targets[0][0]:.3g} kg",
        [
            Section("Motion", figures=figures, columns=2),
            Section("Predictions", tables=[table], folded=True),
            Section("Plan", facts=[*facts, written_by()], warnings=planner.notes),
        ],
    )


def _sigma_figure(predictions: Mapping[str, Prediction]) -> go.Figure:
    """Return the figure of the predicted σ of each parameter, beside each other for motions."""
    figure = new_figure("Predicted σ", "", "% of scale", height=_HEIGHT)
    for k, (name, each) in enumerate(predictions.items()):
        share, marker = 100 * each.sigma / each.scale, {"color": COLORS[k % 6]}
        figure.add_bar(x=PARAMETER_NAMES, y=share, name=name, marker=marker)
    return figure.update_yaxes(type="log", exponentformat="power")
