"""Simulated sensor errors.

Every sensor has its own stream of random numbers. It depends only on the seed, on the sensor's
number in the table and on the sample's number. Therefore a Diagram, which computes samples one by
one, and this module, which computes all samples at once, give the same samples, independent of the
other sensors. The errors that are the same in all samples are in `constant_errors`.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.motion import Motion
from cpid_drake.errors import InputError
from cpid_drake.logs.log import (
    THRUST,
    Log,
    Samples,
    first_sample,
)
from cpid_drake.sensors.constant_errors import (
    KINDS,
    ConstantErrors,
    draw_constant_errors,
    random_stream,
)
from cpid_drake.sensors.disturbances import SimulatedDisturbance
from cpid_drake.sensors.sensors import JOINT_RATES, SENSORS, AttitudeSensor, Gyro
from cpid_drake.sensors.suite import SensorSuite


class SensorNoise:
    """The errors of a suite's sensors, as functions of seed and sample number alone.

    Args:
        suite: the sensors.
        seed: a whole number >= 0. Streams differ from those of `numpy.random.default_rng(seed)`.
        hardware_seed: seed of the sensors' constant errors: runs with the same one have the same
            sensors. Default: `seed`.

    Raises:
        InputError: a seed is not such a number.

    """

    def __init__(self, suite: SensorSuite, seed: int, hardware_seed: int | None = None) -> None:
        for each in (seed, 0 if hardware_seed is None else hardware_seed):
            if not isinstance(each, int | np.integer) or each < 0:
                raise InputError(f"a seed must be a whole number >= 0, not {each!r}")
        self.suite = suite
        self.seed = int(seed)
        self._hardware_seed = self.seed if hardware_seed is None else int(hardware_seed)
        self._tables: dict[int, NDArray[np.float64]] = {}
        self._biases: dict[str, NDArray[np.float64]] = {}
        self._constants: dict[tuple[str, int], ConstantErrors] = {}
        self._lost: dict[str, NDArray[np.bool_]] = {}

    def constants(self, name: str, joint_count: int = 0) -> ConstantErrors:
        """Return the values of a sensor's constant errors.

        Joint rates have the delay of the encoders, to whose clock they belong.

        Args:
            name: name of the sensor.
            joint_count: number of joints; only the zeros of joints depend on it.

        Raises:
            KeyError: the sensor is absent.

        """
        key = name, joint_count
        if key not in self._constants:
            sensor, errors = SENSORS[name], self.suite[name]
            drawn = draw_constant_errors(sensor, errors, self._hardware_seed, joint_count)
            if sensor.quantity is JOINT_RATES and self.suite.encoders is not None:
                drawn = replace(drawn, delay=self.constants("encoders").delay)
            self._constants[key] = drawn
        return self._constants[key]

    def apply(
        self,
        name: str,
        ideal: NDArray[np.float64],
        first: int = 0,
        motion: Motion | None = None,
    ) -> NDArray[np.float64]:
        """Return samples first, first + 1, … of a sensor: ideal values with errors added.

        A delay does not change the samples. It belongs to their stamps, see `constants`.

        Args:
            name: name of the sensor.
            ideal: (N, width) ideal samples from `Quantity.ideal`.
            first: number of the first sample.
            motion: the true motion at the N samples; only sensors with a lever arm need it.

        Raises:
            KeyError: the sensor is absent.
            InputError: a lever arm without the true motion.

        """
        record, errors, decimals = SENSORS[name], self.suite[name], self.suite.decimals
        last, width = first + len(ideal), ideal.shape[1]
        ideal = self.constants(name, width).change(record, ideal, motion)
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
            zero = random_stream(self.seed, record.slow_stream).uniform(-0.5, 0.5, width)
            value = errors.step * (np.round(value / errors.step - zero) + zero)
        return value if decimals is None else np.round(value, decimals)

    def is_lost(self, name: str, count: int) -> NDArray[np.bool_]:
        """Return whether the first `count` samples of a sensor are lost in a dropout, (count,).

        Dropouts begin and end at random: their starts are a Poisson process, their durations have
        an exponential distribution, both at the instants of samples.
        """
        errors, table = self.suite[name], self._lost.get(name, np.zeros(0, dtype=bool))
        if not errors.dropouts:
            return np.zeros(count, dtype=bool)
        if len(table) < count:
            starts = errors.dropouts / (60 * errors.rate)
            ends = 1 / (errors.dropout_length * errors.rate)
            stream = random_stream(self.seed, SENSORS[name].stream, KINDS.index("dropouts"))
            numbers = stream.random(max(64, 2 * count))
            lost, states = False, []
            for number in numbers:
                lost = number >= ends if lost else number < starts
                states.append(lost)
            table = self._lost[name] = np.array(states)
        return table[:count]

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

    def _normal(self, stream: int, count: int, width: int) -> NDArray[np.float64]:
        """Return the first `count` rows of a stream, drawn in tables of growing length."""
        table = self._tables.get(stream)
        if table is None or len(table) < count:
            numbers = random_stream(self.seed, stream).standard_normal((max(64, 2 * count), width))
            table = self._tables[stream] = numbers
        return table[:count]


def add_noise(suite: SensorSuite, ideal: Log, seed: int, hardware_seed: int | None = None) -> Log:
    """Return a log with the errors of a suite's sensors; the seed determines them.

    Args:
        suite: the sensors.
        ideal: samples without errors, and the true thrust. If a sensor has a lever arm, they must
            be those that `ideal_log` returned for this suite.
        seed: a whole number >= 0.
        hardware_seed: seed of the sensors' constant errors; default: `seed`.

    Raises:
        InputError: a seed is not such a number, or the motion that a lever arm needs is missing.

    """
    noise, joints = SensorNoise(suite, seed, hardware_seed), len(ideal.joint_names)
    samples = {}
    for name, errors in suite.present().items():
        exact, first = ideal[name], first_sample(errors)
        value = noise.apply(name, exact.value, first, ideal.motion.get(name))
        stamped = Samples(exact.time + noise.constants(name, joints).delay, value)
        samples[name] = stamped.where(~noise.is_lost(name, first + len(exact))[first:])
    if THRUST in ideal.samples:  # the true thrust is the logged one, times one plus the error
        scale = 1 + SimulatedDisturbance(suite.disturbances, seed).thrust_scale
        samples[THRUST] = Samples(ideal.thrust.time, ideal.thrust.value / scale)
    return ideal.updated(samples)
