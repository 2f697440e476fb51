"""The table of sensors: what each one measures, its errors, and the names of its columns.

Suites, logs, simulated noise, log files, estimators and reports all read `SENSORS`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from operator import attrgetter
from typing import Annotated, Self

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.files.constraints import Limits, Numbers
from cpid_drake.files.errors import InputError

ARCSECOND = np.pi / (180 * 3600)
DEGREE_PER_HOUR = ARCSECOND  # in a second
DEGREE_PER_ROOT_HOUR = np.pi / (180 * 60)

CALIBRATED_GYRO_BIAS = 10.0
"""σ of a gyro's constant bias that is assumed if nothing else is known [°/h]."""

Rate = Annotated[float, Limits(ge=1e-3, le=1e5)]
Noise = Annotated[float, Limits(ge=0)]

Stated = Annotated[float | None, Limits(ge=0)]
"""σ of an error: None if it is not stated, zero if there is no such error."""

LABORATORY_UNITS: dict[str, tuple[Callable[[float], float], tuple[str, ...]]] = {
    "noise_deg": (lambda rate: 3600.0, ("cross_boresight_arcsec", "boresight_arcsec")),
    "noise_deg_per_s": (lambda rate: 60 / rate**0.5, ("angle_random_walk",)),
    "bias_deg_per_s": (lambda rate: 3600.0, ("bias",)),
    "sigma_mm": (lambda rate: 1e-3, ("sigma",)),
    "sigma_deg": (lambda rate: np.pi / 180, ("sigma",)),
}
"""Keys in units that a laboratory measures: their size in the unit of the keys of data sheets that
they replace, at a rate [Hz], and these keys."""

# -- the errors of sensors ------------------------------------------------------------------------


@dataclass
class SensorErrors(ABC):
    """Rate, white noise and constant errors of a sensor; each kind of sensor has its own subclass.

    A constant error is unknown. Its σ is stated, or None if it is not: estimators then take a
    plausible one (`error_kinds.with_plausible`). Zero means that the sensor does not have it.

    Attributes:
        rate: samples per second [Hz].
        delay_ms: σ of the delay of all stamps; a positive delay means that they are too late [ms].
        clock_drift_ppm: σ of the share by which the clock of the stamps is fast: from the start of
            a log on, the delay grows by it [10⁻⁶ s/s].
        dropouts: mean number of dropouts per minute, in which samples are lost.
        dropout_length: mean duration of a dropout [s].

    Keys in `LABORATORY_UNITS` are converted when an object is made, and are None then.

    Raises:
        InputError: an error is given in both units.

    """

    rate: Rate = 10.0
    delay_ms: Stated = field(default=None, kw_only=True)
    clock_drift_ppm: Stated = field(default=None, kw_only=True)
    dropouts: Noise = field(default=0.0, kw_only=True)
    dropout_length: Annotated[float, Limits(gt=0)] = field(default=1.0, kw_only=True)

    def __post_init__(self) -> None:
        for key, (size, replaced) in LABORATORY_UNITS.items():
            value = getattr(self, key, None)
            if value is None:
                continue
            if any(getattr(self, each) for each in replaced):
                raise InputError(f"give {key} or {' and '.join(replaced)}, not both")
            for each in replaced:
                setattr(self, each, value * size(self.rate))
            setattr(self, key, None)

    @classmethod
    @abstractmethod
    def with_noise(cls, rate: float, sigma: float) -> Self:
        """Return errors with white noise of `sigma` [SI units, rad], the same about all axes."""

    @property
    @abstractmethod
    def sigmas(self) -> Array:
        """σ of the white noise of one sample, (1,) for all entries or (3,) [SI units, rad]."""

    @property
    def step(self) -> float:
        """Quantization step [SI units, rad]; 0 for none."""
        return 0.0


@dataclass
class AttitudeSensor(SensorErrors):
    """A star tracker, or any other sensor that measures all three axes of the base's attitude.

    Attributes:
        cross_boresight_arcsec: σ about each of the two axes perpendicular to the boresight.
        boresight_arcsec: σ about the boresight.
        boresight_B: (3,) direction of the boresight in B, of any length.
        mounting_arcsec: σ of the error of the mounting, a constant rotation about each axis of B.
        noise_deg: σ about every axis [°], in place of the two in arcseconds.

    Raises:
        InputError: the boresight has no length, or σ is given in both units.

    """

    rate: Rate = 4.0
    cross_boresight_arcsec: Noise = 0.0
    boresight_arcsec: Noise = 0.0
    boresight_B: Annotated[Array, Numbers(3)] = field(
        default_factory=lambda: np.array([0.0, 0.0, 1.0])
    )
    mounting_arcsec: Stated = None
    noise_deg: Stated = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1e-100 < np.abs(self.boresight_B).max() < 1e100:
            raise InputError(
                f"boresight_B must be a direction of finite length, not {self.boresight_B}"
            )

    @classmethod
    def with_noise(cls, rate: float, sigma: float) -> Self:
        """Return a sensor with σ [rad] about every axis."""
        return cls(rate, sigma / ARCSECOND, sigma / ARCSECOND)

    @property
    def sigmas(self) -> Array:
        """(3,) σ about the boresight's two normals and about the boresight [rad]."""
        cross = self.cross_boresight_arcsec
        return ARCSECOND * np.array([cross, cross, self.boresight_arcsec])

    @property
    def R_BS(self) -> Array:
        """(3, 3) rotation whose last column is the boresight in B."""
        return _frame_about(tuple(np.asarray(self.boresight_B, dtype=float).tolist()))


@lru_cache(maxsize=64)
def _frame_about(axis: tuple[float, ...]) -> Array:
    """Return a rotation (3, 3) whose last column is along an axis."""
    z = np.array(axis, dtype=float)
    z = z / np.linalg.norm(z)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


@dataclass
class Gyro(SensorErrors):
    """Three rate gyros along B's axes.

    Attributes:
        angle_random_walk: white noise of the rate, as it accumulates in the angle [°/√h].
        bias: σ of the constant part of the bias [°/h].
        bias_random_walk: growth of the bias [°/h/√h].
        scale_ppm: σ of the error of each axis' scale [10⁻⁶].
        misalignment_arcsec: σ of the error of each axis' direction, towards each other axis.
        integrates: whether a sample is the mean over the time since the sample before.
        noise_deg_per_s: white noise of one sample at `rate` [°/s], in place of the random walk.
        bias_deg_per_s: `bias` in °/s.

    """

    rate: Rate = 100.0
    angle_random_walk: Noise = 0.0
    bias: Stated = None
    bias_random_walk: Stated = None
    scale_ppm: Stated = None
    misalignment_arcsec: Stated = None
    integrates: bool = False
    noise_deg_per_s: Stated = field(default=None, kw_only=True)
    bias_deg_per_s: Stated = field(default=None, kw_only=True)

    @classmethod
    def with_noise(cls, rate: float, sigma: float) -> Self:
        """Return a gyro with σ [rad/s] of one sample and a bias of `CALIBRATED_GYRO_BIAS`."""
        return cls(rate, sigma / (DEGREE_PER_ROOT_HOUR * np.sqrt(rate)), CALIBRATED_GYRO_BIAS)

    @property
    def sigma(self) -> float:
        """White noise of one sample [rad/s]."""
        return float(self.angle_random_walk * DEGREE_PER_ROOT_HOUR * np.sqrt(self.rate))

    @property
    def sigmas(self) -> Array:
        """(1,) σ of one sample [rad/s]."""
        return np.array([self.sigma])

    @property
    def bias_sigma(self) -> float:
        """σ of the constant bias [rad/s]."""
        return (self.bias or 0.0) * DEGREE_PER_HOUR

    @property
    def bias_growth(self) -> float:
        """Random walk of the bias: its σ after a time t is this value times √t [rad/s/√s]."""
        return (self.bias_random_walk or 0.0) * DEGREE_PER_HOUR / 60


@dataclass
class _UniformSensor(SensorErrors):
    """A sensor with the same σ for all entries."""

    rate: Rate = 10.0
    sigma: Noise = 0.0

    @classmethod
    def with_noise(cls, rate: float, sigma: float) -> Self:
        """Return a sensor with this σ."""
        return cls(rate, sigma)

    @property
    def sigmas(self) -> Array:
        """(1,) σ of every entry of a sample."""
        return np.array([self.sigma])


@dataclass
class VectorSensor(_UniformSensor):
    """A sensor of the position or the velocity of B's origin in W.

    Attributes:
        sigma: white noise [m or m/s].
        sigma_mm: the same [mm or mm/s].
        lever_arm_mm: σ of each coordinate, in B, of the point that is measured, from B's origin.

    """

    lever_arm_mm: Stated = None
    sigma_mm: Stated = field(default=None, kw_only=True)


@dataclass
class JointSensor(_UniformSensor):
    """Encoders or tachometers of all joints.

    Attributes:
        sigma: white noise [rad or m; for joint rates per second].
        bits: resolution in bits per turn: the step is 2π/2^bits rad (for prismatic joints in
            m); 0 for no quantization. The seed determines the position of the zero between steps.
        zero_mrad: σ of the error of each joint's zero [10⁻³ rad; for prismatic joints mm].
        drift_mrad_per_s: σ of the rate at which each zero moves from the start of a log on.
        joint_scale_ppm: σ of the error of each joint's scale, as of a gear or a belt [10⁻⁶].
        eccentricity_mrad: σ of the error once a turn: of its sine, and of its cosine
            [10⁻³ rad; for prismatic joints mm, and a turn is 2π m]. Wheels have none.
        sigma_deg: white noise of turning joints [°; for joint rates °/s].

    """

    rate: Rate = 100.0
    sigma: Noise = 0.0
    bits: Annotated[int, Limits(ge=0, le=32)] = 0
    zero_mrad: Stated = None
    drift_mrad_per_s: Stated = None
    joint_scale_ppm: Stated = None
    eccentricity_mrad: Stated = None
    sigma_deg: Stated = field(default=None, kw_only=True)

    @property
    def step(self) -> float:
        """Quantization step [rad or m; for joint rates per second]; 0 for none."""
        return 2 * np.pi / 2**self.bits if self.bits else 0.0


# -- the table ------------------------------------------------------------------------------------


def _angular_velocity_in_B(motion: Motion) -> Array:
    return rotate(np.swapaxes(motion.R_WB, -1, -2), motion.w_WB)


@dataclass(frozen=True)
class Sensor:
    """One sensor of the table.

    Attributes:
        name: key in sensor YAML files, in `SensorSuite` and in `Log`; an identifier.
        quantity: what it measures, in words.
        unit: unit of the samples; for attitude, unit of its errors.
        width: number of entries of a sample; None for one per joint.
        ideal: returns the samples (N, width) of a sensor without errors, from the true motion.
        errors: dataclass with the errors' parameters: the keys of the sensor in YAML files.
        columns: names of its columns in logs; for joints the prefix of all columns.
        columns_in_W: columns of an angular velocity expressed in W, which a table may have instead;
            each sample then needs an attitude on its row.

    """

    name: str
    quantity: str
    unit: str
    width: int | None
    ideal: Callable[[Motion], Array]
    errors: type[SensorErrors]
    columns: tuple[str, ...]
    columns_in_W: tuple[str, ...] = ()

    def width_of(self, joint_count: int) -> int:
        """Return the number of entries of a sample."""
        return joint_count if self.width is None else self.width

    def columns_of(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the columns of a sample."""
        if self.width is None:
            return tuple(self.columns[0] + joint for joint in joint_names)
        return self.columns

    @property
    def description(self) -> str:
        """The quantity with the columns, such as "position (x,y,z)", for messages."""
        if self.width is None:
            return f"{self.quantity} ({self.columns[0]}<joint>)"
        sets = [",".join(columns) for columns in (self.columns, self.columns_in_W) if columns]
        return f"{self.quantity} ({' or '.join(sets)})"


SENSORS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        Sensor(
            "attitude",
            "attitude",
            "rad",
            4,
            attrgetter("quaternion_WB"),
            AttitudeSensor,
            ("qw", "qx", "qy", "qz"),
        ),
        Sensor(
            "gyro",
            "angular velocity",
            "rad/s",
            3,
            _angular_velocity_in_B,
            Gyro,
            ("bwx", "bwy", "bwz"),
            ("wx", "wy", "wz"),
        ),
        Sensor("position", "position", "m", 3, attrgetter("p_WB"), VectorSensor, ("x", "y", "z")),
        Sensor(
            "velocity", "velocity", "m/s", 3, attrgetter("v_WB"), VectorSensor, ("vx", "vy", "vz")
        ),
        Sensor(
            "encoders", "joint positions", "rad or m", None, attrgetter("q"), JointSensor, ("q:",)
        ),
        Sensor(
            "joint_rates",
            "joint rates",
            "rad/s or m/s",
            None,
            attrgetter("qdot"),
            JointSensor,
            ("qd:",),
        ),
    )
}
"""All sensors by name. Estimators process samples of equal time in this order."""

POSITIONS = {"joint_rates": "encoders", "gyro": "attitude", "velocity": "position"}
"""By the name of a rate, that of the position that changes at it."""
