"""Sensors from presets and files: all presets load, and bad files are refused in one line."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from cpid_drake import InputError
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.sensors import AttitudeSensor

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


# -- files ---------------------------------------------------------------------------------------


def test_what_a_file_leaves_out_is_not_there_or_as_by_default(write):
    suite = load_sensors(write("encoders: {bits: 14}\nattitude: {boresight_B: [1, 0, 0]}\n"))
    assert tuple(suite.present()) == ("attitude", "encoders")
    assert suite.attitude.rate == AttitudeSensor().rate
    np.testing.assert_array_equal(suite.attitude.R_BS[:, 2], [1.0, 0.0, 0.0])
    assert suite.encoders.bits == 14


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["", "FLIGHT"])
def test_an_unknown_preset_is_answered_with_the_names(name):
    assert f"choose from {', '.join(PRESETS)}" in refusal(name)
