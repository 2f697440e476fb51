"""Simulated sensor errors.

Every sensor has its own stream of random numbers, which depends on the seed, the sensor and the
sample's number only: the same samples come out whether they are drawn one by one in a Diagram or
all at once as arrays.
"""

from dataclasses import replace
from numbers import Integral

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.suite import SENSOR_NAMES, SensorSuite

_STREAMS = (*SENSOR_NAMES, "gyro_bias", "phase encoders", "phase joint_rates")
"""What has random numbers of its own; the order is part of what a seed means."""


class SensorNoise:
    """The errors that a suite's sensors make, as functions of seed and sample number alone.

    Args:
        suite: the sensors.
        seed: a whole number >= 0. Streams differ from those of `numpy.random.default_rng(seed)`.

    Raises:
        InputError: another seed.

    """

    def __init__(self, suite: SensorSuite, seed: int) -> None:
        if not isinstance(seed, Integral) or seed < 0:
            raise InputError(f"a seed must be a whole number >= 0, not {seed!r}")
        self.suite, self.seed = suite, int(seed)
        self._tables: dict[str, NDArray[np.float64]] = {}
        self._walk = np.empty((0, 3))

    def gyro_bias(self, k: int) -> NDArray[np.float64]:
        """Return the gyro's bias (3,) at its sample k [rad/s]."""
        return self._bias(k + 1)[k]

    def apply(self, name: str, perfect: NDArray[np.float64], first: int = 0) -> NDArray[np.float64]:
        """Return samples first, first + 1, … of a sensor, from what they were without error.

        Args:
            name: of the sensor.
            perfect: (N, width) from `perfect_value`.
            first: number of the first sample.

        """
        sensor, digits = getattr(self.suite, name), self.suite.digits
        last = first + len(perfect)
        if name == "attitude":
            noise = self._normal(name, last, 3)[first:] * sensor.sigmas
            turn = Rotation.from_rotvec(noise @ sensor.R_BS.T)
            attitude = Rotation.from_quat(perfect, scalar_first=True) * turn
            if digits is not None:
                attitude = Rotation.from_euler("ZYX", np.round(attitude.as_euler("ZYX"), digits))
            return attitude.as_quat(scalar_first=True)
        value = perfect + sensor.sigma * self._normal(name, last, perfect.shape[1])[first:]
        if name == "gyro":
            value = value + self._bias(last)[first:]
        step = getattr(sensor, "step", 0.0)
        if step:
            phase = self._phase(name, perfect.shape[1])
            value = step * (np.round(value / step - phase) + phase)
        return value if digits is None else np.round(value, digits)

    def _bias(self, count: int) -> NDArray[np.float64]:
        """Return the gyro's biases at its first samples (count, 3): random start, random steps."""
        if len(self._walk) < count:
            gyro = self.suite.gyro
            steps = self._normal("gyro_bias", 2 * count, 3) * gyro.bias_growth / np.sqrt(gyro.rate)
            steps[0] = gyro.bias_sigma * self._normal("gyro_bias", 1, 3)[0]
            self._walk = np.cumsum(steps, axis=0)
        return self._walk[:count]

    def _phase(self, name: str, width: int) -> NDArray[np.float64]:
        """Return where between two of its marks every encoder has its zero, in steps.

        Else the same motion would be rounded alike whatever the seed.
        """
        stream = _STREAMS.index(f"phase {name}")
        sequence = np.random.SeedSequence(self.seed, spawn_key=(stream,))
        return np.random.default_rng(sequence).uniform(-0.5, 0.5, width)

    def _normal(self, name: str, count: int, width: int) -> NDArray[np.float64]:
        """Return the first `count` rows of a stream of its own, drawn in growing tables."""
        table = self._tables.get(name)
        if table is None or len(table) < count:
            sequence = np.random.SeedSequence(self.seed, spawn_key=(_STREAMS.index(name),))
            stream = np.random.default_rng(sequence)
            table = self._tables[name] = stream.standard_normal((max(64, 2 * count), width))
        return table[:count]


def add_noise(suite: SensorSuite, perfect: Measurements, seed: int) -> Measurements:
    """Return measurements with the errors that a suite's sensors make; the seed fixes them."""
    noise = SensorNoise(suite, seed)
    changed = {}
    for name in suite.present():
        samples = getattr(perfect, name)
        changed[name] = Samples(samples.time, noise.apply(name, samples.value))
    return replace(perfect, **changed)
