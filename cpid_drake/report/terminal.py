"""Tables on terminals of any width: a table that is too wide is printed in parts."""

from copy import copy
from dataclasses import replace

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

_WIDEST = 10_000


def light_table(title: str) -> Table:
    """Return an empty table that is only ruled below its header."""
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        header_style="bold",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )


def print_in_parts(console: Console, table: Table) -> None:
    """Print a table; its columns are split into several tables where the terminal is narrow.

    The first column is in each of them. No number is cut or wrapped.
    """
    for k, part in enumerate(_parts(console, table)):
        part.title = table.title if k == 0 else None
        console.print(part)


def _parts(console: Console, table: Table) -> list[Table]:
    parts, columns = [], [0]
    for k in range(1, len(table.columns)):
        if len(columns) > 1 and _width(console, _part(table, [*columns, k])) > console.width:
            parts.append(_part(table, columns))
            columns = [0]
        columns.append(k)
    return [*parts, _part(table, columns)]


def _part(table: Table, columns: list[int]) -> Table:
    part = copy(table)
    part.columns = [replace(table.columns[k], _index=i) for i, k in enumerate(columns)]
    return part


def _width(console: Console, table: Table) -> int:
    wide = console.options.update(width=_WIDEST)
    return Measurement.get(console, wide, table).maximum
