"""Screening: grossly wrong samples are rejected and no others; chunks give what the whole gives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import every_sensor

from cpid_drake import Motion
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import (
    Log,
    Samples,
    ideal_log,
)
from cpid_drake.logs.screening import screen
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.presets import load_sensors, sensor_presets
from cpid_drake.sensors.sensors import (
    SENSORS,
)
from cpid_drake.sensors.suite import SensorSuite

JOINTS = ("a", "b")
NONE_REJECTED = dict.fromkeys(SENSORS, 0)

# -- motions -------------------------------------------------------------------------------------


def telemetry(t, q, qdot, turned=None, w=None, p=None, v=None) -> Motion:
    """Return a motion; the base is at rest unless something else is given."""
    zero = np.zeros((t.size, 3))
    turned = Rotation.from_rotvec(zero) if turned is None else turned
    return Motion(
        JOINTS,
        t,
        quaternion_WB=turned.as_quat(scalar_first=True),
        p_WB=zero if p is None else p,
        w_WB=zero if w is None else w,
        v_WB=zero if v is None else v,
        q=q,
        qdot=qdot,
    )


def swing(t, speed=1.0):
    """Return positions and rates of two joints that swing at 0.35 Hz, or faster."""
    phase = 2.2 * speed * t[:, None] + [0.0, 1.0]
    return [0.4, -0.3] * np.sin(phase), 2.2 * speed * np.array([0.4, -0.3]) * np.cos(phase)


def turn_about(axis, angle, rate):
    """Return attitude and angular velocity of a turn about a fixed axis."""
    axis = np.array(axis) / np.linalg.norm(axis)
    return {"turned": Rotation.from_rotvec(angle[:, None] * axis), "w": rate[:, None] * axis}


def slow(t):
    """Both joints swing; the base reacts."""
    q, qdot = swing(t)
    base = turn_about([1, 2, -1], 0.3 * np.sin(0.9 * t), 0.27 * np.cos(0.9 * t))
    along = np.array([0.01, 0.02, -0.03])
    p, v = np.sin(t)[:, None] * along, np.cos(t)[:, None] * along
    return telemetry(t, q, qdot, p=p, v=v, **base)


def fast(t):
    """Three times as fast."""
    q, qdot = swing(t, speed=3.0)
    base = turn_about([1, 2, -1], 0.1 * np.sin(6.6 * t), 0.66 * np.cos(6.6 * t))
    return telemetry(t, q, qdot, **base)


def rest(t):
    """Nothing moves; the positions are not zero."""
    return telemetry(t, np.tile([0.4, -0.3], (t.size, 1)), np.zeros((t.size, 2)))


def stop_and_go(t, start=0.0, end=np.inf):
    """The joints move by half cosines, with rests of 2 s between; the base moves with them."""
    clock = np.clip(t, start, end) - start
    phase = np.clip(clock % 4.0, 0.0, 2.0) * np.pi / 2
    s = clock // 4.0 + (1 - np.cos(phase)) / 2
    rate = np.pi / 4 * np.sin(phase) * (clock % 4.0 < 2.0)
    move = np.array([0.5, -0.2])
    base = turn_about([0, 1, 1], 0.2 * s, 0.2 * rate)
    return telemetry(t, s[:, None] * move, rate[:, None] * move, **base)


def firings(t):
    """Thrusters change the base's rates: at once, in a short burn, and back again."""
    q, qdot = swing(t)
    rate = 0.02 * (t >= 3.0) + 0.03 * np.clip((t - 5.0) / 0.5, 0, 1) - 0.05 * (t >= 7.013)
    angle = (
        0.02 * np.maximum(t - 3.0, 0)
        + 0.03 * (np.clip(t - 5.0, 0, 0.5) ** 2 + np.maximum(t - 5.5, 0))
        - 0.05 * np.maximum(t - 7.013, 0)
    )
    along = np.array([0.3, -0.2, 0.1])
    base = turn_about([3, -2, 2], angle, rate)
    return telemetry(t, q, qdot, p=angle[:, None] * along, v=rate[:, None] * along, **base)


MOTIONS = [slow, fast, rest, stop_and_go, firings]


def at_rate(suite: SensorSuite, rate: float) -> SensorSuite:
    """Return the same sensors at another rate, without dropouts, in which motion can hide."""
    present = suite.present().items()
    others = {name: replace(errors, rate=rate, dropouts=0.0) for name, errors in present}
    return replace(suite, **others)


def recorded(suite, motion, duration=10.0, seed=1) -> Log:
    """Return what the sensors of a suite record of a motion."""
    return add_noise(suite, ideal_log(suite, JOINTS, motion, duration), seed)


def in_chunks(measurements, suite, cuts) -> tuple[dict, dict]:
    """Return kept samples and counts if a log is screened in chunks between the times `cuts`."""
    memory, rejected, kept = None, dict(NONE_REJECTED), {name: [] for name in SENSORS}
    for start, end in zip([-np.inf, *cuts], [*cuts, np.inf]):
        chunk = {}
        for name, samples in measurements.items():
            sent = np.arange(len(samples)) / (suite[name].rate if len(samples) else 1.0)
            chunk[name] = samples.where((sent >= start) & (sent < end))
        result = screen(measurements.updated(chunk), suite, memory)
        memory = result.memory
        for name in SENSORS:
            rejected[name] += result.rejected[name]
            kept[name].append(result.log[name].time)
    return {name: np.concatenate(times) for name, times in kept.items()}, rejected


# -- clean samples -------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [None, 5.0])
@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.__name__)
def test_no_clean_sample_is_rejected(motion, rate):
    """Neither for the motion nor for the rate, in whole logs and in chunks."""
    for preset in sensor_presets():
        suite = load_sensors(preset)
        suite = suite if rate is None else at_rate(suite, rate)
        measurements = recorded(suite, motion, 12.0)
        assert screen(measurements, suite).rejected == NONE_REJECTED, preset
        _, rejected = in_chunks(measurements, suite, np.arange(0.5, 12.0, 0.5))
        assert rejected == NONE_REJECTED, preset


def test_noise_and_jitter_larger_than_given_are_not_spikes():
    """The samples around a sample show what is usual, not σ alone."""
    suite = load_sensors("flight")
    loud = replace(
        suite,
        gyro=replace(suite.gyro, angle_random_walk=100 * suite.gyro.angle_random_walk),
        position=replace(suite.position, sigma=100 * suite.position.sigma),
    )
    noisy = recorded(loud, slow, 60.0)
    encoders = noisy.encoders
    jitter = np.random.default_rng(2).uniform(0, 2e-3, len(encoders))
    noisy = noisy.updated({"encoders": Samples(encoders.time + jitter, encoders.value)})
    assert screen(noisy, suite).rejected == NONE_REJECTED


@pytest.mark.parametrize("decimals", [3, 6])
def test_rounding_in_a_file_is_not_a_stuck_sensor(decimals):
    """Rounded samples repeat themselves at rest, even if the suite says nothing of it."""
    suite = replace(load_sensors("flight"), attitude=None)
    noisy = recorded(suite, rest, 60.0)
    rounded = {
        name: Samples(samples.time, np.round(samples.value, decimals))
        for name, samples in noisy.items()
    }
    assert screen(noisy.updated(rounded), suite).rejected == NONE_REJECTED


# -- spikes --------------------------------------------------------------------------------------


def with_spikes(measurements, suite, name, size, rows, entry=0) -> Log:
    """Return measurements with errors of `size` σ or more in one entry of some samples."""
    samples, value = measurements[name], measurements[name].value.copy()
    scale = 0.5 if name == "attitude" else 1.0
    sizes = size * np.resize([1.0, -1.3, 1.7], len(rows))
    entry += name == "attitude"  # the first entry of a quaternion hardly changes its direction
    value[rows, entry] += scale * suite.sigmas(name).max() * sizes
    if name == "attitude":
        value /= np.linalg.norm(value, axis=1)[:, None]
    return measurements.updated({name: Samples(samples.time, value)})


def rejects_exactly(measurements, suite, name, rows) -> None:
    """Screening rejects these samples of a sensor, and no others."""
    result = screen(measurements, suite)
    assert result.rejected == NONE_REJECTED | {name: len(rows)}
    expected = np.delete(measurements[name].time, rows)
    np.testing.assert_array_equal(result.log[name].time, expected)


@pytest.mark.parametrize("motion", [slow, rest, firings], ids=lambda motion: motion.__name__)
@pytest.mark.parametrize("name", ["attitude", "gyro", "position", "encoders"])
def test_spikes_are_rejected_and_their_neighbours_are_not(name, motion):
    suite = load_sensors("flight")
    measurements = recorded(suite, motion)
    rows = np.array([0.12, 0.23, 0.41, 0.66, 0.8]) * len(measurements[name])
    rows = rows.astype(int)
    rejects_exactly(with_spikes(measurements, suite, name, 3000.0, rows), suite, name, rows)


@pytest.mark.parametrize(
    ("rate", "size"), [(5.0, 1e6), (20.0, 1e4), (100.0, 1000.0), (1000.0, 300.0)]
)
def test_spikes_are_found_at_all_rates(rate, size):
    """At low rates the motion between samples hides small ones."""
    suite = at_rate(load_sensors("servicer"), rate)
    rows = np.array([20, 33])
    for name in ("attitude", "gyro", "position", "encoders"):
        measurements = with_spikes(recorded(suite, slow), suite, name, size, rows)
        rejects_exactly(measurements, suite, name, rows)


def test_a_lasting_step_is_no_spike():
    """The samples after a step agree with each other; the likelihood must judge them."""
    suite = load_sensors("flight")
    measurements = recorded(suite, slow)
    for length in (4, 50, 300):
        value = measurements.gyro.value.copy()
        value[500 : 500 + length] += 0.01
        stepped = measurements.updated({"gyro": Samples(measurements.gyro.time, value)})
        assert screen(stepped, suite).rejected == NONE_REJECTED


# -- repeats -------------------------------------------------------------------------------------


def stuck(measurements, name, rows, entries=slice(None)) -> Log:
    """Return measurements in which a sensor repeats the sample before `rows` (a slice)."""
    value = measurements[name].value.copy()
    value[rows, entries] = value[rows.start - 1, entries]
    return measurements.updated({name: Samples(measurements[name].time, value)})


@pytest.mark.parametrize(
    ("name", "motion"), [("attitude", rest), ("gyro", slow), ("position", rest)]
)
def test_a_noisy_sensor_that_repeats_itself_is_stuck(name, motion):
    """Even at rest: noise never repeats itself. The first of the equal samples is good."""
    suite = load_sensors("flight")
    measurements = recorded(suite, motion)
    rows = slice(20, 27)
    rejects_exactly(stuck(measurements, name, rows), suite, name, range(20, 27))


def test_an_axis_that_never_varied_is_not_stuck():
    """On an air bearing, software may fill the other axes with zeros."""
    suite = load_sensors("testbed")
    measurements = recorded(suite, rest)
    value = measurements.gyro.value * [0.0, 0.0, 1.0]
    planar = measurements.updated({"gyro": Samples(measurements.gyro.time, value)})
    assert screen(planar, suite).rejected == NONE_REJECTED
    assert in_chunks(planar, suite, np.arange(0.5, 10.0, 0.5))[1] == NONE_REJECTED


# -- stamps --------------------------------------------------------------------------------------


def test_a_clock_that_stands_still_costs_its_samples_only():
    suite = load_sensors("flight")
    measurements = recorded(suite, slow)
    time = measurements.gyro.time.copy()
    time[300:350] = time[299]
    damaged = measurements.updated({"gyro": Samples(time, measurements.gyro.value)})
    rejects_exactly(damaged, suite, "gyro", range(300, 350))
    assert in_chunks(damaged, suite, np.arange(0.5, 10, 0.5))[1]["gyro"] == 50


@pytest.mark.parametrize(("wild", "row"), [(5000.0, 0), (1e300, 49), (-1e9, 999)])
def test_one_wild_stamp_costs_one_sample_at_any_place_in_a_chunk(wild, row):
    """Also if it is the last of its chunk, or the first of all."""
    suite = load_sensors("flight")
    measurements = recorded(suite, slow)
    time = measurements.gyro.time.copy()
    time[row] += wild
    damaged = measurements.updated({"gyro": Samples(time, measurements.gyro.value)})
    assert screen(damaged, suite).rejected == NONE_REJECTED | {"gyro": 1}
    kept, rejected = in_chunks(damaged, suite, np.arange(0.5, 10, 0.5))
    assert rejected == NONE_REJECTED | {"gyro": 1}
    np.testing.assert_array_equal(kept["gyro"], np.delete(measurements.gyro.time, row))


@pytest.mark.parametrize(
    ("motion", "start", "end", "last"), [(firings, 3.1, 6.0, 7.1), (stop_and_go, 4.75, 7.75, 8.3)]
)
def test_the_motion_in_a_gap_does_not_make_spikes_of_the_samples_behind(motion, start, end, last):
    """A polynomial through samples on both sides of a gap says nothing of the motion."""
    suite = at_rate(load_sensors("flight"), 5.0)
    measurements = recorded(suite, motion)
    gap = {
        name: s.where(((s.time < start) | (s.time > end)) & (s.time < last))
        for name, s in measurements.items()
    }
    assert screen(measurements.updated(gap), suite).rejected == NONE_REJECTED


# -- what needs no sensors -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def perfect() -> Log:
    return ideal_log(every_sensor(), JOINTS, slow, 10.0)


def screened(name, time, value=None, **others):
    """Return one sensor's samples that survive, and how many do not."""
    width = dict(zip(SENSORS, (4, 3, 3, 3, 2, 2)))[name]
    time = np.asarray(time, dtype=float)
    if value is None:
        value = np.tile(np.eye(width)[0], (time.size, 1))
    empty = {
        other: Samples(np.empty(0), np.empty((0, w)))
        for other, w in zip(SENSORS, (4, 3, 3, 3, 2, 2))
    }
    result = screen(Log(JOINTS, empty | {name: Samples(time, value)}))
    kept, rejected = result.log, result.rejected
    assert all(rejected[other] == 0 for other in SENSORS if other != name)
    assert rejected[name] + len(getattr(kept, name)) == time.size
    return getattr(kept, name), rejected[name]


@pytest.mark.parametrize("suite", [None, every_sensor()], ids=["unknown", "known"])
def test_good_samples_survive(perfect, suite):
    noisy = add_noise(every_sensor(), perfect, seed=1)
    result = screen(noisy, suite)
    assert result.rejected == dict.fromkeys(SENSORS, 0)
    assert result.log.joint_names == JOINTS
    for name, samples in noisy.items():
        np.testing.assert_array_equal(result.log[name].time, samples.time)
        np.testing.assert_allclose(result.log[name].value, samples.value, atol=1e-15)


@pytest.mark.parametrize(("name", "bad"), [("attitude", np.nan), ("encoders", np.inf)])
def test_samples_that_are_not_finite_are_left_out(perfect, name, bad):
    samples = getattr(perfect, name)
    time, value = samples.time.copy(), samples.value.copy()
    value[3, -1] = bad
    time[5] = bad
    kept, rejected = screened(name, time, value)
    assert rejected == 2
    np.testing.assert_array_equal(kept.time, np.delete(samples.time, [3, 5]))


@pytest.mark.parametrize(
    ("time", "kept"),
    [
        ([0, 1, 1, 2], [0, 1, 3]),
        ([0, 1, 2, 0, 1, 2, 3], [0, 1, 2, 6]),
        ([0, 2, 1, 3], [0, 1, 3]),
        ([0, 1, 2, 1e9, 3, 4, 5], [0, 1, 2, 4, 5, 6]),
        ([1e9, 0, 1, 2], [1, 2, 3]),
        ([0, 1, 2, 1e9, 1e9 + 1], [0, 1, 2]),
        ([0, 1, 2, 500], [0, 1, 2]),
        ([0, 1.7e9, 1.7e9 + 1, 1.7e9 + 2], [1, 2, 3]),
        ([0, 1, 2, 3, 4000, 4001, 4002], [0, 1, 2, 3]),
        ([0, 1, 2, 3, 3000, 3001, 3002], [0, 1, 2, 3, 4, 5, 6]),
        ([], []),
    ],
)
def test_stamps_that_do_not_increase_or_are_of_another_clock_are_left_out(time, kept):
    value = np.arange(3.0 * len(time)).reshape(-1, 3)
    samples, rejected = screened("position", time, value)
    np.testing.assert_array_equal(samples.time, np.array(time, dtype=float)[kept])
    np.testing.assert_array_equal(samples.value, value[kept])
    assert rejected == len(time) - len(kept)


def test_a_sensor_on_another_clock_than_all_others_is_left_out(perfect):
    late = Samples(perfect.position.time + 1e9, perfect.position.value)
    rejected = screen(perfect.updated({"position": late})).rejected
    assert rejected == dict.fromkeys(SENSORS, 0) | {"position": len(late)}


@pytest.mark.parametrize("scale", [0.0, 0.998, 1.002, 1e200], ids=lambda scale: f"{scale:g}")
def test_attitudes_that_are_none_are_left_out(scale):
    quaternion = np.tile([0.5, -0.5, 0.5, 0.5], (4, 1))
    quaternion[2] *= scale
    samples, rejected = screened("attitude", np.arange(4), quaternion)
    assert rejected == 1
    np.testing.assert_array_equal(samples.time, [0, 1, 3])


@pytest.mark.parametrize(
    ("times", "force", "phrase"),
    [
        ([0.0, 1.0, 2.0], [5.0, np.nan, 0.0], "at 1 s is not finite"),
        ([0.0, np.inf, 2.0], [5.0, 1.0, 0.0], "at inf s is not finite"),
        ([0.0, 2.0, 1.0], [5.0, 1.0, 0.0], "at 1 s comes after that at 2 s"),
        ([0.0, 1.0, 1.0], [5.0, 1.0, 0.0], "at 1 s comes after that at 1 s"),
    ],
)
def test_a_wrong_sample_of_thrust_is_no_reason_to_hold_the_one_before(times, force, phrase):
    value = np.zeros((3, 6))
    value[:, 3] = force
    log = Log(JOINTS, {"thrust": Samples(np.array(times), value)})
    with pytest.raises(InputError, match=phrase):
        screen(log)
