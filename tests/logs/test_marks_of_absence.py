"""Numbers that mark absent samples are absent; values that a sensor may have measured are kept."""

import numpy as np
import pytest
from flyer_cases import JOINT, RATE, columns

from cpid_drake import from_columns

PLACE, SPIN = ["x", "y", "z"], ["bwx", "bwy", "bwz"]
TURN = ["qw", "qx", "qy", "qz"]


def marked(given, names, mark, rows):
    """Return columns in which some rows of several hold a mark."""
    given = dict(given)
    for name in names:
        given[name] = given[name].copy()
        given[name][rows] = mark
    return given


def scattered(time):
    return np.arange(len(time)) % 23 == 5


@pytest.mark.parametrize("mark", [-9999.0, 9999.0, 1e10, -32768.0, 3.4e38])
@pytest.mark.parametrize(
    ("sensor", "names"),
    [("position", PLACE), ("attitude", TURN), ("gyro", SPIN), ("encoders", [JOINT])],
)
def test_a_mark_is_an_absent_sample(sensor, names, mark):
    plain = columns()
    rows = scattered(plain["time"])
    log, true = from_columns(marked(plain, names, mark, rows)), from_columns(plain)
    for name, samples in true.items():
        expected = samples.where(~rows) if name == sensor and len(samples) else samples
        np.testing.assert_array_equal(log[name].time, expected.time)
        np.testing.assert_array_equal(log[name].value, expected.value)
    [note] = log.notes[sensor]
    assert note == f"{mark:.10g} in {rows.sum()} rows, far from all other values, is read as absent"


def test_a_sensor_may_have_several_marks_and_begin_with_one():
    plain = columns()
    first, rows = np.arange(len(plain["time"])) < 40, scattered(plain["time"])
    given = marked(marked(plain, PLACE, 1e6, rows), PLACE, -9999.0, first)
    log = from_columns(given)
    np.testing.assert_array_equal(log.position.time, plain["time"][~first & ~rows])
    assert log.notes["position"][0].startswith("-9999, 1000000 in ")


def stepped(given):
    """A joint that is driven in steps, as a rate: it rests, and turns at one exact speed."""
    time = given["time"]
    given |= {f"qd:{name[2:]}": np.zeros(len(time)) for name in given if name.startswith("q:")}
    given[RATE] = np.where((time > 2) & (time < 4), 100.0, 1e-3 * np.round(np.sin(9 * time)))


def moved_in_a_pause(given):
    """A joint that holds still exactly, but for one step of its encoder, and was moved unseen."""
    given[JOINT] = np.where(given["time"] < 5, 0.0, 1.0)
    given[JOINT][7] = 1e-4


def one_spike(given):
    given["x"] = given["x"].copy()
    given["x"][30] = -9999.0


def at_one_end(given):
    given["bwx"] = given["bwx"].clip(-0.02, 0.02)


def plain(given):
    pass


@pytest.mark.parametrize("change", [stepped, moved_in_a_pause, one_spike, at_one_end, plain])
def test_what_may_be_measured_is_kept(change):
    given = columns()
    change(given)
    log = from_columns(given)
    assert not any("read as absent" in note for notes in log.notes.values() for note in notes)
    assert all(len(samples) in (0, len(given["time"])) for _, samples in log.items())
