"""Sensors from presets and files: all presets load, and bad files are refused in one line."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from cpid_drake import InputError
from cpid_drake.resources import models_directory
from cpid_drake.sensing.presets import load_sensors, sensor_presets
from cpid_drake.sensing.sensors import SENSORS, AttitudeSensor

PRESETS = (
    *("air_bearing", "coarse", "digits6", "flight", "flight_thrust"),
    *("ideal", "orbit", "servicer", "testbed"),
)


@pytest.fixture
def write(tmp_path):
    def make(content) -> Path:
        path = tmp_path / "sensors.yaml"
        if isinstance(content, dict):
            content = yaml.safe_dump(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def refusal(path) -> str:
    with pytest.raises(InputError) as caught:
        load_sensors(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


# -- presets -------------------------------------------------------------------------------------


def test_the_presets_are_these():
    assert sensor_presets() == PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_loads_and_says_what_it_is_and_where_from(name):
    suite = load_sensors(name)
    assert suite.encoders is not None
    assert suite.attitude is not None
    assert 10 < len(suite.description) < 100
    text = (models_directory() / "sensors" / f"{name}.yaml").read_text()
    assert text.startswith("# ")
    if name not in ("ideal", "digits6"):
        assert "our choice" in text
        assert suite.velocity is None
        assert suite.joint_rates is None
        for sensor in suite.present():  # every sensor has its line of sources
            assert re.search(rf"^# - {sensor}[,:]", text, re.MULTILINE)


def test_presets_get_worse_in_this_order():
    order = ("ideal", "flight", "servicer", "coarse")
    for name in ("attitude", "gyro", "position", "encoders"):
        sigmas = np.array([load_sensors(preset).sigmas(name).max() for preset in order])
        assert (np.diff(sigmas) > 0).all()


@pytest.mark.parametrize(("name", "digits"), [("ideal", None), ("digits6", 6)])
def test_presets_without_noise_have_all_sensors_at_one_rate(name, digits):
    suite = load_sensors(name)
    assert tuple(suite.present()) == tuple(SENSORS)
    assert {sensor.rate for sensor in suite.present().values()} == {100.0}
    assert suite.digits == digits
    floor = 1e-8 if digits is None else 1e-6 / np.sqrt(12)
    for sensor in SENSORS:
        np.testing.assert_allclose(suite.sigmas(sensor), floor, rtol=1e-2)


# -- files ---------------------------------------------------------------------------------------


def test_what_a_file_leaves_out_is_not_there_or_as_by_default(write):
    suite = load_sensors(write("encoders: {bits: 14}\nattitude: {boresight_B: [1, 0, 0]}\n"))
    assert tuple(suite.present()) == ("attitude", "encoders")
    assert suite.attitude.rate == AttitudeSensor().rate
    np.testing.assert_array_equal(suite.attitude.R_BS[:, 2], [1.0, 0.0, 0.0])
    assert suite.encoders.bits == 14


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["", "fligth", "FLIGHT", "models/sensors/flight"])
def test_an_unknown_preset_is_answered_with_the_names(name):
    assert f"choose from {', '.join(PRESETS)}" in refusal(name)


@pytest.mark.parametrize(
    "path", ["nowhere.yaml", ".", "package://nobody/a.yaml", "http://a/b.yaml"]
)
def test_what_is_no_file_is_refused(path):
    assert path in refusal(path)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "- encoders",
        "encoders: [1",
        "encoders: yes",
        "encoders: !JointSensor {}",
        "encoders: {}\n---\nencoders: {}",
        bytes(range(256)),
        "encoders: " + 3000 * "[" + 3000 * "]",
    ],
    ids=range(8),
)
def test_what_is_no_suite_is_refused(write, content):
    assert "sensors.yaml" in refusal(write(content))


@pytest.mark.parametrize(
    ("content", "key", "choices"),
    [
        ("encoders: {}\nstar_tracker: {}", "star_tracker", "attitude, gyro, position"),
        ("encoders: {}\ngyro: {arw: 1}", "gyro.arw", "rate, delay_ms, dropouts"),
        ("encoders: {resolution: 3}", "encoders.resolution", "dropout_length, sigma, bits"),
        ("encoders: {}\nvelocity: {bits: 3}", "velocity.bits", "dropout_length, sigma"),
        ("encoders: {}\ngyro: {_tag: '!Gyro'}", "gyro._tag", "dropout_length, angle_random_walk"),
    ],
)
def test_an_unknown_key_is_answered_with_the_choices(write, content, key, choices):
    message = refusal(write(content))
    assert f"sensors.yaml: unknown key '{key}'; choose from " in message
    assert choices in message


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gyro.rate", 0),
        ("gyro.rate", np.nan),
        ("gyro.rate", "fast"),
        ("gyro.rate", True),
        ("gyro.bias", -1.0),
        ("attitude.boresight_B", [0, 0, 0]),
        ("attitude.boresight_B", [0, 1]),
        ("position.sigma", -1e-3),
        ("encoders.bits", 33),
        ("encoders.bits", 16.5),
        ("digits", 16),
        ("digits", True),
    ],
)
def test_a_value_that_cannot_be_is_refused_by_file_and_key(write, key, value):
    content = {"encoders": {}}
    section, _, entry = key.rpartition(".")
    if section:
        content[section] = {entry: value}
    else:
        content[entry] = value
    message = refusal(write(content))
    assert "sensors.yaml: " in message
    assert key.rpartition(".")[2] in message
