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


def test_units_of_a_laboratory_are_those_of_data_sheets(write):
    lab = {
        "attitude": {"rate": 100, "noise_deg": 0.05},
        "gyro": {"rate": 200, "noise_deg_per_s": 0.03, "bias_deg_per_s": 0.5},
        "position": {"rate": 100, "sigma_mm": 0.5},
        "encoders": {"rate": 100, "sigma_deg": 0.006},
    }
    sheets = {
        "attitude": {"rate": 100, "cross_boresight_arcsec": 180, "boresight_arcsec": 180},
        "gyro": {"rate": 200, "angle_random_walk": 0.1272792, "bias": 1800},
        "position": {"rate": 100, "sigma": 5e-4},
        "encoders": {"rate": 100, "sigma": 1.0471976e-4},
    }
    one = load_sensors(write(lab))
    other = load_sensors(write(sheets))
    for name in lab:
        np.testing.assert_allclose(one.sigmas(name), other.sigmas(name), rtol=1e-6)
    assert one.gyro.bias_sigma == pytest.approx(np.radians(0.5))
    assert np.degrees(one.gyro.sigma) == pytest.approx(0.03)  # of one sample at this rate


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("attitude: {noise_deg: 0.1, boresight_arcsec: 20}", "give noise_deg or cross_boresight_"),
        ("gyro: {bias_deg_per_s: 0.1, bias: 20}", "give bias_deg_per_s or bias, not both"),
        ("position: {sigma_mm: -1}", "position.sigma_mm must be"),
    ],
)
def test_an_error_in_both_units_is_refused(write, keys, message):
    assert message in refusal(write(keys + "\n"))
