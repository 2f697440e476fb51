"""A log cut into blocks holds the same samples, and thrust holds on from block to block."""

from itertools import pairwise

import numpy as np
import pytest

from cpid_drake.logs.log import THRUST, Log, Samples, concatenated


def log(duration=10.0, start=0.0) -> Log:
    """Return samples of two sensors at rates that no common period divides."""
    rng = np.random.default_rng(1)
    fast = start + np.sort(rng.uniform(0, duration, 400))
    slow = start + np.arange(0, duration, 0.7)
    return Log(
        ("a", "b"),
        {
            "gyro": Samples(fast, rng.normal(size=(400, 3))),
            "encoders": Samples(slow, rng.normal(size=(len(slow), 2))),
        },
    )


def assert_same(one: Log, other: Log) -> None:
    assert one.joint_names == other.joint_names
    for (name, a), (_, b) in zip(one.items(), other.items(), strict=True):
        np.testing.assert_array_equal(a.time, b.time, err_msg=name)
        np.testing.assert_array_equal(a.value, b.value, err_msg=name)


@pytest.mark.parametrize(("seconds", "start"), [(0.05, 1.7e9), (3.3, 0.0)])
def test_blocks_hold_every_sample_once_in_intervals_that_do_not_overlap(start, seconds):
    whole = log(start=start)
    parts = list(whole.blocks(seconds))
    assert_same(concatenated(parts), whole)
    for before, after in pairwise(parts):
        assert before.interval[1] < after.interval[0]
    assert all(np.ptp(part.interval) <= seconds + 1e-6 for part in parts)


@pytest.mark.parametrize("seconds", [0.05, 3.3])
def test_thrust_holds_from_block_to_block(seconds):
    """A burn whose samples are in one block pushes in the next ones, too; none acts before it."""
    burns = Samples(np.array([1.234, 2.0, 6.5]), np.array([[1.0] * 6, [2.0] * 6, [0.0] * 6]))
    whole = log().updated({THRUST: burns})
    times = np.linspace(0.0, 10.0, 501)
    expected = burns.held_at(times)
    assert (expected[times < 1.234] == 0).all()
    assert (expected[times >= 6.5] == 0).all()
    parts = list(whole.blocks(seconds))
    np.testing.assert_array_equal(concatenated(parts).thrust.held_at(times), expected)
    for part in parts:
        start, end = part.interval
        inside = times[(times >= start) & (times <= end)]
        np.testing.assert_array_equal(part.thrust.held_at(inside), burns.held_at(inside))
    cut = whole.between(1.5, 3.0)
    np.testing.assert_array_equal(cut.thrust.time, [1.5, 2.0])
    np.testing.assert_array_equal(cut.thrust.value[:, 0], [1.0, 2.0])


def test_a_thinned_log_is_even():
    thin = log().thinned(100)
    np.testing.assert_array_equal(thin.gyro.time, log().gyro.time[::4])
    np.testing.assert_array_equal(thin.encoders.time, log().encoders.time)
