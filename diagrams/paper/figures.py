"""The figures of the paper's study."""

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from cpid_drake.files.figures import COLORS, curves, new_figure
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
    figures = {
        "Mass against decimals (Table 2)": [_decimals(study)],
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
    columns = {1: 1, 2: 2, 4: 2}
    return [
        Section(title, figures=each, columns=columns.get(len(each), 3))
        for title, each in figures.items()
    ]


def _configurations(study: PaperStudy) -> list[go.Figure]:
    """Return images of the spacecraft and its target at the start and at the end."""
    states = study.simulation.spacecraft.to_states(study.telemetry.select([0, -1]))
    images = render_scenario(study.simulation.scenario, list(states))
    figures = []
    for name, time, image in zip("AB", study.telemetry.time[[0, -1]], images, strict=True):
        figure = new_figure(f"({name}) Configuration at {time:g} s", height=400)
        source = f"data:image/png;base64,{b64encode(image).decode()}"
        place = {"x": 0, "y": 1, "sizex": 1, "sizey": 1, "xref": "paper", "yref": "paper"}
        figure.add_layout_image(source=source, **place)
        figures.append(figure.update_xaxes(visible=False).update_yaxes(visible=False))
    return figures


def _joint_motion(study: PaperStudy) -> list[go.Figure]:
    """Return positions and rates of the joints that move, six joints in a figure."""
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
            height=320,
        )
        for what, values, unit in (
            ("angles", telemetry.q, "angle [deg]"),
            ("rates", telemetry.qdot, "rate [deg/s]"),
        )
        for part in parts
    ]


def _decimals(study: PaperStudy) -> go.Figure:
    """Return the figure of the error of the mass against the decimals of the data."""
    figure = new_figure("Error of the mass", "decimals of the data", "relative error", height=400)

    def add(name: str, decimals: Sequence[int], masses: Sequence[float], **style: Any) -> None:
        error = np.abs(np.array(masses) / study.truth.mass - 1)
        figure.add_scatter(x=decimals, y=error, name=name, **style)

    def add_cases(name: str, cases: Sequence[RoundedCase], color: str, symbol: str) -> None:
        answered = [case for case in cases if not case.objection]
        others = [case for case in cases if case.objection]
        masses = [case.mass for case in answered]
        style = {"line": {"color": color}, "marker": {"symbol": symbol, "size": 7}}
        add(name, [case.decimals for case in answered], masses, mode="lines+markers", **style)
        masses = [case.mass for case in others]
        style = {"marker": {"symbol": "x-thin-open", "size": 8, "color": color}}
        label = f"{name}: no answer"
        add(label, [case.decimals for case in others], masses, mode="markers", **style)

    add_cases("here, motion of Fig. 5", study.rounded, COLORS[0], "circle")
    if study.exciting:
        style = {"line": {"color": COLORS[1], "dash": "dash"}, "marker": {"symbol": "square"}}
        theirs = [*PAPER_TABLE_2.values()]
        add("paper (printed)", [*PAPER_TABLE_2], theirs, mode="lines+markers", **style)
        add_cases("here, exciting motion", study.exciting[1], COLORS[2], "triangle-up")
    figure.update_xaxes(tickvals=[case.decimals for case in study.rounded])
    return figure.update_yaxes(type="log", exponentformat="power")
