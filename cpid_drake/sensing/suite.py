"""What a spacecraft measures of its own motion, how well, and when.

Every sensor has its own rate and its own stream of random numbers, which depends on the seed, the
sensor and the sample's number only: the same samples come out whether they are drawn one by one
in a Diagram or all at once as arrays. Samples that a sensor does not take are absent.
"""

from dataclasses import dataclass, field, fields
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
