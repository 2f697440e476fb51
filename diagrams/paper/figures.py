"""The figures of the paper's study."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from cpid_drake.files.pictures import COLORS, INK, Picture, curves, label_axes, legend_below
from cpid_drake.report.page import Section
from paper.rounding import RoundedCase
from paper.scene import render_scenario
from paper.study import PaperStudy
from paper.values import PAPER_TABLE_2

_CURVES = 6  # in one panel: more colours than that are hard to tell apart


def sections(study: PaperStudy) -> list[Section]:
    """Return the sections with the study's figures."""
    t, angles = study.telemetry, np.degrees(study.telemetry.euler_321)
    turns = ("yaw", "pitch", "roll")
    attitude = 1e3 * np.degrees(np.abs(study.attitude_error))
    position = 1e6 * np.abs(study.position_error)
    pictures = {
        "Mass against decimals (Table 2)": [
            Picture("Error of the mass", partial(_draw_decimals, study))
        ],
        "Configurations (Fig. 3)": _configurations(study),
        "Joint motion (Fig. 5)": _joint_motion(study),
        "Motion of the base (Fig. 6)": [
            curves("(A) Position of the base", t.time, t.p_WB - t.p_WB[0], "p_WB [m]"),
            curves("(B) Velocity of the base", t.time, t.v_WB, "v_WB [m/s]"),
            curves("(C) Attitude, 3-2-1", t.time, angles, "angle [deg]", turns),
            curves("(D) Angular velocity", t.time, np.degrees(t.w_WB), "w_WB [deg/s]"),
        ],
        "Errors after re-simulation (Fig. 7)": [
            curves("(A) Attitude error", t.time, attitude, "|error| [mdeg]", turns),
            curves("(B) Position error", t.time, position, "|error| [µm]"),
        ],
    }
    return [Section(title, pictures=each) for title, each in pictures.items()]


def _configurations(study: PaperStudy) -> list[Picture]:
    """Return pictures of the spacecraft and its target at the start and at the end."""
    states = study.simulation.spacecraft.to_states(study.telemetry.select([0, -1]))
    images = render_scenario(study.simulation.scenario, list(states))
    pictures = []
    for name, time, image in zip("AB", study.telemetry.time[[0, -1]], images, strict=True):
        title = f"({name}) Configuration at {time:g} s"
        pictures.append(Picture(title, partial(_draw_image, image, title), (4.6, 3.5)))
    return pictures


def _joint_motion(study: PaperStudy) -> list[Picture]:
    """Return positions and rates of the joints that move, six joints in a picture."""
    telemetry, names = study.telemetry, study.simulation.spacecraft.joint_names
    moving = np.flatnonzero(np.ptp(telemetry.q, axis=0) > 1e-6)
    parts = np.array_split(moving, max(1, -(-len(moving) // _CURVES)))
    return [
        curves(
            f"Joint {what}",
            telemetry.time,
            np.degrees(values[:, part]),
            unit,
            [names[joint].replace("_", " ") for joint in part],
            size=(3.7, 3.2),
        )
        for what, values, unit in (
            ("angles", telemetry.q, "angle [deg]"),
            ("rates", telemetry.qdot, "rate [deg/s]"),
        )
        for part in parts
    ]


def _draw_image(image: NDArray[np.uint8], title: str, axes: Axes) -> None:
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(title)


def _draw_decimals(study: PaperStudy, axes: Axes) -> None:
    def relative(masses: Sequence[float]) -> NDArray[np.float64]:
        return np.abs(np.array(masses) / study.truth.mass - 1)

    def plot(cases: Sequence[RoundedCase], style: str, color: str, label: str = "") -> None:
        masses = relative([case.mass for case in cases])
        decimals = [case.decimals for case in cases]
        axes.plot(decimals, masses, style, color=color, label=label or None)

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
