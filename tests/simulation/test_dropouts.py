"""Dropouts of simulated sensors: how often samples are lost, and for how long."""

import numpy as np
import pytest

from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, VectorSensor
from cpid_drake.sensors.suite import SensorSuite


@pytest.mark.parametrize("rate", [5.0, 20.0])
def test_dropouts_have_the_given_frequency_and_length(rate):
    """4 per minute of 3 s each: 1/60 per second of the time in which samples arrive."""
    position = VectorSensor(rate, 1e-3, dropouts=4.0, dropout_length=3.0)
    lost = SensorNoise(SensorSuite(position=position), 1).is_lost("position", 400_000)
    starts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
    assert starts / (np.count_nonzero(~lost) / rate) == pytest.approx(4 / 60, rel=0.07)
    assert np.count_nonzero(lost) / rate / starts == pytest.approx(3.0, rel=0.07)


def test_lost_samples_are_absent_and_the_others_unchanged():
    time = np.arange(200) / 5.0
    ideal = Log(("a",), {"position": Samples(time, np.zeros((200, 3)))})
    samples = []
    for dropouts in (0.0, 20.0):
        position = VectorSensor(5.0, 1e-3, dropouts=dropouts)
        samples.append(add_noise(SensorSuite(position=position), ideal, 2).position)
    whole, rest = samples
    assert 50 < len(rest) < 190
    kept = np.isin(whole.time, rest.time)
    np.testing.assert_array_equal(whole.value[kept], rest.value)


def test_every_sensor_has_dropouts_of_its_own_independent_of_the_order_of_asking():
    suite = SensorSuite(attitude=AttitudeSensor(5.0, dropouts=10.0), gyro=Gyro(5.0, dropouts=10.0))
    one, other = SensorNoise(suite, 3), SensorNoise(suite, 3)
    late = one.is_lost("gyro", 900)
    early = np.array([other.is_lost("gyro", k + 1)[k] for k in range(900)])
    np.testing.assert_array_equal(late, early)
    assert (late != one.is_lost("attitude", 900)).any()
