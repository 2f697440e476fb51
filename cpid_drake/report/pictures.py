"""Figures that are drawn both into pages and into files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cpid_drake.report.style import inline_svg, saved_figure

SMALL = (3.7, 2.3)
"""Width and height of a figure of which a page shows three side by side [in]."""

_WIDE = 5.0  # [in] a page shows no two wider figures side by side


@dataclass(frozen=True)
class Picture:
    """A figure that can be drawn into a page or a file.

    Attributes:
        name: name of its file, and its id in a page: letters, digits and hyphens.
        label: what the figure shows, for screen readers.
        draw: function that draws on the given figure.
        size: width and height [in].

    """

    name: str
    label: str
    draw: Callable[[Figure], None]
    size: tuple[float, float] = SMALL

    @property
    def is_wide(self) -> bool:
        """Whether the figure has the width of a page for itself."""
        return self.size[0] > _WIDE

    def svg(self) -> str:
        """Return the figure as an SVG element for a page."""
        return inline_svg(self.name, self.label, *self.size, self.draw)

    def save(self, folder: Path, ending: str) -> Path:
        """Write the figure to a file whose name ends in `.png` or `.svg`; return the file."""
        path = folder / f"{self.name}.{ending}"
        with saved_figure(path, *self.size) as figure:
            self.draw(figure)
        return path


@dataclass(frozen=True)
class PictureGroup:
    """Pictures below one title: side by side in a page, and one file.

    Attributes:
        title: heading in the page.
        pictures: the pictures, all of the same size.
        columns: number of pictures side by side in the file.

    """

    title: str
    pictures: Sequence[Picture]
    columns: int = 2

    def save(self, path: Path) -> None:
        """Write the pictures to one file, whose name ends in `.png` or `.svg`."""
        whole = together(path.stem, self.pictures, min(self.columns, len(self.pictures)))
        if whole is not None:
            whole.save(path.parent, path.suffix[1:])


def together(name: str, pictures: Sequence[Picture], columns: int) -> Picture | None:
    """Return one picture of several of the same size, in rows of `columns`; None without any."""
    if not pictures:
        return None
    rows = -(-len(pictures) // columns)
    width, height = pictures[0].size

    def draw(figure: Figure) -> None:
        parts = np.ravel(figure.subfigures(rows, columns, squeeze=False))
        for part, picture in zip(parts, pictures):
            picture.draw(part)

    return Picture(name, name, draw, (columns * width, rows * height))
