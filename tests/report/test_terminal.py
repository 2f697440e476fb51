"""Tables on narrow terminals."""

from io import StringIO

import pytest
from rich.console import Console
from rich.table import Table

from cpid_drake.report.terminal import print_in_parts


@pytest.mark.parametrize("width", [30, 60, 200])
def test_no_number_is_cut_and_every_row_has_its_name(width):
    numbers = [[f"-1234567.{row}{column}" for column in range(8)] for row in range(3)]
    table = Table("name", *(f"column\n{column}" for column in range(8)), title="Title")
    for row, cells in enumerate(numbers):
        table.add_row(f"row {row}", *cells)
    text = StringIO()
    print_in_parts(Console(file=text, width=width), table)
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert text.getvalue().count("Title") == 1
    for row, cells in enumerate(numbers):
        found = " ".join(line for line in lines if f"row {row}" in line)
        assert [cell for cell in cells if cell not in found] == []
