"""Figures in one style, for pages as SVG and for files."""

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cpid_drake.array import Array

# The palette of Okabe and Ito, which colour-blind readers can distinguish.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

INK = COLORS[-1]
"""The colour of what belongs to no series."""

SMALL = (3.7, 2.7)
"""Width and height of a figure of which a page shows three side by side [in]."""

WIDE = (8.0, 3.4)
"""Width and height of a figure that has the width of a page for itself [in]."""

_MOST_POINTS = 1500  # of a line in a page; a line of more points becomes an image, which is smaller

STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#555555",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelsize": 8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.xmargin": 0.01,
    "figure.dpi": 150,
    "font.size": 8,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "cpid",
}


@dataclass(frozen=True)
class Picture:
    """A figure with one pair of axes.

    Attributes:
        label: what the figure shows, for screen readers.
        draw: function that draws on the given axes.
        size: width and height [in].

    """

    label: str
    draw: Callable[[Axes], object]
    size: tuple[float, float] = SMALL

    def html(self) -> Markup:
        """Return the figure as an image element of a page."""
        file = BytesIO()
        save_pictures(file, "svg", [self])
        data = b64encode(file.getvalue()).decode()
        return Markup('<img alt="{}" src="data:image/svg+xml;base64,{}">').format(self.label, data)


def label_axes(axes: Axes, title: str, x: str, y: str) -> None:
    """Set the title and the labels of axes; labels name the units."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def legend_below(axes: Axes, columns: int = 4) -> None:
    """Put the legend below the axes."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)


def curves(
    title: str,
    time: Array,
    values: Array,
    unit: str,
    labels: Sequence[str] = "xyz",
    *,
    line: str = "-",
    size: tuple[float, float] = SMALL,
) -> Picture:
    """Return a picture of values (N, K) over time (N,); "." as the line draws points only."""

    def draw(axes: Axes) -> None:
        for k, label in enumerate(labels):
            # Colours repeat after six curves; of two that coincide, both are seen.
            number = k // 6 if len(labels) > 6 else k % 2
            style = ("-", "--", ":", "-.")[number % 4] if line == "-" else line
            many = len(time) > _MOST_POINTS or line == "."
            axes.plot(
                time, values[:, k], style, color=COLORS[k % 6], label=label, ms=3, rasterized=many
            )
        label_axes(axes, title, "time [s]", unit)
        legend_below(axes, 4 if max(map(len, labels)) < 8 else 2)

    return Picture(f"{title} over time", draw, size)


def save_pictures(
    file: Path | BytesIO, ending: str, pictures: Sequence[Picture], columns: int = 1
) -> None:
    """Write pictures of one size into one file, PNG or SVG, in rows of this many columns."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(layout="constrained")
        draw_pictures(figure, pictures, columns)
        figure.savefig(file, format=ending, metadata={"Date": None} if ending == "svg" else None)


def draw_pictures(figure: Figure, pictures: Sequence[Picture], columns: int = 1) -> None:
    """Draw pictures of one size into an empty figure, in rows of this many columns."""
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    width, height = pictures[0].size
    figure.set_size_inches(columns * width, rows * height)
    places = np.ravel(figure.subplots(rows, columns))
    for axes, picture in zip(places, pictures):
        picture.draw(axes)
    for axes in places[len(pictures) :]:
        axes.set_axis_off()
