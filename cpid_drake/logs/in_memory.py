"""A log from columns in memory: a mapping of arrays, or a data frame of pandas or polars."""

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.log import Log
from cpid_drake.logs.table import LogTable, seconds_of_times

_ABSENT = ("None", "nan", "<NA>", "NaT")
"""What objects without a value are as text."""


class DataFrame(Protocol):
    """A data frame: its columns by name."""

    @property
    def columns(self) -> Any:
        """The names."""

    def __getitem__(self, name: Any, /) -> Any: ...


def from_columns(
    columns: Mapping[str, ArrayLike] | DataFrame, column_map: ColumnMap | None = None
) -> Log:
    """Return a log from columns in memory, such as those of a MATLAB file or a data frame.

    Args:
        columns: by name, numbers (N,), NaN for absent samples; NumPy's dates and durations are
            times in seconds. Columns of texts cannot be used. A data frame of pandas or polars is
            such columns; its index is none of them.
        column_map: what the columns mean; None for the package's own columns.

    Raises:
        InputError: a column that is used is no array of N numbers, or has no name; or for the same
            reasons as `read_columns`, also for the first bad row.

    """
    if not isinstance(column_map, ColumnMap | None):
        raise InputError(
            f"column_map must be a ColumnMap, such as load_column_map('map.yaml'), not "
            f"{column_map!r:.80}"
        )
    arrays, unreadable = dict[str, Array](), dict[str, str]()
    for name, column in _items(columns):
        if not isinstance(name, str):
            raise InputError(f"the column {name!r} must have a text as its name")
        try:
            array = seconds_of_times(_without_objects(np.asarray(column))).astype(float)
        except (TypeError, ValueError) as error:
            unreadable[name] = f"is not made of numbers: {error}"
            continue
        if array.ndim != 1:
            raise InputError(
                f"column '{name}' must have one dimension, not the shape {array.shape}; give each "
                "column once, by a name of its own"
            )
        arrays[name] = array
    lengths = {name: len(array) for name, array in arrays.items()}
    if len({*lengths.values()}) != 1:
        counts = ", ".join(f"'{name}' {count}" for name, count in [*lengths.items()][:8])
        raise InputError(f"all columns must have the same length, not {counts or 'no columns'}")
    table = LogTable(arrays, unreadable=unreadable)
    converted = read_columns(column_map or ColumnMap(), table, "the columns")
    if converted.problems:
        raise InputError(converted.problems[0])
    return converted.log


def _items(columns: Mapping[str, ArrayLike] | DataFrame) -> Iterator[tuple[object, Any]]:
    """Yield names and columns."""
    names = columns if isinstance(columns, Mapping) else getattr(columns, "columns", None)
    if names is None:
        kind = type(columns).__name__
        raise InputError(f"columns must be a mapping of arrays or a data frame, not {kind}")
    for name in names:
        yield name, columns[name]


def _without_objects(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of objects with NaN for those that have no value."""
    if array.dtype != object:
        return array
    plain = [np.nan if str(each) in _ABSENT else each for each in array.ravel()]
    return np.array(plain, dtype=float).reshape(array.shape)
