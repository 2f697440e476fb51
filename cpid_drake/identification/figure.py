"""The figure of an estimate: each parameter with its interval."""

from functools import partial
from textwrap import fill
from typing import TYPE_CHECKING

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.pictures import COLORS, INK, STYLE, Picture, draw_pictures, label_axes
from cpid_drake.identification.description import origin
from cpid_drake.identification.parameter import ParameterEstimate

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification


def estimate_figure(result: "Identification", truth: InertialParameters | None) -> Figure:
    """Return the figure of an estimate, with the true target if it is known."""
    nothing = np.full(10, np.nan)
    true = nothing if truth is None else truth.to_vector()
    nearest = nothing if result.consistent is None else result.consistent.to_vector()
    pictures = [
        Picture(name, partial(_draw_parameter, result[name], nearest[k], true[k]), size=(2.3, 1.3))
        for k, name in enumerate(PARAMETER_NAMES)
    ]
    failed = [fill(f"Failed check: {failure}", 150) for failure in result.failures]
    with matplotlib.rc_context(STYLE):
        figure = plt.figure(layout="constrained")
        draw_pictures(figure, pictures, 5)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.suptitle("\n".join([*failed, origin(result)]), x=0.01, ha="left", fontsize=9)
    if "inline" in matplotlib.get_backend():
        plt.close(figure)  # a notebook shows what a cell returns, and every open figure again
    return figure


def _draw_parameter(estimate: ParameterEstimate, nearest: float, truth: float, axes: Axes) -> None:
    low, high = estimate.interval
    label_axes(axes, estimate.name, f"[{estimate.unit}]", "")
    axes.set_yticks([])
    axes.set_ylim(-1.0, 1.0)
    if not np.isfinite([low, high, estimate.value, nearest, truth]).any():
        axes.set_xticks([])
    [bar] = axes.plot([low, high], [0, 0], color=COLORS[0], alpha=0.35, label="95 % interval")
    bar.set(linewidth=7, solid_capstyle="butt")
    axes.plot(estimate.value, 0, "o", color=COLORS[0], label="estimate")
    axes.plot(nearest, 0, "D", color=COLORS[2], fillstyle="none", label="nearest rigid body")
    if np.isfinite(truth):
        axes.axvline(truth, color=COLORS[1], linestyle="--", label="true value")
    for bound, end, side in ((low, high, 1), (high, low, -1)):
        if np.isfinite(bound) and not np.isfinite(end):  # one bound: an arrow to the open side
            arrow = {"arrowstyle": "<-", "color": COLORS[0]}
            axes.plot(bound, 0, "|", color=COLORS[0], markersize=12)
            axes.annotate("", (bound, 0), (30 * side, 0), "data", "offset points", arrow)
    if not np.isfinite(estimate.value):
        axes.text(0.5, 0.8, "not identifiable", transform=axes.transAxes, ha="center", color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(3))
    axes.margins(x=0.15)
