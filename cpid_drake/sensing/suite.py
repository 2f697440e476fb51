"""A spacecraft's sensors: which of the table it has, with their rates and errors."""

from dataclasses import dataclass, field, fields, make_dataclass
from numbers import Integral, Real
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.sensors import (
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    SensorErrors,
    VectorSensor,
)

NUMERICAL_SIGMA = 1e-8
"""Smallest σ that estimators assume of any sensor [rad, m, rad/s, m/s]: their own arithmetic."""

RATE_RANGE = (1e-3, 1e5)
"""Slowest and fastest sensor [Hz]."""


@dataclass
class SensorSuite:
    """A spacecraft's sensors; one that is None is absent.

    `suite[name]` returns any sensor of the table. Suites with registered sensors are of the type
    that `suite_type` returns, which has a field for each.

    Attributes:
        description: one line for people.
        decimals: every sample is rounded to this number of decimals, in SI units (attitude as 3-2-1
            Euler angles); None for no rounding.
        digits: former name of `decimals`, which files may still use.

    """

    description: str = ""
    attitude: AttitudeSensor | None = None
    gyro: Gyro | None = None
    position: VectorSensor | None = None
    velocity: VectorSensor | None = None
    encoders: JointSensor | None = None
    joint_rates: JointSensor | None = None
    decimals: int | None = None
    digits: int | None = None

    def __getitem__(self, name: str) -> SensorErrors:
        """Return the errors of a sensor that is present.

        Raises:
            KeyError: it is absent.

        """
        errors = getattr(self, name, None) if name in SENSORS else None
        if errors is None:
            raise KeyError(name)
        return errors

    def present(self) -> dict[str, SensorErrors]:
        """Return the errors of the sensors that are present, by name."""
        return {name: self[name] for name in SENSORS if getattr(self, name, None) is not None}

    @property
    def rounding(self) -> int | None:
        """Number of decimals to which samples are rounded; None for no rounding."""
        return self.digits if self.decimals is None else self.decimals

    def sigmas(self, name: str) -> NDArray[np.float64]:
        """Return σ of one sample of a sensor: noise, quantization and rounding together.

        (3,) about the axes of `AttitudeSensor.R_BS` for attitude, (1,) for other quantities, in SI
        units and radians; never below `NUMERICAL_SIGMA`.

        Raises:
            KeyError: the sensor is absent.

        """
        errors = self[name]
        rounding = 0.0 if self.rounding is None else 10.0**-self.rounding
        variance = errors.sigmas**2 + (errors.step**2 + rounding**2) / 12 + NUMERICAL_SIGMA**2
        return np.asarray(np.sqrt(variance))


def suite_type() -> type[SensorSuite]:
    """Return the dataclass of suites, with a field for every sensor of the table."""
    known = {entry.name for entry in fields(SensorSuite)}
    added: list[Any] = [
        (name, sensor.errors | None, field(default=None))
        for name, sensor in SENSORS.items()
        if name not in known
    ]
    return make_dataclass("SensorSuite", added, bases=(SensorSuite,)) if added else SensorSuite


def check_sensors(suite: SensorSuite, where: str) -> None:
    """Refuse a suite with impossible parameters.

    Args:
        suite: from a file, from a scenario or made in Python.
        where: what is being read, for the error message.

    Raises:
        InputError: no encoders; a rate out of `RATE_RANGE`; a noise that is negative or not finite;
            bits that are not a whole number from 0 to 32, decimals not one from 0 to 15; both
            `decimals` and `digits`; a boresight that is not a direction.

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
        raise InputError(
            f"{where}: encoders are missing; no estimator works without joint positions"
        )
    if suite.decimals is not None and suite.digits is not None:
        raise InputError(f"{where}: decimals and digits are the same; give one of the two")
    for key in ("decimals", "digits"):
        if getattr(suite, key) is not None:
            _check_whole(getattr(suite, key), 15, f"{where}: {key}")


def _is_real(value: object) -> TypeGuard[float]:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_whole(value: object, largest: int, key: str) -> None:
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and isinstance(value, Integral) and 0 <= int(value) <= largest):
        raise InputError(f"{key} must be a whole number from 0 to {largest}, not {value!r}")


def _check_direction(value: object, key: str) -> None:
    vector = np.asarray(value)
    if vector.shape != (3,) or vector.dtype.kind not in "iuf":
        raise InputError(f"{key} must be 3 numbers, not {value!r}")
    if not 1e-100 < np.abs(vector).max() < 1e100:
        raise InputError(f"{key} must be a direction of finite length, not zero, not {vector}")
