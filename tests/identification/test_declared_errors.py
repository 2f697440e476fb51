"""Errors of sensors that are much larger than declared are a doubt."""

from dataclasses import replace

import pytest
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import identify
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor

DOUBT = "times as large as their declared sigma"


def suite_of(factor=1.0):
    """Return sensors whose declared errors have `factor` times their usual σ."""
    usual = coarse_suite()
    assert isinstance(usual.attitude, AttitudeSensor)
    assert isinstance(usual.gyro, Gyro)
    assert isinstance(usual.encoders, JointSensor)
    return coarse_suite(
        attitude=replace(usual.attitude, mounting_arcsec=200.0 * factor),
        gyro=replace(usual.gyro, scale_ppm=500.0 * factor),
        encoders=replace(usual.encoders, zero_mrad=0.5 * factor),
    )


@pytest.fixture(scope="module")
def log(craft, skewed_target):
    """Returns samples whose errors are drawn with `factor` times their usual σ."""
    motion = Sines.drawn(4, seed=101, duration=6.0, size=0.6)
    ideal = measured(craft, motion, skewed_target, suite_of())

    def samples(factor, seed):
        return add_noise(suite_of(factor), ideal, seed)

    return samples


def test_errors_much_larger_than_declared_are_a_doubt(craft, log):
    found = identify(craft, log(6.0, 2), sensors=suite_of())
    (text,) = [failure for failure in found.failures if DOUBT in failure]
    factor = float(text.split("about ")[1].split(" times")[0])
    assert 3.0 < factor < 12.0
    assert "declare what the hardware can have" in text
    told = identify(craft, log(6.0, 2), sensors=suite_of(6.0))
    assert not any(DOUBT in failure for failure in told.failures)
