"""A stream of chunks holds the same samples as the log, whatever the length of its chunks."""

from itertools import pairwise

import numpy as np
import pytest

from cpid_drake.resources import models_directory
from cpid_drake.sensing.files.telemetry_files import (
    open_telemetry,
    read_telemetry,
    write_telemetry,
)
from cpid_drake.sensing.measurement_stream import (
    chunks,
    head_of,
    joined,
    stream_of,
    time_interval,
)
from cpid_drake.sensing.measurements import THRUST, Measurements, Samples

SAMPLE = models_directory() / "telemetry/free_flyer.csv"


def log(duration=10.0, start=0.0) -> Measurements:
    """Return samples of two sensors at rates that no common period divides."""
    rng = np.random.default_rng(1)
    fast = start + np.sort(rng.uniform(0, duration, 400))
    slow = start + np.arange(0, duration, 0.7)
    return Measurements(
        ("a", "b"),
        gyro=Samples(fast, rng.normal(size=(400, 3))),
        encoders=Samples(slow, rng.normal(size=(len(slow), 2))),
    )


def assert_same(one: Measurements, other: Measurements) -> None:
    assert one.joint_names == other.joint_names
    for (name, a), (_, b) in zip(one.items(), other.items(), strict=True):
        np.testing.assert_array_equal(a.time, b.time, err_msg=name)
        np.testing.assert_array_equal(a.value, b.value, err_msg=name)


@pytest.mark.parametrize("seconds", [0.05, 3.3])
def test_chunks_hold_every_sample_once_in_intervals_that_do_not_overlap(seconds):
    whole = log()
    parts = list(chunks(whole, seconds))
    assert_same(joined(parts), whole)
    intervals = [time_interval(part) for part in parts]
    assert None not in intervals
    for (_, end), (start, _) in pairwise(intervals):
        assert end < start
    assert all(end - start <= seconds for start, end in intervals)


@pytest.mark.parametrize("seconds", [0.05, 3.3])
def test_thrust_holds_from_chunk_to_chunk(seconds):
    """A burn whose samples are in one chunk pushes in the next ones, too; none acts before it."""
    burns = Samples(np.array([1.234, 2.0, 6.5]), np.array([[1.0] * 6, [2.0] * 6, [0.0] * 6]))
    whole = log().updated({THRUST: burns})
    times = np.linspace(0.0, 10.0, 501)
    expected = burns.held_at(times)
    assert (expected[times < 1.234] == 0).all()
    assert (expected[times >= 6.5] == 0).all()
    parts = list(chunks(whole, seconds))
    np.testing.assert_array_equal(joined(parts).thrust.held_at(times), expected)
    for part in parts:
        start, end = time_interval(part)
        inside = times[(times >= start) & (times <= end)]
        np.testing.assert_array_equal(part.thrust.held_at(inside), burns.held_at(inside))
    cut = whole.between(1.5, 3.0)
    np.testing.assert_array_equal(cut.thrust.time, [1.5, 2.0])
    np.testing.assert_array_equal(cut.thrust.value[:, 0], [1.0, 2.0])


def test_the_head_is_the_beginning_and_knows_whether_it_is_everything():
    whole = log()
    head, is_all = head_of(stream_of(whole, 1.0), 100)
    assert not is_all
    assert 100 < len(head.gyro) < 200
    assert_same(head, whole.between(0, time_interval(head)[1]))
    everything, is_all = head_of(stream_of(whole, 1.0), 400)
    assert is_all
    assert_same(everything, whole)


# -- files ----------------------------------------------------------------------------------------


@pytest.fixture(params=[".csv", ".npz", ".parquet"])
def file(request, tmp_path):
    """Return a file of a sample with sensors at different rates."""
    if request.param == ".parquet":
        pytest.importorskip("pyarrow")
    whole = read_telemetry(SAMPLE)
    slow = whole.updated({"attitude": whole.attitude.where(slice(None, None, 3))})
    path = tmp_path / f"log{request.param}"
    write_telemetry(path, slow)
    return path


def test_a_file_gives_the_same_samples_as_a_stream_and_at_once(file):
    stream = open_telemetry(file, seconds=0.7)
    parts = list(stream)
    assert len(parts) > 5
    assert_same(joined(parts), read_telemetry(file))
    assert_same(joined(stream), read_telemetry(file))  # again
    assert stream.joint_names == read_telemetry(file).joint_names
    assert stream.row_count == len(read_telemetry(file).gyro)


def test_a_stream_of_a_window_holds_the_samples_in_it(file):
    stream = open_telemetry(file, start=1.0, end=2.5, seconds=0.7)
    assert_same(joined(stream), read_telemetry(file).between(1.0, 2.5))
