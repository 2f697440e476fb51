"""Sensors added from outside, by records in the table, are used by `cpid identify` and shown."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InputError, load_sensors
from cpid_drake.sensing.noise import SensorNoise
from cpid_drake.sensing.sensors import (
    ANGULAR_VELOCITY,
    ATTITUDE,
    JOINT_POSITIONS,
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    Sensor,
    register_sensor,
)

DURATION = 6.0
GYRO = Sensor(
    "gyro_2",
    "second gyro",
    ANGULAR_VELOCITY,
    Gyro,
    ("gx", "gy", "gz"),
    stream=20,
    slow_stream=21,
)
TRACKER = Sensor(
    "tracker_2", "second star tracker", ATTITUDE, AttitudeSensor, ("sw", "sx", "sy", "sz"), 22
)
MOTOR = Sensor("motor", "motor positions", JOINT_POSITIONS, JointSensor, ("m:",), 23, 24)
ADDED = (GYRO, TRACKER, MOTOR)

SUITE = """
attitude: {rate: 2.0, cross_boresight_arcsec: 20.0, boresight_arcsec: 60.0}
gyro: {rate: 20.0, angle_random_walk: 0.02, bias: 2.0, bias_random_walk: 1.0}
position: {rate: 5.0, sigma: 0.002}
encoders: {rate: 20.0, sigma: 2.0e-5}
"""
SUITE_OF_ALL = (
    SUITE
    + """
gyro_2: {rate: 10.0, angle_random_walk: 0.001, bias: 1.0, bias_random_walk: 0.1}
tracker_2: {rate: 5.0, cross_boresight_arcsec: 2.0, boresight_arcsec: 2.0}
motor: {rate: 20.0, sigma: 1.0e-6}
"""
)


@pytest.fixture
def added():
    """Register the sensors for one test."""
    for sensor in ADDED:
        register_sensor(sensor)
    yield
    for sensor in ADDED:
        del SENSORS[sensor.name]


def test_added_sensors_leave_the_samples_of_the_others_as_they_are(tmp_path, added):
    """The numbers of these samples are a promise: they were the same before there was a table."""
    (tmp_path / "all.yaml").write_text(SUITE_OF_ALL)
    (tmp_path / "one_of_each.yaml").write_text(SUITE)
    samples = {}
    for name in ("all", "one_of_each"):
        suite = load_sensors(tmp_path / f"{name}.yaml")
        ideal = {key: np.eye(SENSORS[key].width(2))[:1].repeat(9, 0) for key in suite.present()}
        noise = SensorNoise(suite, seed=5)
        samples[name] = {key: noise.apply(key, value) for key, value in ideal.items()}
    assert set(samples["all"]) - set(samples["one_of_each"]) == {s.name for s in ADDED}
    for key, value in samples["one_of_each"].items():
        np.testing.assert_array_equal(samples["all"][key], value)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"name": "gyro"}, "that no other sensor has"),
        ({"stream": 1}, "random streams"),
        ({"columns": ("bwx", "gy", "gz")}, "the column 'bwx' is that of another sensor"),
        ({"columns": ("gx", "gy")}, "2 columns for angular velocity"),
        ({"slow_stream": None}, "need a slow_stream"),
        ({"errors": JointSensor}, "errors must be"),
    ],
)
def test_a_record_that_would_harm_the_others_is_refused(changes, problem):
    before = dict(SENSORS)
    with pytest.raises(InputError, match=problem):
        register_sensor(replace(GYRO, **changes))
    assert before == SENSORS
