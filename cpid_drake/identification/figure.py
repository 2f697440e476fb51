"""Figures of estimates: the intervals of all parameters as bars on one scale.

The scale is that of errors: the mass for m, the radius of gyration for c, the trace of I for I.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS, parameter_scale
from cpid_drake.files.figures import COLORS
from cpid_drake.identification.description import origin
from cpid_drake.identification.parameter import ParameterEstimate

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification

SCALE = "from the estimate, % of m, radius of gyration, tr I"
"""What the axis of the bars shows; of several results, it begins at the first one's estimate."""

_Part = dict[str, Any]

_WORDS, _SPACE = 19, 4  # heights of a parameter's words, and of the space below its bars [px]

_BAR, _COMPARED_BAR = 13, 20  # heights of a bar, and of one of several [px]

_BELOW = 66  # height of the numbers of the axis, its title and the legend [px]

_PARTS = (slice(0, 1), slice(1, 4), slice(4, 10))  # m, c and I

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
    top = 30 + 16 * len(lines)
    return figure.update_layout(title=title, margin_t=top, height=figure.layout.height + top)


def parameter_bars(result: "Identification", truth: InertialParameters | None) -> go.Figure:
    """Return ten axes under each other: a parameter in words, and its interval as a bar."""
    others = dict[str, Array]()
    if result.inconsistencies and result.consistent is not None:
        others[_NEAREST] = result.consistent.to_vector()
    if truth is not None:
        others[_TRUE] = truth.to_vector()
    words = [result[name].in_words() for name in PARAMETER_NAMES]
    return _figure({_INTERVAL: result}, words, others)


def compared_bars(results: Mapping[str, "Identification"], words: Sequence[str]) -> go.Figure:
    """Return ten axes under each other: a parameter with words, and the bars of all results."""
    return _figure(results, words, {})


def _figure(
    results: Mapping[str, "Identification"], words: Sequence[str], others: Mapping[str, Array]
) -> go.Figure:
    """Return the bars of results, and of the first one other values of the parameters."""
    scale, count = _scale(list(results.values())), len(results)
    bars = count * (_BAR if count == 1 else _COMPARED_BAR)
    pitch = _WORDS + bars + _SPACE
    traces, notes, axes, ends = list[_Part](), list[_Part](), _Part(), list[float]()
    for k, (name, text) in enumerate(zip(PARAMETER_NAMES, words, strict=True)):
        number, top = "" if k == 0 else str(k + 1), 1 - (k * pitch + _WORDS) / (10 * pitch)
        x, y = f"x{number}", f"y{number}"
        estimates = {label: result[name] for label, result in results.items()}
        zero = _zero(estimates.values())
        for row, (label, estimate) in enumerate(estimates.items()):
            marks = _marks(estimate, label, row, is_alone=count == 1)
            if row == 0:
                marks += [_point(each, float(value[k]), 0) for each, value in others.items()]
            for mark in marks:
                unit = f" {PARAMETER_UNITS[k]}<extra>{name}, {mark['name']}</extra>"
                mark["hovertemplate"] = "%{customdata:.6g}" + unit
                mark["customdata"], mark["x"] = mark["x"], 100 * (mark["x"] - zero) / scale[k]
                traces.append({**mark, "y": np.full(len(mark["x"]), -row), "xaxis": x, "yaxis": y})
                if estimate.is_identifiable:
                    ends += list(mark["x"])
        # Plotly draws no axis, and no words at it, without a trace.
        nothing = {"x": [0.0], "y": [0.0], "mode": "none", "name": "", "hoverinfo": "skip"}
        traces.append({**nothing, "xaxis": x, "yaxis": y})
        axes[f"xaxis{number}"] = {"anchor": y, "showticklabels": k == 9, "matches": "x"}
        height = {"domain": [max(top - bars / (10 * pitch), 0), top]}
        axes[f"yaxis{number}"] = {**_HIDDEN, **height, "range": [0.5 - count, 0.5], "anchor": x}
        corner = {"xanchor": "left", "yanchor": "bottom", "showarrow": False, "x": 0, "y": 1}
        place = {"xref": f"{x} domain", "yref": f"{y} domain"}
        notes.append({"text": f"<b>{name}</b>  {text}", **corner, **place})
    # What is not identifiable may be far wider: its bars leave the axes.
    ends = ends or [value for trace in traces for value in trace["x"]]
    margin = 0.05 * (max(ends) - min(ends)) or 1.0
    axes["xaxis"]["range"] = [min(ends) - margin, max(ends) + margin]
    axes["xaxis10"] |= {
        "title": {"text": SCALE, "standoff": 4, "font": {"size": 11}},
        "tickfont": {"size": 10},
    }
    named = {""}
    for trace in traces:  # each kind once in the legend
        trace["showlegend"] = trace["name"] not in named
        named.add(trace["name"])
    layout = {
        "annotations": notes,
        "font": {"size": 12},
        "height": 10 * pitch + _BELOW,
        "legend": {"orientation": "h", "x": 0, "y": -0.105 * 36 / pitch, "yanchor": "top"},
        "margin": {"l": 8, "r": 8, "t": 4, "b": _BELOW},
    }
    return go.Figure(traces, {**layout, **axes})


_HIDDEN = {"fixedrange": True, "visible": False}


def _scale(results: Sequence["Identification"]) -> Array:
    """Return the scale (10,) of errors, by the first rigid body that is known."""
    bodies = [each.consistent.to_vector() for each in results if each.consistent is not None]
    for body in bodies:
        if np.isfinite(body).all() and body[0] > 0 and body[4:7].sum() > 0:
            return parameter_scale(body)
    scale = np.ones(10)  # by the largest bounds of its kind
    for part in _PARTS:
        bounds = np.concatenate([np.abs(each.shown_intervals[part].ravel()) for each in results])
        if (bounds > 0).any():
            scale[part] = np.nanmax(bounds)
    return scale


def _zero(estimates: Iterable[ParameterEstimate]) -> float:
    """Return the first estimate; without one the middle of the first bounds."""
    for each in estimates:
        ends = [end for end in each.interval if isfinite(end)]
        if each.is_identifiable or ends:
            return each.value if each.is_identifiable else sum(ends) / len(ends)
    return 0.0


def _marks(estimate: ParameterEstimate, label: str, row: int, *, is_alone: bool) -> list[_Part]:
    """Return the traces of an interval, or of its one bound, and of the estimate."""
    color, marks = COLORS[row % len(COLORS)], list[_Part]()
    ends = [end for end in estimate.interval if isfinite(end)]
    if len(ends) == 2:
        line = {"color": color, "width": 9}
        marks.append({"mode": "lines", "name": label, "line": line, "opacity": 0.5})
    elif ends:  # one bound: an arrow to the open side
        symbol = "triangle-right" if isfinite(estimate.interval[0]) else "triangle-left"
        marker: _Part = {"color": color, "symbol": symbol, "size": 11}
        name = "bound" if is_alone else label
        marks.append({"mode": "markers", "name": name, "marker": marker})
    for mark in marks:
        mark["x"] = np.array(ends)
    if estimate.is_identifiable:
        marks.append(_point(_ESTIMATE if is_alone else label, estimate.value, row))
    return marks


def _point(name: str, value: float, row: int) -> _Part:
    """Return the trace of one value."""
    others = {_NEAREST: ("diamond-open", 2), _TRUE: ("line-ns", 1)}
    symbol, number = others.get(name, ("circle", row))
    color = COLORS[number % len(COLORS)]
    line = {"width": 3 if name == _TRUE else 1, "color": color}
    marker = {"color": color, "symbol": symbol, "size": 7, "line": line}
    return {"x": np.array([value]), "name": name, "mode": "markers", "marker": marker}
