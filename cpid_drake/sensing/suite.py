"""The sensors of the table that a spacecraft has, with their rates and errors."""

from dataclasses import dataclass, field, fields, make_dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import check_values
from cpid_drake.sensing.sensors import (
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    SensorErrors,
    VectorSensor,
)

NUMERICAL_SIGMA = 1e-8
"""Smallest σ that estimators assume for a sensor, due to rounding [rad, m, rad/s, m/s]."""

Decimals = Annotated[int, Interval(ge=0, le=15)]


@dataclass
class SensorSuite:
    """A spacecraft's sensors; an absent sensor is None.

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
    decimals: Decimals | None = None
    digits: Decimals | None = None

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
    """Refuse a suite with impossible values.

    Args:
        suite: a suite from a file, from a scenario or made in Python.
        where: name of the suite in error messages.

    Raises:
        InputError: a value is of the wrong type or out of the limits that its class declares; no
            encoders; both `decimals` and `digits`; a boresight vector that has no direction.

    """
    check_values(suite, where, "a sensor suite")
    for name, errors in suite.present().items():
        direction = errors.boresight_B if isinstance(errors, AttitudeSensor) else np.ones(1)
        if not 1e-100 < np.abs(direction).max() < 1e100:
            raise InputError(
                f"{where}: {name}.boresight_B must be a direction of finite length, not zero, "
                f"not {direction}"
            )
    if suite.encoders is None:
        raise InputError(
            f"{where}: encoders are missing; no estimator works without joint positions"
        )
    if suite.decimals is not None and suite.digits is not None:
        raise InputError(f"{where}: decimals and digits are the same; give one of the two")
