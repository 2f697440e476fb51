"""Tables of a page on the terminal."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as Drawn

from cpid_drake.report.page import Table


def print_table(console: Console, table: Table) -> None:
    """Print a table and its note; a row that is wider than the terminal is not broken."""
    drawn = Drawn(title=table.caption, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    drawn.padding, drawn.pad_edge = (0, 1, 0, 0), False
    for k, head in enumerate(table.heads):
        drawn.add_column(head, justify="right" if k else "left", no_wrap=True)
    for row in table.rows:
        drawn.add_row(*row)
    width = console.width
    needed = Measurement.get(console, console.options.update(width=10_000), drawn).maximum
    console.width = max(needed, width)
    console.print(drawn, soft_wrap=True)
    console.width = width
    if table.note:
        console.print(table.note, highlight=False)
