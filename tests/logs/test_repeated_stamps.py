"""Samples with the stamp of another of their sensor: the first counts, others are rejected."""

from collections import Counter

import numpy as np
import pytest
from flyer_cases import columns, csv_of, flyer, write

from cpid_drake import InputError, from_columns, read_log, write_log
from cpid_drake.identification.checked_log import check_log
from cpid_drake.logs.channels import look_at
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.formats import inspect_log
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import LogTable

AGAIN = [7, 30, 31, 250]
SENSORS = ("attitude", "gyro", "position", "encoders")
ONCE_EACH = dict.fromkeys(SENSORS, len(AGAIN))


def repeated(change: float = 0.0) -> dict[str, np.ndarray]:
    """Return columns in which rows are there twice, perhaps with another position."""
    given = columns()
    rows = np.sort(np.concatenate([np.arange(251), AGAIN]))
    found = {name: column[rows] for name, column in given.items()}
    found["x"][np.flatnonzero(np.diff(rows) == 0) + 1] += change
    return found


def assert_first_counts(log: Log) -> None:
    """Assert that a log is that of the columns without repeated rows, and what is said of it."""
    checked = check_log(flyer(), log)
    assert +Counter(checked.rejected) == ONCE_EACH
    expected = check_log(flyer(), from_columns(columns())).measurements
    for name in SENSORS:
        np.testing.assert_array_equal(checked.measurements[name].time, expected[name].time)
        np.testing.assert_array_equal(checked.measurements[name].value, expected[name].value)
    for channel in checked.channels:
        if channel.name in SENSORS:
            assert channel.rate == pytest.approx(25.0)
            assert channel.notes[0] == "4 with a repeated stamp, left out: the first counts"


@pytest.mark.parametrize("change", [0.0, 0.01], ids=["the same", "another value"])
@pytest.mark.parametrize("source", ["text", "columns", "written again", "memory"])
def test_the_first_of_several_samples_counts(tmp_path, source, change):
    if source == "columns":
        log = from_columns(repeated(change))
    elif source == "memory":
        log = read_log(write(tmp_path, csv_of(columns())))
        rows = np.sort(np.concatenate([np.arange(251), AGAIN]))
        log = log.updated({name: log[name].where(rows) for name in SENSORS})
    else:
        found = inspect_log(write(tmp_path, csv_of(repeated(change))))
        assert found.problems == []
        log = found.log
    if source == "written again":
        write_log(tmp_path / "again.csv", log)
        log = read_log(tmp_path / "again.csv")
    assert_first_counts(log)


def test_a_log_that_was_written_twice_has_its_rate():
    log = from_columns({name: np.repeat(column, 2) for name, column in columns().items()})
    rates = {channel.name: channel.rate for channel in look_at(log).table if channel.rows}
    assert rates == pytest.approx(dict.fromkeys(SENSORS, 25.0))


def test_sensors_in_rows_of_their_own_may_have_the_same_time(tmp_path):
    """A row for the gyro behind that of the others repeats no stamp of a sensor."""
    given = columns()
    twice = {name: np.repeat(column, 2) for name, column in given.items()}
    for name, column in twice.items():
        if name != "time":
            column[(0 if name.startswith("bw") else 1) :: 2] = np.nan
    checked = check_log(flyer(), read_log(write(tmp_path, csv_of(twice))))
    assert not +Counter(checked.rejected)
    np.testing.assert_array_equal(checked.measurements.gyro.time, given["time"])
    np.testing.assert_array_equal(checked.measurements.attitude.time, given["time"])


def test_an_angle_that_jumps_loses_no_count():
    """What unwraps the joints leaves repeated samples to the one place that counts them."""
    log = from_columns(repeated())
    value = log.encoders.value.copy()
    value[:, 0] = (value[:, 0] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(np.diff(value[:, 0])).max() > 6
    seen = look_at(log.updated({"encoders": Samples(log.encoders.time, value)}))
    screened = screen(seen.log)
    assert screened.rejected["encoders"] == len(AGAIN)
    assert np.abs(np.diff(screened.log.encoders.value[:, 0])).max() < 1


def test_joints_in_rows_of_their_own_are_interpolated_without_repeated_ones():
    given = columns()
    joints = [name for name in given if name.startswith("q:")]
    count = len(joints)
    rows = {name: np.repeat(column, count) for name, column in given.items()}
    rows["time"] = rows["time"] + np.tile(np.arange(count) * 1e-4, 251)
    for k, name in enumerate(joints):
        rows[name][np.arange(251 * count) % count != k] = np.nan
    once = read_columns(ColumnMap(), LogTable(rows), "the columns")
    again = np.sort(np.concatenate([np.arange(251 * count), [100, 101, 102]]))
    table = LogTable({name: column[again] for name, column in rows.items()})
    found = read_columns(ColumnMap(), table, "the columns")
    twice = screen(found.log).log
    np.testing.assert_array_equal(twice.encoders.value, once.log.encoders.value)
    np.testing.assert_array_equal(twice.encoders.time, once.log.encoders.time)
    assert found.partial["encoders"] == once.partial["encoders"] + 3
    assert found.log.notes["encoders"][0].endswith("; 3 with a repeated stamp, left out")


def test_a_second_log_behind_repeated_rows_is_one_problem(tmp_path):
    text = csv_of(repeated())
    found = inspect_log(write(tmp_path, text + text.partition("\n")[2]))
    [problem] = found.problems
    assert "starts again at 0 s after 10 s, for 255 rows" in problem
    assert_first_counts(found.log)


def test_a_time_that_stands_still_is_refused(tmp_path):
    given = columns() | {"time": np.full(251, 1.73e9 + 1)}
    with pytest.raises(InputError, match="column 'time': the time is 1730000001 s in all rows"):
        inspect_log(write(tmp_path, csv_of(given)))


def test_thrust_that_comes_again_is_counted_also_in_the_next_chunk():
    def chunk(*times):
        return Log((), {"thrust": Samples(np.array(times), np.ones((len(times), 6)))})

    first = screen(chunk(0.0, 1.0, 1.0, 2.0))
    assert first.rejected["thrust"] == 1
    np.testing.assert_array_equal(first.log.thrust.time, [0.0, 1.0, 2.0])
    nothing = screen(Log(()), memory=first.memory)
    second = screen(chunk(1.0, 2.0, 3.0), memory=nothing.memory)
    assert second.rejected["thrust"] == 2
    np.testing.assert_array_equal(second.log.thrust.time, [3.0])
