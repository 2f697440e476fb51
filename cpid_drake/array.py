"""The type of arrays of numbers, whose docstrings say their shapes; columns without a copy."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def as_slice(columns: NDArray[np.intp]) -> "slice | NDArray[np.intp]":
    """Return columns (n,) as a slice if they are consecutive: a slice takes a view, not a copy."""
    if columns.size and np.array_equal(columns, columns[0] + np.arange(columns.size)):
        return slice(int(columns[0]), int(columns[-1]) + 1)
    return columns
