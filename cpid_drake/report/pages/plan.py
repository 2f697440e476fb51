"""The page of a planned motion."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.planning.prediction import MotionSetting, Prediction
from cpid_drake.report.figures import motion_pictures
from cpid_drake.report.page import Report, Section, embedded_json
from cpid_drake.report.pictures import COLORS, WIDE, Picture, legend_below
from cpid_drake.report.plan import prediction_table
from cpid_drake.report.replay import replay_html
from cpid_drake.report.sections.data import provenance_section


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """What the page shows.

    Attributes:
        setting: spacecraft and sensors.
        motion: the planned motion.
        target: (10,) π of the target that the predictions assume.
        predictions: the predictions for it, by the motions' names, the plan's last.
        active: the limits that the motion reaches, in words.
        exceeded: the limits that it exceeds, one sentence each.
        notes: remarks.
        scenario: name or path of the scenario.
        command: the command that makes the plan.
        visual_model: model file with the target's shape; None for an ellipsoid.

    """

    setting: MotionSetting
    motion: JointMotion
    target: NDArray[np.float64]
    predictions: Mapping[str, Prediction]
    active: Sequence[str]
    exceeded: Sequence[str]
    notes: Sequence[str]
    scenario: str
    command: str
    visual_model: str | None = None


def plan_report(plan: PlannedMotion) -> Report:
    """Return the page: the predicted σ, the motion of joints and base, a replay."""
    names = list(plan.predictions)
    own, best = plan.predictions[names[0]], plan.predictions[names[-1]]
    ratio, target = own.worst / best.worst, plan.target
    texts = [
        f"The least certain parameter has a σ of {100 * best.worst:.3g} % of its scale. With the "
        f"{names[0]} it has {100 * own.worst:.3g} %, {ratio:.3g} times as much.",
        f"Limits that the motion reaches: {'; '.join(plan.active) or 'none'}.",
        *plan.notes,
    ]
    assumed = f"Predicted σ for a target of {target[0]:.3g} kg"
    ideal = plan.setting.ideal(plan.motion, target)
    return Report(
        "Planned motion",
        f"Scenario {plan.scenario}, {plan.motion.duration:g} s",
        [
            Section("Conclusion", warnings=plan.exceeded, texts=texts),
            Section(
                "Predicted σ",
                tables=[prediction_table(plan.predictions, assumed)],
                pictures=[_sigma_picture(plan.predictions)],
            ),
            Section("Joints", pictures=_joint_pictures(plan.motion)),
            Section("Base motion", pictures=motion_pictures(ideal)),
            _replay(plan),
            provenance_section([("Scenario", plan.scenario)], plan.command),
        ],
        {"plan": json.dumps({name: _plain(each) for name, each in plan.predictions.items()})},
    )


def _plain(prediction: Prediction) -> dict[str, object]:
    values = {name: np.asarray(value).tolist() for name, value in vars(prediction).items()}
    return json.loads(json.dumps(values).replace("NaN", "null"))


def _replay(plan: PlannedMotion) -> Section:
    times = np.linspace(0.0, plan.motion.duration, int(20 * plan.motion.duration) + 1)
    page = replay_html(
        plan.setting.spacecraft,
        plan.setting.telemetry(plan.motion, plan.target, times),
        (),
        truth=InertialParameters.from_vector(plan.target),
        visual_model=plan.visual_model,
        title="Planned motion",
    )
    text = "The motion in three dimensions, with the assumed target."
    return Section("Replay", texts=[text], inner_page=embedded_json(json.dumps(page)))


def _sigma_picture(predictions: Mapping[str, Prediction]) -> Picture:
    return Picture(
        "sigma", "predicted σ of each parameter", partial(_draw_sigma, predictions), WIDE
    )


def _draw_sigma(predictions: Mapping[str, Prediction], axes: Axes) -> None:
    width = 0.8 / len(predictions)
    for k, (name, each) in enumerate(predictions.items()):
        x = np.arange(10) + (k - (len(predictions) - 1) / 2) * width
        axes.bar(x, 100 * each.sigma / each.scale, width, color=COLORS[k % 6], label=name)
    axes.set_yscale("log")
    axes.set_ylabel("% of scale")
    axes.set_title("Predicted σ of each parameter")
    axes.set_xticks(np.arange(10), PARAMETER_NAMES)
    axes.grid(axis="x", visible=False)
    legend_below(axes)


def _joint_pictures(motion: JointMotion) -> list[Picture]:
    times = np.linspace(0.0, motion.duration, 301)
    values = motion.evaluate(times)
    labels = ("position [rad or m]", "rate [1/s]", "acceleration [1/s²]")
    return [
        Picture(f"joints-{k}", f"joint {label}", partial(_draw_joints, times, values[:, k], label))
        for k, label in enumerate(labels)
    ]


def _draw_joints(
    times: NDArray[np.float64], values: NDArray[np.float64], label: str, axes: Axes
) -> None:
    for j in range(values.shape[1]):
        style = ("-", "--", ":")[j // 6 % 3]
        axes.plot(times, values[:, j], style, color=COLORS[j % 6], linewidth=1.2)
    axes.set_xlabel("time [s]")
    axes.set_title(f"Joint {label}")
