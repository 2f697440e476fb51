"""Simulated sensor errors.

Every sensor has its own stream of random numbers. It depends only on the seed, on the sensor's
number in the table and on the sample's number. Therefore a Diagram, which computes samples one by
one, and this module, which computes all samples at once, give the same samples, independent of the
other sensors.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import SENSORS, AttitudeSensor, Gyro
from cpid_drake.sensing.suite import SensorSuite


class SensorNoise:
    """The errors of a suite's sensors, as functions of seed and sample number alone.

    Args:
        suite: the sensors.
        seed: a whole number >= 0. Streams differ from those of `numpy.random.default_rng(seed)`.

    Raises:
        InputError: the seed is not such a number.

    """

    def __init__(self, suite: SensorSuite, seed: int) -> None:
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise InputError(f"a seed must be a whole number >= 0, not {seed!r}")
        self.suite = suite
        self.seed = int(seed)
        self._tables: dict[int, NDArray[np.float64]] = {}
        self._biases: dict[str, NDArray[np.float64]] = {}

    def apply(self, name: str, ideal: NDArray[np.float64], first: int = 0) -> NDArray[np.float64]:
        """Return samples first, first + 1, … of a sensor: ideal values with errors added.

        Args:
            name: name of the sensor.
            ideal: (N, width) ideal samples from `Quantity.ideal`.
            first: number of the first sample.

        """
        record, errors, decimals = SENSORS[name], self.suite[name], self.suite.rounding
        last, width = first + len(ideal), ideal.shape[1]
        if isinstance(errors, AttitudeSensor):
            noise = self._normal(record.stream, last, 3)[first:] * errors.sigmas
            error = Rotation.from_rotvec(noise @ errors.R_BS.T)
            attitude = Rotation.from_quat(ideal, scalar_first=True) * error
            if decimals is not None:
                attitude = Rotation.from_euler("ZYX", np.round(attitude.as_euler("ZYX"), decimals))
            return np.asarray(attitude.as_quat(scalar_first=True))
        value = ideal + errors.sigmas * self._normal(record.stream, last, width)[first:]
        if isinstance(errors, Gyro):
            value = value + self.gyro_bias(last, name)[first:]
        if errors.step and record.slow_stream is not None:
            # With a random zero, rounding errors of the same motion differ from seed to seed.
            zero = self._generator(record.slow_stream).uniform(-0.5, 0.5, width)
            value = errors.step * (np.round(value / errors.step - zero) + zero)
        return value if decimals is None else np.round(value, decimals)

    def gyro_bias(self, count: int, name: str = "gyro") -> NDArray[np.float64]:
        """Return the biases of a gyro's first `count` samples, (count, 3) in B [rad/s].

        The first is drawn with the σ of the constant part; each later one adds a random step.
        """
        table = self._biases.get(name, np.empty((0, 3)))
        gyro, stream = self.suite[name], SENSORS[name].slow_stream
        if len(table) < count and isinstance(gyro, Gyro) and stream is not None:
            steps = self._normal(stream, 2 * count, 3) * gyro.bias_growth / np.sqrt(gyro.rate)
            steps[0] = gyro.bias_sigma * self._normal(stream, 1, 3)[0]
            table = self._biases[name] = np.cumsum(steps, axis=0)
        return table[:count]

    def _generator(self, stream: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(stream,)))

    def _normal(self, stream: int, count: int, width: int) -> NDArray[np.float64]:
        """Return the first `count` rows of a stream, drawn in tables of growing length."""
        table = self._tables.get(stream)
        if table is None or len(table) < count:
            numbers = self._generator(stream).standard_normal((max(64, 2 * count), width))
            table = self._tables[stream] = numbers
        return table[:count]


def add_noise(suite: SensorSuite, ideal: Measurements, seed: int) -> Measurements:
    """Return measurements with the errors of a suite's sensors; the seed determines them."""
    noise = SensorNoise(suite, seed)
    return ideal.updated(
        {
            name: Samples(ideal[name].time, noise.apply(name, ideal[name].value))
            for name in suite.present()
        }
    )
