"""Figures of Plotly in one style; a page adds the colours of its light or dark mode."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from cpid_drake.array import Array

# The palette of Okabe and Ito, which colour-blind readers can distinguish.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

INK = "#7f7f7f"
"""The colour of what belongs to no series, on light and on dark pages."""

BAND = "rgba(0, 114, 178, 0.35)"
"""The first colour for areas."""

LEGEND_BELOW = {"orientation": "h", "x": 0, "y": -0.22, "yanchor": "top"}
"""The place of a legend below the axes."""

_DASHES = ("solid", "dash", "dot", "dashdot")
_MOST_POINTS = 1500  # of a line


def new_figure(title: str, x: str = "", y: str = "", *, height: int = 270) -> go.Figure:
    """Return an empty figure; the labels of its axes name the units.

    Args:
        title: heading, also for screen readers.
        x: label of the horizontal axis.
        y: label of the vertical axis.
        height: of the figure [px]; its width is that of its place in the page.

    """
    layout: dict[str, Any] = {
        "title": {"text": title, "font": {"size": 13}, "x": 0.01, "y": 0.98, "yanchor": "top"},
        "xaxis": {"title": {"text": x, "standoff": 6}},
        "yaxis": {"title": {"text": y, "standoff": 6}},
        "font": {"size": 11},
        "height": height,
        "legend": LEGEND_BELOW,
        "margin": {"l": 8, "r": 8, "t": 30, "b": 8},
    }
    return go.Figure(layout=layout)


def curves(
    title: str,
    time: Array,
    values: Array,
    unit: str,
    labels: Sequence[str] = "xyz",
    *,
    points: bool = False,
    height: int = 270,
) -> go.Figure:
    """Return a figure of values (N, K) over time (N,) [s], as points or as lines.

    Of many samples, the figure shows an even selection.
    """
    figure = new_figure(title, "time [s]", unit, height=height)
    step = slice(None, None, -(-len(time) // _MOST_POINTS) or 1)
    for k, label in enumerate(labels):
        # Colours repeat after six curves; of two that coincide, both are seen.
        number = k // 6 if len(labels) > 6 else k % 2
        style: dict[str, Any] = {
            "mode": "lines",
            "line": {"color": COLORS[k % 6], "dash": _DASHES[number % 4], "width": 1.5},
        }
        if points:
            marker = {"color": COLORS[k % 6], "size": 3, "opacity": 0.5}
            style = {"mode": "markers", "marker": marker}
        figure.add_scatter(x=time[step], y=values[step, k].astype(np.float32), name=label, **style)
    return figure
