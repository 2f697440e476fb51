"""What is shown on a terminal: tables of a page, and what is renewed."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table as Drawn

from cpid_drake.report.page import Report, Table


def print_tables(page: Report) -> None:
    """Print the tables of a page."""
    for table in (each for section in page.sections for each in section.tables):
        print_table(table)


def print_table(table: Table) -> None:
    """Print a table and its note; a row that is wider than the terminal is not broken."""
    console = Console(markup=False, highlight=False)
    drawn = Drawn(title=table.caption, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    drawn.padding, drawn.pad_edge = (0, 1, 0, 0), False
    for k, head in enumerate(table.heads):
        drawn.add_column(head, justify="right" if k else "left", no_wrap=True)
    for row in table.rows:
        drawn.add_row(*row)
    width, wide = console.width, console.options.update(width=10_000)
    console.width = max(console.measure(drawn, options=wide).maximum, width)
    console.print(drawn, soft_wrap=True)
    console.width = width
    if table.note:
        console.print(table.note)


@contextmanager
def shown_live(console: Console) -> Iterator[Live]:
    """Provide what is shown on a console and renewed; its last line ends in files, too."""
    with Live(console=console, refresh_per_second=8) as screen:
        yield screen
    if not console.is_terminal:  # where Rich prints the last state without its end
        console.print()
