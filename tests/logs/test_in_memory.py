"""Logs from columns in memory: mappings and data frames are alike; what is no table is said."""

import numpy as np
import pytest

from cpid_drake import ColumnMap, InputError, from_columns

TIME = 0.1 * np.arange(20)
COLUMNS = {
    "time": TIME,
    **dict(zip(("qw", "qx", "qy", "qz"), (np.ones(20), *np.zeros((3, 20))))),
    "q:a": np.sin(TIME),
}


class Column:
    """A column of a data frame, which is an array when NumPy asks for one."""

    def __init__(self, values):
        self._values = values

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self._values, dtype=dtype)


class Frame:
    """A data frame: names, and columns by name; it is no mapping."""

    def __init__(self, columns):
        self._columns = columns

    @property
    def columns(self):
        return [*self._columns]

    def __getitem__(self, name):
        return Column(self._columns[name])


class Missing:
    """The value of a cell without one."""

    def __repr__(self):
        return "<NA>"


def with_column(name, values):
    return Frame({**COLUMNS, name: values})


def test_a_data_frame_is_the_mapping_of_its_columns():
    log, other = from_columns(COLUMNS), from_columns(Frame(COLUMNS))
    assert other.joint_names == log.joint_names == ("a",)
    for name, samples in log.items():
        np.testing.assert_array_equal(other[name].time, samples.time)
        np.testing.assert_array_equal(other[name].value, samples.value)


def test_cells_without_a_value_are_absent_samples():
    values = np.sin(TIME).astype(object)
    values[3], values[5] = Missing(), None
    log = from_columns(with_column("q:a", values))
    np.testing.assert_array_equal(log.encoders.time, np.delete(TIME, [3, 5]))
    assert len(log.attitude) == 20


def test_a_column_of_texts_matters_only_if_it_is_used():
    frame = with_column("operator", np.array(20 * ["x"]))
    assert len(from_columns(frame).encoders) == 20
    used = ColumnMap()
    used.time.column = "operator"
    with pytest.raises(InputError, match="column 'operator' is not made of numbers"):
        from_columns(frame, used)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (3, "a mapping of arrays or a data frame, not int"),
        (TIME, "a mapping of arrays or a data frame, not ndarray"),
        ({}, "all columns must have the same length, not no columns"),
        (with_column(0, TIME), "the column 0 must have a text as its name"),
        (
            with_column("qw", np.ones((20, 2))),
            r"'qw' must have one dimension, not .*\(20, 2",
        ),
        (with_column("x", TIME[:3]), "the same length, not 'time' 20, .* 'x' 3"),
        (Frame({n: c for n, c in COLUMNS.items() if n != "time"}), "there is no column 'time'"),
    ],
)
def test_what_is_no_table_is_said(columns, message):
    with pytest.raises(InputError, match=message):
        from_columns(columns)
