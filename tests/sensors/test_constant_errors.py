"""Constant errors of simulated sensors: their size, their physics and their random streams."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, Motion
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise
from cpid_drake.sensors.sensors import (
    ARCSECOND,
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    VectorSensor,
)
from cpid_drake.sensors.simulated_disturbance import random_stream
from cpid_drake.sensors.suite import SensorSuite, check_sensors

JOINTS = ("a", "b")
DRIFTS = {"attitude": 50.0, "gyro": 90.0, "position": 30.0, "velocity": 20.0, "encoders": 10.0}
DELAYS = {"attitude": 20.0, "gyro": 5.0, "position": 10.0, "velocity": 10.0, "encoders": 2.0}
KEYS = ("zero_mrad", "drift_mrad_per_s", "joint_scale_ppm", "eccentricity_mrad")
AXIS = np.array([0.6, -0.48, 0.64])


def suite(**changes) -> SensorSuite:
    """Sensors with every constant error and without noise."""
    sensors = SensorSuite(
        attitude=AttitudeSensor(rate=4.0, mounting_arcsec=200.0, delay_ms=20.0),
        gyro=Gyro(rate=50.0, scale_ppm=500.0, misalignment_arcsec=60.0, delay_ms=5.0),
        position=VectorSensor(rate=10.0, lever_arm_mm=30.0, delay_ms=10.0),
        velocity=VectorSensor(rate=7.0, lever_arm_mm=20.0, delay_ms=10.0),
        encoders=JointSensor(
            rate=30.0,
            zero_mrad=0.5,
            drift_mrad_per_s=0.2,
            joint_scale_ppm=400.0,
            eccentricity_mrad=0.7,
            delay_ms=2.0,
        ),
        joint_rates=JointSensor(rate=3.0),
    )
    for name, drift in DRIFTS.items():
        sensors[name].clock_drift_ppm = drift
    return replace(sensors, **changes)


def motion(times) -> Motion:
    """A base that turns about one axis, faster and slower, while it drifts and joints move."""
    t = np.asarray(times)[:, None]
    angle, rate = 0.3 * np.sin(2 * t), 0.6 * np.cos(2 * t)
    return Motion(
        JOINTS,
        t[:, 0],
        quaternion_WB=Rotation.from_rotvec(angle * AXIS).as_quat(scalar_first=True),
        p_WB=np.sin(t * [0.1, 0.2, -0.3]),
        w_WB=rate * AXIS,
        v_WB=np.cos(t * [0.1, 0.2, -0.3]) * [0.1, 0.2, -0.3],
        q=np.sin(t * [0.3, 0.4]),
        qdot=np.cos(t * [0.3, 0.4]) * [0.3, 0.4],
    )


def pair(sensors: SensorSuite, seed: int = 3):
    """Return ideal and measured samples and the errors' values."""
    ideal = ideal_log(sensors, JOINTS, motion, 4.0)
    return ideal, add_noise(sensors, ideal, seed), SensorNoise(sensors, seed)


def test_every_value_has_the_given_sigma():
    drawn = {name: [] for name in SENSORS}
    for seed in range(1000):
        noise = SensorNoise(suite(), seed)
        for name in SENSORS:
            drawn[name].append(noise.constants(name, 2))

    def spread(name, attribute):
        return np.std([getattr(each, attribute) for each in drawn[name]], axis=0)

    for name, size in DELAYS.items():
        assert spread(name, "delay") == pytest.approx(1e-3 * size, rel=0.09)
        assert spread(name, "clock_drift") == pytest.approx(1e-6 * DRIFTS[name], rel=0.09)
    np.testing.assert_allclose(spread("attitude", "mounting_B"), 200 * ARCSECOND, rtol=0.09)
    scale = np.full((3, 3), 60 * ARCSECOND)
    np.fill_diagonal(scale, 500e-6)
    np.testing.assert_allclose(spread("gyro", "scale"), scale, rtol=0.09)
    np.testing.assert_allclose(spread("position", "lever_arm_B"), 0.03, rtol=0.09)
    np.testing.assert_allclose(spread("velocity", "lever_arm_B"), 0.02, rtol=0.09)
    np.testing.assert_allclose(spread("encoders", "zero"), 0.5e-3, rtol=0.09)
    np.testing.assert_allclose(spread("encoders", "drift"), 0.2e-3, rtol=0.09)
    np.testing.assert_allclose(spread("encoders", "joint_scale"), 4e-4, rtol=0.09)
    np.testing.assert_allclose(spread("encoders", "eccentricity"), 0.7e-3, rtol=0.09)
    assert not any(each.zero.any() for each in drawn["joint_rates"]), "a rate has no zero"


def test_all_values_are_independent():
    """No two errors of a seed, nor an error and the noise, come from one stream."""
    rows = []
    for seed in range(1000):
        noise = SensorNoise(suite(), seed)
        row = [random_stream(seed, k).standard_normal(3) for k in range(9)]
        for name in DELAYS:
            row += [np.ravel(each) for each in vars(noise.constants(name, 2)).values()]
        rows.append(np.concatenate(row))
    table = np.array(rows)
    table = table[:, table.std(axis=0) > 0]
    assert table.shape[1] == 9 * 3 + 5 + 5 + 3 + 9 + 3 + 3 + 2 + 2 + 2 + 4
    off_diagonal = np.corrcoef(table.T) - np.eye(table.shape[1])
    assert np.abs(off_diagonal).max() < 4.5 / np.sqrt(len(rows))


def test_a_seed_that_is_none_is_refused():
    with pytest.raises(InputError, match="seed must be a whole number"):
        SensorNoise(suite(), -1)


def test_an_attitude_sensor_is_turned_in_the_base():
    ideal, measured, noise = pair(suite())
    true, found = (
        Rotation.from_quat(each.attitude.value, scalar_first=True) for each in (ideal, measured)
    )
    turns = (true.inv() * found).as_rotvec()
    expected = np.tile(noise.constants("attitude").mounting_B, (len(turns), 1))
    np.testing.assert_allclose(turns, expected, atol=1e-15)


def test_a_gyro_has_scales_and_misalignments():
    ideal, measured, noise = pair(suite())
    scale = noise.constants("gyro").scale
    for true, found in zip(ideal.gyro.value, measured.gyro.value, strict=True):
        np.testing.assert_allclose(found, (np.eye(3) + scale) @ true, atol=1e-15)


def test_a_lever_arm_moves_the_measured_point():
    """Position is that of a point of the base; velocity is the derivative of such a position."""
    _, measured, noise = pair(suite())
    constants = noise.constants("position")
    stamps = measured.position.time
    true = motion((stamps - constants.delay) / (1 + constants.clock_drift))
    l_B = noise.constants("position").lever_arm_B
    expected = true.p_WB + Rotation.from_matrix(true.R_WB).apply(l_B)
    np.testing.assert_allclose(measured.position.value, expected, atol=1e-14)

    l_B, times = noise.constants("velocity").lever_arm_B, np.arange(len(measured.velocity)) / 7.0
    before, after = (
        state.p_WB + Rotation.from_matrix(state.R_WB).apply(l_B)
        for state in (motion(times - 1e-4), motion(times + 1e-4))
    )
    np.testing.assert_allclose(measured.velocity.value, (after - before) / 2e-4, atol=1e-8)


@pytest.mark.parametrize("keys", [KEYS[:2], KEYS[2:3], KEYS[3:]])
def test_joint_rates_are_those_of_positions_with_errors(keys):
    """Zeros that drift, scales and errors once a turn: the rates have no zeros, nor their drift."""
    none = dict.fromkeys(set(KEYS) - set(keys), 0.0)
    ideal, measured, noise = pair(suite(encoders=replace(suite().encoders, **none)))
    constants = noise.constants("encoders", 2)

    def shown(times):
        q, (sine, cosine) = motion(times).q, constants.eccentricity
        drifted = constants.zero + np.asarray(times)[:, None] * constants.drift
        scaled = (1 + constants.joint_scale) * q
        return drifted + scaled + sine * np.sin(q) + cosine * np.cos(q)

    positions, times = measured.encoders.value, ideal.joint_rates.time
    np.testing.assert_allclose(positions, shown(ideal.encoders.time), atol=1e-15)
    assert (np.abs(positions - ideal.encoders.value).max(axis=0) > 1e-5).all()
    slopes = (shown(times + 1e-4) - shown(times - 1e-4)) / 2e-4 - constants.drift
    np.testing.assert_allclose(measured.joint_rates.value, slopes, atol=1e-8)


def test_joint_rates_have_no_errors_beside_those_of_the_encoders():
    for key in (*KEYS, "delay_ms", "clock_drift_ppm"):
        with pytest.raises(InputError, match=rf"here: joint_rates.{key} must be 0"):
            check_sensors(suite(joint_rates=JointSensor(**{key: 1.0})), "here")


@pytest.mark.parametrize("seed", [3, 4])
def test_a_clock_changes_stamps_and_no_samples(seed):
    """Stamps of some sensors are too late, those of others too early; all of them increase."""
    delays = []
    for name in DELAYS:
        ideal, measured, noise = pair(suite(), seed)
        punctual = suite()
        punctual[name].delay_ms = punctual[name].clock_drift_ppm = 0.0
        delays.append(noise.constants(name).delay)
        late = measured[name].time - ideal[name].time
        grown = noise.constants(name).clock_drift * ideal[name].time
        np.testing.assert_allclose(late - delays[-1], grown, atol=1e-15)
        assert (grown[1:] != 0).all()
        assert (np.diff(measured[name].time) > 0).all()
        same = add_noise(punctual, ideal, seed)[name]
        np.testing.assert_array_equal(same.value, measured[name].value)
        np.testing.assert_array_equal(same.time, ideal[name].time)
    assert min(delays) < 0 < max(delays)


@pytest.mark.parametrize("rate", [1.5, 50.0])
def test_an_integrating_gyro_gives_the_mean_rate_of_the_period_before(rate):
    """About a fixed axis, that is the turn since the sample before, divided by the period."""
    sensors = SensorSuite(gyro=Gyro(rate=rate, integrates=True), encoders=JointSensor())
    gyro = add_noise(sensors, ideal_log(sensors, JOINTS, motion, 4.0), 1).gyro
    assert gyro.time[0] == 1 / rate
    np.testing.assert_allclose(gyro.time, (1 + np.arange(len(gyro))) / rate, atol=1e-12)
    ends = motion(np.append(0.0, gyro.time)).quaternion_WB
    attitude = Rotation.from_quat(ends, scalar_first=True)
    turns = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    np.testing.assert_allclose(gyro.value, turns * rate, atol=2e-9)
