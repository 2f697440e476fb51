"""Figures of an identification."""

import numpy as np
import plotly.graph_objects as go
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.figures import BAND, COLORS, curves, new_figure
from cpid_drake.identification.result import History
from cpid_drake.logs.log import Log


def convergence_figures(
    estimates: History, truth: InertialParameters | None = None
) -> list[go.Figure]:
    """Return a figure for each parameter: its estimates over time, with 95 % intervals."""
    true = np.full(10, np.nan) if truth is None else truth.to_vector()
    return [_parameter_figure(estimates, float(true[i]), i) for i in range(10)]


def singular_value_figure(values: Array) -> go.Figure:
    """Return the figure of ten singular values."""
    figure = new_figure("Singular values", "number", "scaled value")
    number = np.arange(1, len(values) + 1)
    figure.add_bar(x=number, y=values, marker={"color": COLORS[0]}, width=0.15)
    figure.update_xaxes(dtick=1)
    figure.update_yaxes(type="log" if (values > 0).all() else "linear", exponentformat="power")
    return figure


def motion_figures(log: Log) -> list[go.Figure]:
    """Return a figure for each sensor of the base's motion that the log has."""
    shown = []
    if len(log.attitude):
        attitude = Rotation.from_quat(log.attitude.value, scalar_first=True)
        turned = (attitude[0].inv() * attitude).as_rotvec(degrees=True)
        shown.append(("Base rotation", log.attitude.time, turned, "rotation vector [deg]"))
    if len(log.gyro):
        rate = np.degrees(log.gyro.value)
        shown.append(("Base angular velocity", log.gyro.time, rate, "in B [deg/s]"))
    if len(log.position):
        moved = log.position.value - log.position.value[0]
        shown.append(("Base displacement", log.position.time, moved, "in W [m]"))
    if len(log.velocity):
        shown.append(("Base velocity", log.velocity.time, log.velocity.value, "in W [m/s]"))
    return [curves(*each) for each in shown]


def _parameter_figure(estimates: History, true: float, i: int) -> go.Figure:
    """Return the estimates of parameter i over time."""
    time = np.array([time for time, _ in estimates])
    value = np.array([estimate.parameters[i] for _, estimate in estimates])
    bands = np.array([estimate.intervals[i] for _, estimate in estimates])
    figure = new_figure(f"{PARAMETER_NAMES[i]} [{PARAMETER_UNITS[i]}]", height=138)
    figure.update_layout(showlegend=False, margin={"l": 4, "r": 4, "t": 26, "b": 4})
    is_known = np.isfinite(value)
    if not is_known.any():
        figure.add_annotation(text="not identifiable", x=0.5, y=0.5, showarrow=False)
        figure.update_xaxes(visible=False, range=[0, 1])
        figure.update_yaxes(visible=False, range=[0, 1])
        return figure
    # An area of one outline has no edge where nothing is known.
    edge = np.concatenate([bands[is_known, 0], bands[is_known, 1][::-1]])
    around = np.concatenate([time[is_known], time[is_known][::-1]])
    figure.add_scatter(
        x=around,
        y=edge,
        mode="lines",
        fill="toself",
        fillcolor=BAND,
        line={"width": 0},
        hoverinfo="skip",
    )
    figure.add_scatter(
        x=time,
        y=value,
        error_y={
            "array": bands[:, 1] - value,
            "arrayminus": value - bands[:, 0],
            "thickness": 0,
            "width": 0,
        },
        mode="lines+markers",
        line={"color": COLORS[0], "width": 1.5},
        marker={"size": 4},
        name=PARAMETER_NAMES[i],
    )
    if np.isfinite(true):
        figure.add_hline(true, line={"color": COLORS[1], "dash": "dash", "width": 1.5})
    # The limits show the later estimates: the first intervals are too wide.
    places = np.flatnonzero(is_known)
    late = places[len(places) // 3 :]
    shown = np.concatenate([value[late], bands[late].ravel(), [true]])
    low, high = np.nanmin(shown), np.nanmax(shown)
    margin = 0.08 * (high - low) or 1e-3 * max(abs(high), 1e-9)
    figure.update_yaxes(range=[low - margin, high + margin], nticks=5)
    figure.update_xaxes(range=[min(0.0, time[0]), time[-1]], nticks=5)
    return figure
