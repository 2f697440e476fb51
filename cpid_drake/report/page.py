"""A page: one self-contained HTML file, made of sections. Jinja escapes all text of the user."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import jinja2
from markupsafe import Markup

from cpid_drake.files.drafts import draft_folder, write_text
from cpid_drake.files.pictures import Picture, save_pictures


@dataclass(frozen=True)
class Table:
    """A table for pages and for the terminal: heads, rows, a caption above and a note below.

    The first column has the names of the rows.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    note: str = ""

    def csv(self) -> str:
        """Return heads and rows as CSV."""
        text = StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.heads, *self.rows])
        return text.getvalue()


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a report. The page shows its contents in the order of the attributes.

    Attributes:
        title: the heading.
        warnings: sentences in a box.
        texts: paragraphs.
        facts: names and values of a list.
        tables: tables with captions and notes.
        pictures: figures.
        command: a command line.
        inner_page: an HTML page as escaped JSON, which a button opens in the page.

    """

    title: str
    warnings: Sequence[str] = ()
    texts: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    command: str = ""
    inner_page: Markup | None = None

    @property
    def anchor(self) -> str:
        """The section's id in the page, for links, and the name of its figures' file."""
        return re.sub("[^a-z0-9]+", "-", self.title.lower()).strip("-")


@dataclass(frozen=True)
class Report:
    """A page.

    Attributes:
        title, subtitle: plain text.
        sections: the sections, in the order of the page.
        data: JSON texts to embed, by name.
        files: texts of other files in the report's folder, by name.

    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    data: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    def html(self) -> str:
        """Return the page as HTML."""
        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("cpid_drake.report"),
            autoescape=True,
            trim_blocks=True,
            lstrip_blocks=True,
            undefined=jinja2.StrictUndefined,
        )
        data = {name: embedded_json(text) for name, text in self.data.items()}
        return environment.get_template("page.html.j2").render(report=self, data=data)

    def save_figures(self, folder: Path) -> None:
        """Write the figures of every section into an existing folder, as PNG and as SVG."""
        for section in self.sections:
            for ending in ("png", "svg") if section.pictures else ():
                file = folder / f"{section.anchor}.{ending}"
                save_pictures(file, ending, section.pictures, 2)

    def write(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises:
            InputError: the file cannot be written.

        """
        write_text(path, self.html())

    def write_folder(self, folder: Path) -> None:
        """Write the page, its figures and its other files into a folder, all or none.

        Raises:
            InputError: a file cannot be written; those that were there are then unchanged.

        """
        with draft_folder(folder, ["report.html"]) as draft:
            self.save_figures(draft)
            self.write(draft / "report.html")
            for name, text in self.files.items():
                write_text(draft / name, text)


def embedded_json(text: str) -> Markup:
    """Return JSON escaped for a script element: no text in it can end the element."""
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
