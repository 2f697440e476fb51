"""A report: one HTML file that needs nothing else, made of sections.

User text is escaped by Jinja. Every number that is rounded for the reader carries the exact one as
it is in the JSON that the page holds: `data-value`, and `data-key` where it is found there.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import jinja2
from markupsafe import Markup

from cpid_drake.errors import InputError
from cpid_drake.report.figures import Picture


class Section:
    """A part of a report: a title and a template, which sees the section as `section`."""

    title: ClassVar[str]
    template: ClassVar[str]

    @property
    def anchor(self) -> str:
        """Its name in links."""
        return self.title.lower().replace(" ", "-")

    def render(self) -> Markup:
        """Return the section as HTML, without its title."""
        return Markup(_environment().get_template(self.template).render(section=self))


@dataclass(frozen=True)
class Report:
    """A page.

    Attributes:
        title, subtitle: what it is about.
        sections: in their order.
        data: JSON texts that the page holds, by name.

    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    data: Mapping[str, str] = field(default_factory=dict)

    def html(self) -> str:
        """Return the page."""
        data = {name: embedded_json(text) for name, text in self.data.items()}
        return _environment().get_template("page.html.j2").render(report=self, data=data)

    def write(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises:
            InputError: the file cannot be written.

        """
        text = self.html()
        try:
            Path(path).write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{path}: cannot write there: {error.strerror}") from error


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, and the exact value with where it is found.

    Attributes:
        text: what is shown.
        value: what the JSON has there; anything that JSON can hold.
        key: path in the JSON, such as `com.0`; None for what is not from there.
        data: name of the JSON text.

    """

    text: str
    value: Any = None
    key: str | None = None
    data: str = "result"

    @property
    def exact(self) -> str:
        """The value as JSON."""
        return json.dumps(self.value, allow_nan=False)


@dataclass(frozen=True)
class Table:
    """A table: heads, and rows of cells or texts."""

    heads: Sequence[str]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""

    def is_numeric(self, column: int) -> bool:
        """Whether there are numbers in a column, which stand at the right."""
        return any(isinstance(row[column], Cell) for row in self.rows)


def embedded_json(text: str) -> Markup:
    """Return JSON so that it can stand in a script element: nothing in it ends the element."""
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
    environment.filters |= {"svg": _svg, "png": _png}
    return environment


def _svg(picture: Picture) -> Markup:
    return Markup(picture.svg())


def _png(path: Path) -> Markup:
    data = base64.b64encode(path.read_bytes()).decode()
    return Markup(f"data:image/png;base64,{data}")
