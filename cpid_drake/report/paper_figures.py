"""The figures of the paper's study."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from cpid_drake.report.pictures import (
    COLORS,
    INK,
    Picture,
    PictureGroup,
    label_axes,
    legend_below,
)
from cpid_drake.report.scene import render_scenario
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.paper_values import PAPER_TABLE_2
from cpid_drake.studies.rounding import RoundedCase, parameter_errors

_TIME = "time [s]"
_CURVES = 6  # in one panel: more colours than that are hard to tell apart
_PANEL = (3.7, 2.9)

FIGURES = (
    "table2_decimals",
    "figure3_configurations",
    "figure5_joint_motion",
    "figure6_base_response",
    "figure7_errors",
    "online_convergence",
)
"""Names of the figures, in the order of the page."""


def figures(study: PaperStudy) -> list[PictureGroup]:
    """Return the study's figures, with the names `FIGURES`."""
    decimals = Picture("decimals", "Error of the mass", partial(_draw_decimals, study), _PANEL)
    online = Picture(
        "online", "Error of the online estimate", partial(_draw_convergence, study), _PANEL
    )
    t, angles = study.telemetry, np.degrees(study.telemetry.euler_321)
    axes, turns = ("x", "y", "z"), ("yaw", "pitch", "roll")
    motion = [
        _curves("(A) Position of the base", "p_WB [m]", t.time, t.p_WB - t.p_WB[0], axes),
        _curves("(B) Velocity of the base", "v_WB [m/s]", t.time, t.v_WB, axes),
        _curves("(C) Attitude, 3-2-1", "angle [deg]", t.time, angles, turns),
        _curves("(D) Angular velocity", "w_WB [deg/s]", t.time, np.degrees(t.w_WB), axes),
    ]
    attitude = 1e3 * np.degrees(np.abs(study.attitude_error))
    position = 1e6 * np.abs(study.position_error)
    errors = [
        _curves("(A) Attitude error", "|error| [mdeg]", t.time, attitude, turns),
        _curves("(B) Position error", "|error| [µm]", t.time, position, axes),
    ]
    joints = _joint_motion(study)
    titles = (
        "Error of the mass against the decimals of the data (Table 2)",
        "Configurations (Fig. 3)",
        "Joint motion (Fig. 5)",
        "Motion of the base (Fig. 6)",
        "Error of the base's motion after re-simulation (Fig. 7)",
        "Online estimate",
    )
    contents = ([decimals], _configurations(study), joints, motion, errors, [online])
    return [
        PictureGroup(name, title, pictures)
        for name, title, pictures in zip(FIGURES, titles, contents, strict=True)
    ]


def _configurations(study: PaperStudy) -> list[Picture]:
    """Return pictures of the spacecraft and its target at the start and at the end."""
    states = study.simulation.spacecraft.to_states(study.telemetry.select([0, -1]))
    images = render_scenario(study.simulation.scenario, list(states))
    pictures = []
    for name, time, image in zip("AB", study.telemetry.time[[0, -1]], images, strict=True):
        title = f"({name}) Configuration at {time:g} s"
        pictures.append(Picture(name, title, partial(_draw_image, image, title), (4.6, 3.5)))
    return pictures


def _joint_motion(study: PaperStudy) -> list[Picture]:
    """Return positions and rates of the joints that move, six joints in a picture."""
    telemetry, names = study.telemetry, study.simulation.spacecraft.joint_names
    moving = np.flatnonzero(np.ptp(telemetry.q, axis=0) > 1e-6)
    return [
        _curves(
            f"Joint {what}",
            unit,
            telemetry.time,
            np.degrees(values[:, part]),
            [names[k].replace("_", " ") for k in part],
        )
        for what, values, unit in (
            ("angles", telemetry.q, "angle [deg]"),
            ("rates", telemetry.qdot, "rate [deg/s]"),
        )
        for part in np.array_split(moving, max(1, -(-len(moving) // _CURVES)))
    ]


def _curves(
    title: str,
    label: str,
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    names: Sequence[str],
) -> Picture:
    """Return a picture of curves (N, K); the later of two that coincide is thinner and dashed."""

    def draw(axes: Axes) -> None:
        for k, name in enumerate(names):
            width, line = 2.6 - 1.6 * k / len(names), "--" if k % 2 else "-"
            axes.plot(time, values[:, k], line, color=COLORS[k], linewidth=width, label=name)
        label_axes(axes, title, _TIME, label)
        legend_below(axes, 2 if len(names) > 3 else 3)

    return Picture(title, f"{title} over time", draw, _PANEL)


def _draw_image(image: NDArray[np.uint8], title: str, axes: Axes) -> None:
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(title)


def _draw_decimals(study: PaperStudy, axes: Axes) -> None:
    def relative(masses: Sequence[float]) -> NDArray[np.float64]:
        return np.abs(np.array(masses) / study.truth.mass - 1)

    def plot(cases: Sequence[RoundedCase], style: str, color: str, label: str = "") -> None:
        axes.plot(
            [case.decimals for case in cases],
            relative([case.mass for case in cases]),
            style,
            color=color,
            label=label or None,
        )

    series = [("here, motion of Fig. 5", "o-", COLORS[0], study.rounded)]
    if study.exciting:
        theirs = relative(list(PAPER_TABLE_2.values()))
        axes.plot(list(PAPER_TABLE_2), theirs, "s--", color=COLORS[1], label="paper (printed)")
        series.append(("here, exciting motion", "^-", COLORS[2], study.exciting[1]))
    for name, style, color, cases in series:
        plot([case for case in cases if not case.objection], style, color, name)
        plot([case for case in cases if case.objection], "x", color)
    axes.plot([], [], "x", color=INK, label="no answer")
    axes.set_yscale("log")
    label_axes(axes, "Error of the mass", "decimals of the data", "relative error")
    axes.set_xticks([case.decimals for case in study.rounded])
    legend_below(axes, 2)


def _draw_convergence(study: PaperStudy, axes: Axes) -> None:
    time = study.telemetry.time
    errors = np.array([parameter_errors(row, study.truth) for row in study.online_parameters])
    parts = {"mass": slice(0, 1), "centre of mass": slice(1, 4), "inertia": slice(4, 10)}
    for (name, columns), color in zip(parts.items(), COLORS):
        worst = np.abs(errors[:, columns]).max(axis=1)
        axes.semilogy(time, worst, drawstyle="steps-pre", color=color, label=name)
    complete = next(n for n, found in enumerate(study.by_count) if found.is_observable)
    label = "fewer than ten parameters determined"
    axes.axvspan(0.0, study.samples.time[complete], color=INK, alpha=0.15, label=label)
    title = "Error from exact samples (integration)"
    label_axes(axes, title, _TIME, "largest relative error")
    legend_below(axes, 2)
