"""Simulated sensor errors.

Every sensor has its own stream of random numbers. It depends only on the seed, on the sensor's
number in the table and on the sample's number. Therefore a Diagram, which computes samples one by
one, and this module, which computes all samples at once, give the same samples, independent of the
other sensors.
"""

from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import THRUST, Log, Samples, first_sample
from cpid_drake.sensors.sensors import (
    ARCSECOND,
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    VectorSensor,
)
from cpid_drake.sensors.simulated_disturbance import SimulatedDisturbance, random_stream
from cpid_drake.sensors.suite import SensorSuite

_KINDS = (
    *("delay", "mounting", "scale", "misalignment", "lever_arm", "zero", "dropouts", "drift"),
    *("clock_drift", "joint_scale", "eccentricity"),
)
"""What has a random stream of its own for each sensor; a place is the second number of its key."""

Time = TypeVar("Time", float, Array)

_STREAMS = {name: k for k, name in enumerate(SENSORS)}
"""The streams of white noise."""

_SLOW_STREAMS = {"gyro": 6, "encoders": 7, "joint_rates": 8}
"""The streams of a gyro's bias, and of the place of an encoder's steps."""


@dataclass(frozen=True, eq=False)
class ConstantErrors:
    """Values of one sensor's constant errors; those that a sensor cannot have are zero.

    Attributes:
        delay: stamp minus true time of a sample, at 0 s [s].
        clock_drift: rate of the delay.
        mounting_B: (3,) rotation vector ε in B: the measured attitude is R_WB Exp(ε) [rad].
        scale: (3, 3) matrix S: the measured angular velocity is (1 + S) ω. Its diagonal has the
            errors of the axes' scales, its other entries those of their directions.
        lever_arm_B: (3,) position in B of the measured point, from B's origin [m].
        zero: (J,) measured minus true joint positions [rad or m].
        drift: (J,) rate of the zero, which is right at 0 s [rad/s or m/s].
        joint_scale: (J,) share of a joint's position or rate that is measured too much.
        eccentricity: (2, J) error where the sine, and where the cosine, of a joint is 1 [rad or m].

    """

    delay: float = 0.0
    clock_drift: float = 0.0
    mounting_B: Array = field(default_factory=lambda: np.zeros(3))
    scale: Array = field(default_factory=lambda: np.zeros((3, 3)))
    lever_arm_B: Array = field(default_factory=lambda: np.zeros(3))
    zero: Array = field(default_factory=lambda: np.zeros(1))
    drift: Array = field(default_factory=lambda: np.zeros(1))
    joint_scale: Array = field(default_factory=lambda: np.zeros(1))
    eccentricity: Array = field(default_factory=lambda: np.zeros((2, 1)))

    def stamp(self, time: Time) -> Time:
        """Return the stamp [s] of a sample at a time [s]."""
        return time + self.delay + self.clock_drift * time


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
        self._tables: dict[int, Array] = {}
        self._biases = np.empty((0, 3))
        self._constants: dict[tuple[str, int], ConstantErrors] = {}
        self._lost: dict[str, NDArray[np.bool_]] = {}

    def constants(self, name: str, joint_count: int = 0) -> ConstantErrors:
        """Return the values of a sensor's constant errors.

        Every error has its own stream, so that it does not change the values of the others. Joint
        rates are those of the encoders: they have their clock and their scales. Only the errors of
        joints depend on their number.

        Raises:
            KeyError: the sensor is absent.

        """
        key = name, joint_count
        if key not in self._constants:
            self._constants[key] = self._drawn(name, joint_count)
        return self._constants[key]

    def _drawn(self, name: str, joint_count: int) -> ConstantErrors:
        errors = self.suite[name]

        def normal(kind: str, *shape: int) -> Array:
            stream = random_stream(self.seed, _STREAMS[name], _KINDS.index(kind))
            return stream.standard_normal(shape)

        delay = (errors.delay_ms or 0.0) * 1e-3 * float(normal("delay", 1)[0])
        fast = (errors.clock_drift_ppm or 0.0) * 1e-6 * float(normal("clock_drift", 1)[0])
        drawn = ConstantErrors(delay, fast)
        if isinstance(errors, AttitudeSensor):
            mounting = (errors.mounting_arcsec or 0.0) * ARCSECOND * normal("mounting", 3)
            return replace(drawn, mounting_B=mounting)
        if isinstance(errors, Gyro):
            scale = (errors.misalignment_arcsec or 0.0) * ARCSECOND * normal("misalignment", 3, 3)
            np.fill_diagonal(scale, (errors.scale_ppm or 0.0) * 1e-6 * normal("scale", 3))
            return replace(drawn, scale=scale)
        if isinstance(errors, VectorSensor):
            arm = (errors.lever_arm_mm or 0.0) * 1e-3 * normal("lever_arm", 3)
            return replace(drawn, lever_arm_B=arm)
        if name == "encoders" and isinstance(errors, JointSensor):
            zero = (errors.zero_mrad or 0.0) * 1e-3 * normal("zero", joint_count)
            drift = (errors.drift_mrad_per_s or 0.0) * 1e-3 * normal("drift", joint_count)
            scale = (errors.joint_scale_ppm or 0.0) * 1e-6 * normal("joint_scale", joint_count)
            turn = (errors.eccentricity_mrad or 0.0) * 1e-3 * normal("eccentricity", 2, joint_count)
            return replace(drawn, zero=zero, drift=drift, joint_scale=scale, eccentricity=turn)
        if self.suite.encoders is None:
            return drawn
        return replace(self.constants("encoders", joint_count), zero=np.zeros(1), drift=np.zeros(1))

    def apply(self, name: str, ideal: Array, first: int = 0, motion: Motion | None = None) -> Array:
        """Return samples first, first + 1, … of a sensor: ideal values with errors added.

        A clock does not change the samples. It belongs to their stamps, see `constants`.

        Args:
            name: name of the sensor.
            ideal: (N, width) ideal samples from `Sensor.ideal`.
            first: number of the first sample.
            motion: the true motion at the N samples; only sensors with a lever arm need it, and
                joint rates of encoders that have an error once a turn.

        Raises:
            KeyError: the sensor is absent.
            InputError: such a sensor without the true motion.

        """
        errors, decimals, stream = self.suite[name], self.suite.decimals, _STREAMS[name]
        last, width = first + len(ideal), ideal.shape[1]
        constant = self.constants(name, width)
        if isinstance(errors, AttitudeSensor):
            noise = self._normal(stream, last, 3)[first:] * errors.sigmas
            error = Rotation.from_rotvec(noise @ errors.R_BS.T)
            attitude = Rotation.from_quat(ideal, scalar_first=True)
            attitude = attitude * Rotation.from_rotvec(constant.mounting_B) * error
            if decimals is not None:
                attitude = Rotation.from_euler("ZYX", np.round(attitude.as_euler("ZYX"), decimals))
            return np.asarray(attitude.as_quat(scalar_first=True))
        value = ideal + errors.sigmas * self._normal(stream, last, width)[first:]
        if isinstance(errors, Gyro):
            value += ideal @ constant.scale.T + self.gyro_bias(last)[first:]
        elif constant.lever_arm_B.any():
            true = _needed(motion, name, "lever arm")
            arm_W = true.R_WB @ constant.lever_arm_B
            value += arm_W if name == "position" else np.cross(true.w_WB, arm_W)
        elif isinstance(errors, JointSensor):
            time = np.arange(first, last)[:, None] / errors.rate
            sine, cosine = constant.eccentricity
            value += constant.zero + time * constant.drift + constant.joint_scale * ideal
            if name == "encoders":
                value += sine * np.sin(ideal) + cosine * np.cos(ideal)
            elif constant.eccentricity.any():
                q = _needed(motion, name, "error once a turn").q
                value += (sine * np.cos(q) - cosine * np.sin(q)) * ideal
        if errors.step:
            # With a random zero, rounding errors of the same motion differ from seed to seed.
            zero = random_stream(self.seed, _SLOW_STREAMS[name]).uniform(-0.5, 0.5, width)
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
            stream = random_stream(self.seed, _STREAMS[name], _KINDS.index("dropouts"))
            numbers = stream.random(max(64, 2 * count))
            lost, states = False, []
            for number in numbers:
                lost = number >= ends if lost else number < starts
                states.append(lost)
            table = self._lost[name] = np.array(states)
        return table[:count]

    def gyro_bias(self, count: int) -> Array:
        """Return the biases of a gyro's first `count` samples, (count, 3) in B [rad/s].

        The first is drawn with the σ of the constant part; each later one adds a random step.
        """
        gyro, stream = self.suite.gyro, _SLOW_STREAMS["gyro"]
        if len(self._biases) < count and gyro is not None:
            steps = self._normal(stream, 2 * count, 3) * gyro.bias_growth / np.sqrt(gyro.rate)
            steps[0] = gyro.bias_sigma * self._normal(stream, 1, 3)[0]
            self._biases = np.cumsum(steps, axis=0)
        return self._biases[:count]

    def _normal(self, stream: int, count: int, width: int) -> Array:
        """Return the first `count` rows of a stream, drawn in tables of growing length."""
        table = self._tables.get(stream)
        if table is None or len(table) < count:
            numbers = random_stream(self.seed, stream).standard_normal((max(64, 2 * count), width))
            table = self._tables[stream] = numbers
        return table[:count]


def _needed(motion: Motion | None, name: str, error: str) -> Motion:
    if motion is None:
        raise InputError(
            f"sensor '{name}': its {error} needs the true motion at its samples; "
            "a log from ideal_log contains it"
        )
    return motion


def add_noise(suite: SensorSuite, ideal: Log, seed: int) -> Log:
    """Return a log with the errors of a suite's sensors; the seed determines them.

    Args:
        suite: the sensors.
        ideal: samples without errors, and the true thrust. If a sensor has a lever arm, or joint
            rates have an error once a turn, they must be those that `ideal_log` returned for this
            suite.
        seed: a whole number >= 0.

    Raises:
        InputError: the seed is not such a number, or the motion that an error needs is missing.

    """
    noise, joints = SensorNoise(suite, seed), len(ideal.joint_names)
    samples = {}
    for name, errors in suite.present().items():
        exact, first = ideal[name], first_sample(errors)
        value = noise.apply(name, exact.value, first, ideal.motion.get(name))
        stamped = Samples(noise.constants(name, joints).stamp(exact.time), value)
        samples[name] = stamped.where(~noise.is_lost(name, first + len(exact))[first:])
    if THRUST in ideal.samples:  # the true thrust is the logged one, times one plus the error
        scale = 1 + SimulatedDisturbance(suite.disturbances, seed).thrust_scale
        samples[THRUST] = Samples(ideal.thrust.time, ideal.thrust.value / scale)
    return ideal.updated(samples)
