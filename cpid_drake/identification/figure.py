"""The figure of an estimate: each parameter with its interval."""

from math import isfinite, nan
from textwrap import wrap
from typing import TYPE_CHECKING

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.figures import BAND, COLORS
from cpid_drake.identification.description import origin
from cpid_drake.identification.parameter import ParameterEstimate

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification

HEIGHT = 430
"""Height of the bars of ten parameters [px]."""

_INTERVAL, _ESTIMATE, _NEAREST, _TRUE = (
    *("95 % interval", "estimate", "nearest rigid body", "true value"),
)


def estimate_figure(result: "Identification", truth: InertialParameters | None) -> go.Figure:
    """Return the figure of an estimate with its origin, and the true target if it is known."""
    figure = parameter_bars(result, truth)
    lines = wrap(origin(result), 100)
    for failure in result.failures:
        lines += wrap(f"Failed check: {failure}", 100)
    title = {"text": "<br>".join(lines), "font": {"size": 12}, "x": 0, "xref": "paper"}
    top = 50 + 16 * len(lines)
    return figure.update_layout(title=title, margin_t=top, height=HEIGHT + top)


def parameter_bars(result: "Identification", truth: InertialParameters | None) -> go.Figure:
    """Return ten axes under each other: a parameter in words, and its interval as a bar."""
    true = [nan] * 10 if truth is None else truth.to_vector()
    has_body = bool(result.inconsistencies) and result.consistent is not None
    nearest = result.consistent.to_vector() if has_body and result.consistent else [nan] * 10
    figure = make_subplots(rows=10, cols=1, vertical_spacing=0.078)
    for k, name in enumerate(result.names):
        _add_parameter(figure, k + 1, result[name], {_NEAREST: nearest[k], _TRUE: true[k]})
    named = set[str]()
    for trace in figure.data:  # each kind once in the legend
        trace.showlegend = trace.name not in named
        named.add(trace.name)
    figure.update_yaxes(range=[-1, 1], fixedrange=True, visible=False)
    figure.update_xaxes(nticks=5, tickfont={"size": 10}, ticklabelstandoff=-2)
    legend = {"orientation": "h", "x": 0, "y": -0.04, "yanchor": "top"}
    margin = {"l": 8, "r": 8, "t": 20, "b": 4}
    return figure.update_layout(legend=legend, margin=margin, height=HEIGHT, font_size=12)


def _add_parameter(
    figure: go.Figure, row: int, estimate: ParameterEstimate, others: dict[str, float]
) -> None:
    """Add a parameter, and other values of it by their names, to a row of a figure."""
    ends = [end for end in estimate.interval if isfinite(end)]
    if len(ends) == 2:
        line = {"color": BAND, "width": 9}
        figure.add_scatter(
            x=ends, y=[0, 0], name=_INTERVAL, mode="lines", line=line, row=row, col=1
        )
    elif ends:  # one bound: an arrow to the open side
        symbol = "triangle-right" if isfinite(estimate.interval[0]) else "triangle-left"
        marker = {"color": COLORS[0], "symbol": symbol, "size": 11}
        figure.add_scatter(
            x=ends, y=[0], name="bound", mode="markers", marker=marker, row=row, col=1
        )
    symbols = {_ESTIMATE: "circle", _NEAREST: "diamond-open", _TRUE: "line-ns"}
    colors = {_ESTIMATE: COLORS[0], _NEAREST: COLORS[2], _TRUE: COLORS[1]}
    for name, value in {_ESTIMATE: estimate.value, **others}.items():
        if isfinite(value):
            line = {"width": 3 if name == _TRUE else 1, "color": colors[name]}
            marker = {"color": colors[name], "symbol": symbols[name], "size": 8, "line": line}
            figure.add_scatter(x=[value], y=[0], name=name, mode="markers", marker=marker)
            figure.data[-1].update(xaxis=f"x{row}", yaxis=f"y{row}")
    values = [value for value in (*ends, estimate.value, *others.values()) if isfinite(value)]
    if values:
        margin = 0.15 * (max(values) - min(values)) or 0.1 * abs(values[0]) or 1.0
        figure.update_xaxes(range=[min(values) - margin, max(values) + margin], row=row, col=1)
    else:
        figure.update_xaxes(visible=False, row=row, col=1)
    number = "" if row == 1 else str(row)
    figure.add_annotation(
        text=f"<b>{estimate.name}</b>  {estimate.in_words()}",
        xref=f"x{number} domain",
        yref=f"y{number} domain",
        x=0,
        y=1,
        yanchor="bottom",
        xanchor="left",
        showarrow=False,
    )
