"""Sensors added from outside, by records in the table, are used by `cpid identify` and shown."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sensing_cases import Sines, small_craft, true_telemetry

from cpid_drake import InertialParameters, InputError, load_sensors, write_telemetry
from cpid_drake.sensing.measurements import ideal_measurements
from cpid_drake.sensing.noise import SensorNoise, add_noise
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


@pytest.fixture
def case(tmp_path, monkeypatch, added):
    """Write a log and the YAML of its sensors; return the options of `cpid identify`."""
    monkeypatch.chdir(tmp_path)
    craft = small_craft(tmp_path)
    motion = Sines.drawn(4, seed=7, duration=DURATION, size=0.6)
    target = InertialParameters(60.0, [0.5, -0.12, 0.08], np.diag([8.0, 11.0, 6.0]))
    (tmp_path / "one_of_each.yaml").write_text(SUITE)
    (tmp_path / "all.yaml").write_text(SUITE_OF_ALL)
    suite = load_sensors("all.yaml")
    names = craft.joint_names
    ideal = ideal_measurements(
        suite,
        names,
        lambda times: true_telemetry(craft.tree, names, motion, target, times),
        DURATION,
    )
    write_telemetry("log.csv", add_noise(suite, ideal, seed=3))
    options = ("--spacecraft", tmp_path / "craft.urdf", "--base", "base", "--capture-frame", "hand")
    return target, ("identify", "log.csv", *options, "--json", "found.json")


def found(outcome, target):
    """Return the σ of the ten parameters; the error must be explained by them."""
    code, _, stderr = outcome
    assert code == 0, stderr
    result = json.loads(Path("found.json").read_text())
    covariance = np.array(result["covariance"])
    error = result["parameters"] - target.to_vector()
    assert error @ np.linalg.solve(covariance, error) < 30  # χ² with 10 degrees of freedom
    return np.sqrt(np.diag(covariance))


@pytest.mark.slow
def test_added_sensors_make_the_fit_better_and_are_in_its_report(case, run_cpid):
    target, command = case
    less = found(run_cpid(*command, "--sensors", "one_of_each.yaml"), target)
    more = found(run_cpid(*command, "--sensors", "all.yaml", "--report", "page.html"), target)
    assert (more < 0.5 * less).all()
    page = Path("page.html").read_text()
    assert all(sensor.label in page for sensor in ADDED)
    code, contents, _ = run_cpid("telemetry", "check", "log.csv")
    assert code == 0
    assert all(sensor.label in contents for sensor in ADDED)


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
