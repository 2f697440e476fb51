"""The sensors of the table that a spacecraft has, with their rates and errors."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.files.checked_yaml import check_values
from cpid_drake.files.constraints import Limits
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import (
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    SensorErrors,
    VectorSensor,
)
from cpid_drake.sensors.thrusters import Thrusters

NUMERICAL_SIGMA = 1e-8
"""Smallest σ that estimators assume for a sensor, due to rounding [rad, m, rad/s, m/s]."""

Decimals = Annotated[int, Limits(ge=0, le=15)]


@dataclass
class SensorSuite:
    """A spacecraft's sensors; an absent sensor is None.

    `suite[name]` returns any sensor of the table.

    Attributes:
        description: one line for people.
        decimals: every sample is rounded to this number of decimals, in SI units (attitude as 3-2-1
            Euler angles); None for no rounding.
        disturbances: external forces and torques that act while the sensors measure; None without.
        thrusters: the valves that the log has columns of; None without.
        unstated: "exact" if errors without a stated σ are zero; None if they may have a plausible
            size, see `error_kinds.with_plausible`.

    """

    description: str = ""
    attitude: AttitudeSensor | None = None
    gyro: Gyro | None = None
    position: VectorSensor | None = None
    velocity: VectorSensor | None = None
    encoders: JointSensor | None = None
    joint_rates: JointSensor | None = None
    decimals: Decimals | None = None
    disturbances: Disturbances | None = None
    thrusters: Thrusters | None = None
    unstated: Literal["exact"] | None = None

    def __getitem__(self, name: str) -> SensorErrors:
        """Return the errors of a sensor that is present.

        Raises:
            KeyError: it is absent.

        """
        errors: SensorErrors | None = getattr(self, name, None) if name in SENSORS else None
        if errors is None:
            raise KeyError(name)
        return errors

    def present(self) -> dict[str, SensorErrors]:
        """Return the errors of the sensors that are present, by name."""
        return {name: self[name] for name in SENSORS if getattr(self, name, None) is not None}

    def exact(self) -> "SensorSuite":
        """Return the sensors of a world that has no other errors than the stated ones."""
        return replace(self, unstated="exact")

    @property
    def orbit(self) -> Orbit | None:
        """The orbit of W's origin; None if there is none."""
        return None if self.disturbances is None else self.disturbances.orbit

    def sigmas(self, name: str) -> Array:
        """Return σ of one sample of a sensor: noise, quantization and rounding together.

        (3,) about the axes of `AttitudeSensor.R_BS` for attitude, (1,) for other quantities, in SI
        units and radians; never below `NUMERICAL_SIGMA`.

        Raises:
            KeyError: the sensor is absent.

        """
        variance = self[name].sigmas ** 2 + self.step(name) ** 2 / 12 + NUMERICAL_SIGMA**2
        return np.asarray(np.sqrt(variance))

    def step(self, name: str) -> float:
        """Return the step of quantization and rounding together; 0 for none [SI units, rad].

        Raises:
            KeyError: the sensor is absent.

        """
        rounding = 0.0 if self.decimals is None else 10.0**-self.decimals
        return float(np.hypot(self[name].step, rounding))


def check_sensors(suite: SensorSuite, where: str) -> None:
    """Refuse a suite with impossible values.

    Args:
        suite: a suite from a file, from a scenario or made in Python.
        where: name of the suite in error messages.

    Raises:
        InputError: a value is of the wrong type or out of the limits that its class declares; a
            constant error of joint rates.

    """
    if not isinstance(suite, SensorSuite):
        raise InputError(
            f"{where}: give a SensorSuite, not {suite!r:.80}; load_sensors reads a preset or a file"
        )
    check_values(suite, where, "a sensor suite")
    for key, why in (
        ("zero_mrad", "only joint positions have a zero"),
        ("drift_mrad_per_s", "only joint positions have a zero"),
        ("joint_scale_ppm", "it is that of the encoders; give encoders.joint_scale_ppm"),
        ("eccentricity_mrad", "it is that of the encoders; give encoders.eccentricity_mrad"),
        ("delay_ms", "their stamps belong to the clock of the encoders; give encoders.delay_ms"),
        ("clock_drift_ppm", "it is the clock of the encoders; give encoders.clock_drift_ppm"),
    ):
        if value := getattr(suite.joint_rates, key, None):
            raise InputError(f"{where}: joint_rates.{key} must be 0, not {value}: {why}")


def require_encoders(suite: SensorSuite, where: str) -> None:
    """Refuse a suite without encoders: raises InputError; see `check_sensors`."""
    if suite.encoders is None:
        raise InputError(
            f"{where}: encoders are missing; no estimator works without joint positions"
        )
