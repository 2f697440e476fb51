"""What a spacecraft measures of its own motion, how well, and when.

Every sensor has its own rate and its own stream of random numbers, which depends on the seed, the
sensor and the sample's number only: the same samples come out whether they are drawn one by one
in a Diagram or all at once as arrays. Samples that a sensor does not take are absent.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError

ARCSECOND = np.pi / (180 * 3600)
DEGREE_PER_HOUR = np.pi / (180 * 3600)
DEGREE_PER_ROOT_HOUR = np.pi / (180 * 60)

NUMERICAL_SIGMA = 1e-8
"""What estimators assume of a sensor without noise [rad, m, rad/s, m/s]: their own arithmetic."""

SENSOR_NAMES = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")
"""The sensors, in the order in which estimators take samples of equal time."""

RATE_RANGE = (1e-3, 1e5)
"""Slowest and fastest sensor [Hz]."""

_STREAMS = (*SENSOR_NAMES, "gyro_bias", "phase encoders", "phase joint_rates")
"""What has random numbers of its own; the order is part of what a seed means."""

LONGEST_GAP = 3600.0
"""Stamps further apart than this cannot be of one identification [s]: a clock is wrong."""


@dataclass
class AttitudeSensor:
    """A star tracker, or any sensor of the base's whole attitude.

    Attributes:
        rate: samples a second [Hz].
        cross_boresight_arcsec: σ about each axis across the boresight.
        boresight_arcsec: σ about the boresight.
        boresight_B: (3,) direction of the boresight in B, of any length.

    """

    rate: float = 4.0
    cross_boresight_arcsec: float = 0.0
    boresight_arcsec: float = 0.0
    boresight_B: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(3,) σ about the boresight's two normals and about the boresight [rad]."""
        cross = self.cross_boresight_arcsec
        return ARCSECOND * np.array([cross, cross, self.boresight_arcsec])

    @property
    def R_BS(self) -> NDArray[np.float64]:
        """(3, 3) rotation whose last column is the boresight in B."""
        z = np.asarray(self.boresight_B, dtype=float)
        z = z / np.linalg.norm(z)
        x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


@dataclass
class Gyro:
    """Three rate gyros along B's axes.

    Attributes:
        rate: samples a second [Hz].
        angle_random_walk: [°/√h]; the white noise of the rate, as it adds up in the angle.
        bias: σ of the constant part [°/h].
        bias_random_walk: growth of the bias [°/h/√h].

    """

    rate: float = 100.0
    angle_random_walk: float = 0.0
    bias: float = 0.0
    bias_random_walk: float = 0.0

    @property
    def sigma(self) -> float:
        """White noise of one sample [rad/s]."""
        return self.angle_random_walk * DEGREE_PER_ROOT_HOUR * np.sqrt(self.rate)

    @property
    def bias_sigma(self) -> float:
        """σ of the constant bias [rad/s]."""
        return self.bias * DEGREE_PER_HOUR

    @property
    def bias_growth(self) -> float:
        """Random walk of the bias [rad/s/√s]."""
        return self.bias_random_walk * DEGREE_PER_HOUR / 60


@dataclass
class VectorSensor:
    """A sensor of the position or the velocity of B's origin in W: rate [Hz], σ [m or m/s]."""

    rate: float = 10.0
    sigma: float = 0.0


@dataclass
class JointSensor:
    """Encoders or tachometers of all joints.

    Attributes:
        rate: samples a second [Hz].
        sigma: white noise [rad or m; for joint rates per second].
        bits: resolution of so many bits a turn, in steps of 2π/2^bits rad (of sliding joints: as
            many m); 0 for none. Where between two marks a joint's zero lies is drawn by the seed.

    """

    rate: float = 100.0
    sigma: float = 0.0
    bits: int = 0

    @property
    def step(self) -> float:
        """Quantization [rad or m; for joint rates per second]; 0 for none."""
        return 2 * np.pi / 2**self.bits if self.bits else 0.0


@dataclass
class SensorSuite:
    """A spacecraft's sensors; one that is None is not there.

    Attributes:
        description: one line for people.
        digits: round every sample to so many decimals, in SI units (attitude as 3-2-1 Euler
            angles); None for no rounding.

    """

    description: str = ""
    attitude: AttitudeSensor | None = None
    gyro: Gyro | None = None
    position: VectorSensor | None = None
    velocity: VectorSensor | None = None
    encoders: JointSensor | None = None
    joint_rates: JointSensor | None = None
    digits: int | None = None

    def present(self) -> dict[str, AttitudeSensor | Gyro | VectorSensor | JointSensor]:
        """Return the sensors that are there, by name."""
        sensors = {name: getattr(self, name) for name in SENSOR_NAMES}
        return {name: sensor for name, sensor in sensors.items() if sensor is not None}

    def sigmas(self, name: str) -> NDArray[np.float64]:
        """Return what one sample of a sensor is off by: noise, quantization and rounding together.

        (3,) about the axes of `AttitudeSensor.R_BS` for the attitude, (1,) for the others, in SI
        units and radians; never below `NUMERICAL_SIGMA`.
        """
        sensor = getattr(self, name)
        noise = sensor.sigmas if name == "attitude" else np.array([sensor.sigma])
        step = getattr(sensor, "step", 0.0)
        rounding = 0.0 if self.digits is None else 10.0**-self.digits
        return np.sqrt(noise**2 + (step**2 + rounding**2) / 12 + NUMERICAL_SIGMA**2)


def check_sensors(suite: SensorSuite, where: str) -> None:
    """Refuse sensors that cannot be.

    Args:
        suite: from a file, from a scenario or made in Python.
        where: what is being read, for the error message.

    Raises:
        InputError: no encoders; a rate out of `RATE_RANGE`; a noise that is negative or not finite;
            bits that are not a whole number from 0 to 32, digits not one from 0 to 15; a boresight
            that is not a direction.

    """
    for name, sensor in suite.present().items():
        for entry in fields(sensor):
            key, value = f"{where}: {name}.{entry.name}", getattr(sensor, entry.name)
            if entry.name == "boresight_B":
                _check_direction(value, key)
            elif entry.name == "bits":
                _check_whole(value, 32, key)
            elif entry.name == "rate":
                low, high = RATE_RANGE
                if not (_is_real(value) and low <= value <= high):
                    raise InputError(f"{key} must be from {low:g} to {high:g} Hz, not {value!r}")
            elif not (_is_real(value) and 0 <= value < np.inf):
                raise InputError(f"{key} must be a finite number >= 0, not {value!r}")
    if suite.encoders is None:
        raise InputError(f"{where}: encoders are missing; without joint positions nothing is known")
    if suite.digits is not None:
        _check_whole(suite.digits, 15, f"{where}: digits")


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_whole(value: object, largest: int, key: str) -> None:
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and 0 <= value <= largest):
        raise InputError(f"{key} must be a whole number from 0 to {largest}, not {value!r}")


def _check_direction(value: ArrayLike, key: str) -> None:
    if np.shape(value) != (3,) or np.asarray(value).dtype.kind not in "iuf":
        raise InputError(f"{key} must be 3 numbers, not {value!r}")
    if not 1e-100 < np.abs(value).max() < 1e100:
        raise InputError(f"{key} must be a direction, of finite length and not zero, not {value}")


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one sensor: time (N,) [s] and value (N, width)."""

    time: NDArray[np.float64]
    value: NDArray[np.float64]

    def __len__(self) -> int:
        return self.time.size

    def where(self, keep: ArrayLike) -> "Samples":
        """Return the samples that a mask or index selects."""
        return Samples(self.time[keep], self.value[keep])


@dataclass(frozen=True, eq=False)
class Measurements:
    """What the sensors gave, each at its own times; a sensor that is not there has no samples.

    Attributes:
        joint_names: the joints, in the order of columns.
        attitude: unit quaternions (w, x, y, z) of R_WB.
        gyro: angular velocity of B in W, expressed in B [rad/s].
        position: B's origin in W [m].
        velocity: of B's origin, in W [m/s].
        encoders: joint positions [rad or m].
        joint_rates: [rad/s or m/s].

    """

    joint_names: tuple[str, ...]
    attitude: Samples
    gyro: Samples
    position: Samples
    velocity: Samples
    encoders: Samples
    joint_rates: Samples

    def between(self, start: float, end: float) -> "Measurements":
        """Return the samples with start ≤ time ≤ end [s]."""
        picked = {}
        for name in SENSOR_NAMES:
            samples = getattr(self, name)
            picked[name] = samples.where((samples.time >= start) & (samples.time <= end))
        return replace(self, **picked)


def sample_times(rate: float, duration: float, start: float = 0.0) -> NDArray[np.float64]:
    """Return a sensor's instants from `start` to the end, both included [s]."""
    return start + np.arange(int(np.floor((duration - start) * rate + 1e-9)) + 1) / rate


def sample_widths(joint_names: tuple[str, ...]) -> dict[str, int]:
    """Return the width of every sensor's samples, in the order of `SENSOR_NAMES`."""
    return dict(zip(SENSOR_NAMES, (4, 3, 3, 3, len(joint_names), len(joint_names))))


def perfect_value(name: str, telemetry: Telemetry) -> NDArray[np.float64]:
    """Return (N, width): what a sensor of this name would give without any error."""
    if name == "attitude":
        return telemetry.quaternion_WB
    if name == "gyro":
        return rotate(np.swapaxes(telemetry.R_WB, -1, -2), telemetry.w_WB)
    return {
        "position": telemetry.p_WB,
        "velocity": telemetry.v_WB,
        "encoders": telemetry.q,
        "joint_rates": telemetry.qdot,
    }[name]


def perfect_measurements(
    suite: SensorSuite,
    joint_names: tuple[str, ...],
    motion: Callable[[NDArray[np.float64]], Telemetry],
    duration: float,
) -> Measurements:
    """Return what the sensors would give without error, at their own times in [0, duration].

    Args:
        suite: the sensors; only their rates are used.
        joint_names: the joints.
        motion: returns the true telemetry at increasing times (N,).
        duration: [s].

    """
    samples = {
        name: Samples(np.empty(0), np.empty((0, width)))
        for name, width in sample_widths(joint_names).items()
    }
    sensors = suite.present()
    times = {name: sample_times(sensor.rate, duration) for name, sensor in sensors.items()}
    if times:
        everything = np.concatenate(list(times.values()))
        keys = np.round(everything * 1e9).astype(np.int64)
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        telemetry = motion(everything[first])
        start = 0
        for name, t in times.items():
            mine = inverse[start : start + t.size]
            samples[name] = Samples(t, perfect_value(name, telemetry)[mine])
            start += t.size
    return Measurements(tuple(joint_names), **samples)


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


def screen(measurements: Measurements) -> tuple[Measurements, dict[str, int]]:
    """Return the samples that can be used, and how many of each sensor could not.

    Left out are

    - samples with an entry that is not finite;
    - attitudes whose quaternion is more than 1e-3 off unit norm;
    - stamps that are further than `LONGEST_GAP` from most others: of a clock that jumps, or is not
      set yet; one in the far future costs no more than its own sample;
    - as few samples as possible for the stamps of the rest to increase; of repeated stamps the
      first stays.

    Quaternions are normalized; their sign has no meaning and stays as it is.

    Raises:
        InputError: samples that are not numbers, or whose shapes do not fit.

    """
    kept, rejected = {}, {}
    for name, width in sample_widths(measurements.joint_names).items():
        samples = getattr(measurements, name)
        try:
            time, value = np.asarray(samples.time, float), np.asarray(samples.value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"measurements: '{name}' is not made of numbers: {error}") from error
        if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
            raise InputError(
                f"measurements: '{name}' needs times (N,) and values (N, {width}), "
                f"not {time.shape} and {value.shape}"
            )
        value = value.reshape(time.size, width)
        usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
        if name == "attitude":
            with np.errstate(over="ignore"):
                norm = np.linalg.norm(value, axis=1)
            usable &= np.abs(norm - 1) < 1e-3
            value = value / np.where(usable, norm, 1.0)[:, None]
        index = np.flatnonzero(usable)
        index = index[_together(time[index])]
        index = index[_increasing(time[index])]
        everything = index.size == time.size
        kept[name] = Samples(time, value) if everything else Samples(time[index], value[index])
        rejected[name] = time.size - index.size
    return replace(measurements, **kept), rejected


def _together(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices, in their order, of the most stamps without a gap of `LONGEST_GAP`."""
    order = np.argsort(time)
    gaps = np.flatnonzero(time[order][1:] > time[order][:-1] + LONGEST_GAP)
    ends = np.concatenate([[0], gaps + 1, [time.size]])
    k = int(np.diff(ends).argmax())
    return np.sort(order[ends[k] : ends[k + 1]])


def _increasing(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the most stamps that strictly increase; of equal choices the first."""
    if (time[1:] > time[:-1]).all():
        return np.arange(time.size)
    # Backwards, by length: the largest first stamp of such a series, its index; and what follows.
    first, start = [], []
    following = np.full(time.size, -1)
    for k in range(time.size - 1, -1, -1):
        length = bisect_left(first, -time[k])
        if length:
            following[k] = start[length - 1]
        first[length : length + 1], start[length : length + 1] = [-time[k]], [k]
    series = [start[-1]]
    while following[series[-1]] >= 0:
        series.append(following[series[-1]])
    return np.array(series)
