"""A report: one self-contained HTML file, made of sections.

Jinja escapes all text of the user. An element with a rounded number has the exact number in its
attribute `data-value`, and the number's path in the page's embedded JSON in `data-key`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from cpid_drake.output_files.drafts import write_text
from cpid_drake.report.pictures import Picture, PictureGroup


@dataclass(frozen=True)
class Cell:
    """A cell of a table: a text, and the exact value that the text shows.

    Attributes:
        text: the text to show.
        value: the exact value; anything that JSON can hold.
        key: path of the value in the embedded JSON, such as `com.0`; None if the JSON does not
            contain it.
        data: name of the embedded JSON text.

    """

    text: str
    value: object = None
    key: str | None = None
    data: str = "result"

    @property
    def exact(self) -> str:
        """`value` as JSON."""
        return json.dumps(self.value, allow_nan=False)


def value_cell(
    value: float, key: str, decimals: int = 0, absent: str = "", data: str = "result"
) -> Cell:
    """Return a cell with a rounded value and its path in the JSON; `absent` if it is not known."""
    if not np.isfinite(value):
        return Cell(absent, None, key, data)
    value = value if isinstance(value, int) else float(value)
    return Cell(f"{round(value, decimals) + 0.0:.{decimals}f}", value, key, data)


@dataclass(frozen=True)
class Table:
    """A table: column heads, rows of cells or texts, a caption above and a note below."""

    heads: Sequence[str]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    note: str = ""

    def is_numeric(self, column: int) -> bool:
        """Return whether a column holds numbers, which are aligned at the right."""
        return any(isinstance(row[column], Cell) for row in self.rows)


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a report. The page shows its contents in the order of the attributes.

    Attributes:
        title: the heading.
        warnings: sentences in a box.
        texts: paragraphs.
        facts: names and values of a list.
        tables: tables with captions and notes.
        pictures_title: the heading of `pictures`.
        pictures: figures to draw into the page.
        groups: further figures, below headings of their own.
        command: a command line.
        inner_page: an HTML page as escaped JSON, which a button opens in the page.

    """

    title: str
    warnings: Sequence[str] = ()
    texts: Sequence[str] = ()
    facts: Sequence[tuple[str, str | Cell]] = ()
    tables: Sequence[Table] = ()
    pictures_title: str = ""
    pictures: Sequence[Picture] = ()
    groups: Sequence[PictureGroup] = ()
    command: str = ""
    inner_page: Markup | None = None

    @property
    def anchor(self) -> str:
        """The section's id in the page, for links."""
        return self.title.lower().replace(" ", "-")


@dataclass(frozen=True)
class Report:
    """A page.

    Attributes:
        title, subtitle: plain text.
        sections: the sections, in the order of the page.
        data: JSON texts to embed, by name.

    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    data: Mapping[str, str] = field(default_factory=dict)

    def html(self) -> str:
        """Return the page as HTML."""
        data = {name: embedded_json(text) for name, text in self.data.items()}
        return _environment().get_template("page.html.j2").render(report=self, data=data)

    def write(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises:
            InputError: the file cannot be written.

        """
        write_text(path, self.html())


def embedded_json(text: str) -> Markup:
    """Return JSON escaped for a script element: no text in it can end the element."""
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cpid_drake.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["svg"] = _svg
    return environment


def _svg(picture: Picture) -> Markup:
    return Markup(picture.svg())
