"""The common style of all figures."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from io import StringIO
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# The palette of Okabe and Ito, which colour-blind readers can distinguish.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

_STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "figure.dpi": 150,
    "figure.facecolor": "white",
    "font.size": 9,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}

_IN_PAGE = {
    "axes.facecolor": "none",
    "axes.labelsize": 8,
    "axes.titlesize": 9,
    "figure.facecolor": "none",
    "svg.fonttype": "none",
}

INK = COLORS[-1]
"""The colour of what belongs to no series."""


def inline_svg(
    name: str, label: str, width: float, height: float, draw: Callable[[Figure], None]
) -> str:
    """Return a drawing as an SVG element for a page.

    Args:
        name: unique in the page; letters, digits and hyphens.
        label: what the drawing shows, for screen readers.
        width, height: size before the page scales it [in].
        draw: function that draws on the given figure.

    """
    text = StringIO()
    with matplotlib.rc_context(_STYLE | _IN_PAGE | {"svg.hashsalt": name}):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure)
        metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(text, format="svg", metadata=metadata, dpi=150)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    # Ids are unique in a drawing only, and the page holds several drawings.
    svg = re.sub(r'\b(id="|href="#|url\(#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r"'DejaVu Sans'[^;\"]*", "system-ui, sans-serif", svg)
    root, rest = svg.split(">", 1)
    root = re.sub(r' (width|height)="[^"]*"', "", root)
    return f'{root} role="img" aria-label="{escape(label)}">{rest}'


@contextmanager
def saved_figure(path: Path, width: float, height: float) -> Iterator[Figure]:
    """Provide a figure in the common style, width by height [in]; save it at the end."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.savefig(path)


def label_axes(axes: Axes, title: str, x: str, y: str) -> None:
    """Set the title and the labels of axes; labels name the units."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.margins(x=0.01)
