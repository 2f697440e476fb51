"""Samples in other units or axes than stated are named before any fit, as a log's are."""

import numpy as np
import pytest

from cpid_drake import InputError, OnlineIdentifier, identify, load_spacecraft, read_log
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.log import Samples

DEGREES = 180 / np.pi
WRONG = {
    "the angular velocity is in degrees per second": ("gyro", lambda x: DEGREES * x),
    "q of all turning joints is in degrees": ("encoders", lambda x: DEGREES * x),
    "q:arm_joint2 has the opposite sign": ("encoders", lambda x: x * [1, -1, 1, 1]),
    "the position is in millimetres": ("position", lambda x: 1000 * x),
    "the attitude is that of R_BW": ("attitude", lambda x: x * [1, -1, -1, -1]),
    "the quaternion is in the order x, y, z, w": ("attitude", lambda x: x[:, [1, 2, 3, 0]]),
}


@pytest.fixture(scope="module")
def craft():
    return load_spacecraft("free_flyer_payload").make()


@pytest.fixture(scope="module")
def log():
    return read_log(models_directory() / "telemetry/free_flyer.csv")


def changed(log, sensor, change):
    samples = log[sensor]
    return log.updated({sensor: Samples(samples.time, change(samples.value))})


@pytest.mark.parametrize("text", WRONG)
def test_it_is_named_in_the_first_seconds(craft, log, text):
    identifier, wrong = OnlineIdentifier(craft, "testbed"), changed(log, *WRONG[text])
    for message in wrong.between(0.0, 4.0).messages():
        identifier.add(*message)
    result = identifier.estimate()
    assert any(failure.startswith(text) for failure in result.failures)
    assert np.isnan(result.parameters).all()
    assert result.rejected["encoders"] > 250  # of 3 s
    with pytest.raises(InputError, match=text):
        identify(craft, wrong, sensors="testbed")


def test_it_stays_named_at_the_end(craft, log):
    sensor, change = WRONG["the angular velocity is in degrees per second"]
    identifier = OnlineIdentifier(craft, "testbed")
    for message in changed(log, sensor, change).messages():
        identifier.add(*message)
    result = identifier.finish()
    assert not result.passed
    counts = {name: len(samples) for name, samples in log.items() if len(samples)}
    assert result.rejected == counts


def test_samples_that_only_begin_to_agree_are_all_used(craft, log):
    """Of two seconds with a loud gyro, no comparison decides; all samples count in the end."""
    rng = np.random.default_rng(1)
    loud = changed(log, "gyro", lambda x: x + 0.05 * rng.standard_normal(x.shape))
    identifier = OnlineIdentifier(craft, "testbed")
    for message in loud.between(0.0, 2.2).messages():
        identifier.add(*message)
    result = identifier.finish()
    assert result.sample_count + sum(result.rejected.values()) == sum(
        len(samples) for _, samples in loud.between(0.0, 2.2).items()
    )


def test_a_log_of_thrust_is_no_contradiction(craft, log):
    """A valve that opens at the end; each block knows what holds at its start."""
    identifier = OnlineIdentifier(craft, "testbed", reads_thrust=True)
    thrust = [("thrust", time, np.zeros(6)) for time in (0.0, 0.73, 1.83, 2.61)]
    part = log.between(0.0, 5.0)
    for message in sorted([*part.messages(), *thrust], key=lambda each: each[1]):
        identifier.add(*message)
    result = identifier.finish()
    assert result.passed
    assert np.isfinite(result.parameters).all()
