"""A page: one self-contained HTML file, made of sections. Jinja escapes all text of the user."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import jinja2
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs
from plotly.utils import PlotlyJSONEncoder

from cpid_drake.files.drafts import draft_folder, write_text


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
        figures: figures of Plotly; the page sets their width and their colours of text and grid.
        columns: number of figures side by side in a wide window.
        command: a command line.
        inner_page: an HTML page as escaped JSON, which starts when it is seen.
        folded: whether the page shows the heading alone until it is clicked.
        half: whether the section takes half of a wide window, beside another one of that kind.

    """

    title: str
    warnings: Sequence[str] = ()
    texts: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[go.Figure] = ()
    columns: int = 3
    command: str = ""
    inner_page: Markup | None = None
    folded: bool = False
    half: bool = False

    @property
    def anchor(self) -> str:
        """The section's id in the page, for links."""
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
        has_figures = any(section.figures for section in self.sections)
        return environment.get_template("page.html.j2").render(
            report=self,
            data={name: embedded_json(text) for name, text in self.data.items()},
            figure_json=_figure_json,
            plotly=Markup(get_plotlyjs()) if has_figures else "",
        )

    def write(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises:
            InputError: the file cannot be written.

        """
        write_text(path, self.html())

    def write_folder(self, folder: Path) -> None:
        """Write the page and its other files into a folder, all or none.

        Raises:
            InputError: a file cannot be written; those that were there are then unchanged.

        """
        with draft_folder(folder, ["report.html"]) as draft:
            self.write(draft / "report.html")
            for name, text in self.files.items():
                write_text(draft / name, text)


def embedded_json(text: str) -> Markup:
    """Return JSON escaped for a script element: no text in it can end the element."""
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _figure_json(figure: go.Figure) -> Markup:
    """Return data and layout of a figure without its template: the page has its own."""
    content = figure.to_dict()
    content["layout"].pop("template", None)
    return embedded_json(json.dumps(content, cls=PlotlyJSONEncoder))
