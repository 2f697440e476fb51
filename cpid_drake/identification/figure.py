"""The figure of an estimate: each parameter with its interval."""

from math import isfinite, nan
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import plotly.graph_objects as go

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.figures import BAND, COLORS
from cpid_drake.identification.description import origin
from cpid_drake.identification.parameter import ParameterEstimate

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification

HEIGHT = 430
"""Height of the bars of ten parameters [px]."""

_Part = dict[str, Any]

_PITCH = 0.1078  # from one parameter to the next, in heights of the figure

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
    body = result.consistent if result.inconsistencies else None
    nearest = [nan] * 10 if body is None else body.to_vector()
    traces, notes, axes = list[_Part](), list[_Part](), _Part()
    for k, name in enumerate(result.names):
        number, top = "" if k == 0 else str(k + 1), 1 - _PITCH * k
        x, y = f"x{number}", f"y{number}"
        marks = _marks(result[name], {_NEAREST: nearest[k], _TRUE: true[k]})
        traces += [{**mark, "xaxis": x, "yaxis": y} for mark in marks]
        ends = [value for mark in marks for value in mark["x"]]
        scale: _Part = {"visible": False}
        if ends:
            margin = 0.15 * (max(ends) - min(ends)) or 0.1 * abs(ends[0]) or 1.0
            scale = {"range": [min(ends) - margin, max(ends) + margin], "nticks": 5}
        style = {"anchor": y, "tickfont": {"size": 10}, "ticklabelstandoff": -2}
        axes[f"xaxis{number}"] = {**scale, **style}
        hidden = {"range": [-1, 1], "fixedrange": True, "visible": False}
        axes[f"yaxis{number}"] = {**hidden, "anchor": x, "domain": [max(top - 0.03, 0), top]}
        place = {"xref": f"{x} domain", "yref": f"{y} domain", "x": 0, "y": 1}
        text = f"<b>{name}</b>  {result[name].in_words()}"
        corner = {"xanchor": "left", "yanchor": "bottom", "showarrow": False}
        notes.append({"text": text, **place, **corner})
    named = set[str]()
    for trace in traces:  # each kind once in the legend
        trace["showlegend"] = trace["name"] not in named
        named.add(trace["name"])
    layout = {
        "annotations": notes,
        "font": {"size": 12},
        "height": HEIGHT,
        "legend": {"orientation": "h", "x": 0, "y": -0.04, "yanchor": "top"},
        "margin": {"l": 8, "r": 8, "t": 20, "b": 4},
    }
    return go.Figure(traces, {**layout, **axes})


def _marks(estimate: ParameterEstimate, others: dict[str, float]) -> list[_Part]:
    """Return the traces of a parameter, and of other values of it by their names."""
    marks, ends = list[_Part](), [end for end in estimate.interval if isfinite(end)]
    if len(ends) == 2:
        line = {"color": BAND, "width": 9}
        marks.append({"x": ends, "y": [0, 0], "name": _INTERVAL, "mode": "lines", "line": line})
    elif ends:  # one bound: an arrow to the open side
        symbol = "triangle-right" if isfinite(estimate.interval[0]) else "triangle-left"
        marker: _Part = {"color": COLORS[0], "symbol": symbol, "size": 11}
        marks.append({"x": ends, "y": [0], "name": "bound", "mode": "markers", "marker": marker})
    symbols = {_ESTIMATE: "circle", _NEAREST: "diamond-open", _TRUE: "line-ns"}
    colors = {_ESTIMATE: COLORS[0], _NEAREST: COLORS[2], _TRUE: COLORS[1]}
    for name, value in {_ESTIMATE: estimate.value, **others}.items():
        if isfinite(value):
            line = {"width": 3 if name == _TRUE else 1, "color": colors[name]}
            marker = {"color": colors[name], "symbol": symbols[name], "size": 8, "line": line}
            mark = {"x": [value], "y": [0], "name": name, "mode": "markers", "marker": marker}
            marks.append(mark)
    return marks
