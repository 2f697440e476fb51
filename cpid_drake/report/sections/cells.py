"""Cells of tables that carry the exact value of the result file."""

import numpy as np

from cpid_drake.report.page import Cell

PARAMETER_KEYS = ("mass", *(f"com.{i}" for i in range(3)), *(f"inertia.{i}" for i in range(6)))
"""Paths of the ten parameters in a result file."""


def value_cell(
    value: float, key: str, decimals: int = 0, absent: str = "", data: str = "result"
) -> Cell:
    """Return a cell with a rounded value and its path in the JSON; `absent` if it is not known."""
    if not np.isfinite(value):
        return Cell(absent, None, key, data)
    value = value if isinstance(value, int) else float(value)
    return Cell(f"{round(value, decimals) + 0.0:.{decimals}f}", value, key, data)
