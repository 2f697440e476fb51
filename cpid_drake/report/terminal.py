"""Tables of a page on the terminal."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as Drawn

from cpid_drake.report.page import Cell, Table

_WIDEST = 10_000


def print_table(console: Console, table: Table) -> None:
    """Print a table and its note; the columns are split into tables where the terminal is narrow.

    The first column is in each of them. No number is cut or wrapped.
    """
    wide = console.options.update(width=_WIDEST)
    first, rest = 0, 1
    while rest < len(table.heads):
        end = rest + 1
        while (
            end < len(table.heads)
            and Measurement.get(console, wide, _drawn(table, rest, end + 1)).maximum
            <= console.width
        ):
            end += 1
        part = _drawn(table, rest, end)
        part.title = table.caption if first == 0 else None
        console.print(part)
        first, rest = rest, end
    if table.note:
        console.print(table.note, highlight=False)


def _drawn(table: Table, start: int, end: int) -> Drawn:
    """Return the first column and those from `start` to `end`."""
    drawn = Drawn(
        title_justify="left",
        title_style="bold",
        header_style="bold",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    drawn.add_column(table.heads[0], no_wrap=True)
    for head in table.heads[start:end]:
        drawn.add_column(head, justify="right")
    for row in table.rows:
        cells = (row[0], *row[start:end])
        drawn.add_row(*(cell.text if isinstance(cell, Cell) else cell for cell in cells))
    return drawn
