"""Constant errors as unknowns of the likelihood: their σ, and their places in a state.

`SensorSuite` declares the σ of the constant errors of sensors and of the external forces. They are
the prior of the estimate. Every entry of one constant error has the same σ.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.gaussian import places_of
from cpid_drake.sensors.sensors import ARCSECOND, DEGREE_PER_HOUR, Gyro
from cpid_drake.sensors.suite import SensorSuite

THRUST_SCALE = "thrust_scale"
"""Name of the error of the scale of logged thrust, common to all its components."""

THRUSTERS = "thrusters"
"""Name before the errors that all valves have in common."""

VALVE_FORCE, COMMON_FORCE = "force", "common_force"
VALVE_LOSS, VALVE_DELAY = "loss", "valve_delay"
"""Kinds of errors of thrusters with valves; see `cpid_drake.sensors.thrusters`."""

OF_THRUST = (THRUST_SCALE, VALVE_FORCE, COMMON_FORCE, VALVE_LOSS, VALVE_DELAY)
"""Kinds that change the thrust."""

ACCELERATION, TORQUE = "acceleration", "torque"
"""Names of a steady acceleration of the system's centre of mass and a torque about it, in W."""

WHEEL = "wheel"
"""Name of the angular momentum of rotors in the base, in B."""

COMPLIANCE = "compliance"
"""Name of the compliance of the grasp about the axes of C."""

STRETCH = "translational_compliance"
"""Name of the compliance of the grasp along the axes of C."""

ZERO, DRIFT = "zero", "drift"
"""Kinds of errors of joints: of their zeros at the start of a log, and of the zeros' rates."""

BIAS = "bias"
"""Kind of a gyro's bias, which walks from block to block."""

OF_GRASP = (COMPLIANCE, STRETCH)
"""Kinds whose nominal value is zero."""


@dataclass(frozen=True)
class ConstantError:
    """One constant error.

    Attributes:
        name: `ACCELERATION`, `TORQUE`, `THRUST_SCALE`, `WHEEL`, `COMPLIANCE` or `STRETCH`, or a
            sensor and a kind, such as "attitude.delay" or "encoders.joint 1.drift".
        size: number of entries.
        sigma: σ of each entry [SI units, rad].
        unit: unit in texts.
        scale: SI value of this unit.
        walk: random walk: the σ of the change after a time t is this value times √t [SI units/√s].
        joint: number of the joint that alone has it, from 0; -1 for other errors.

    """

    name: str
    size: int
    sigma: float
    unit: str
    scale: float
    walk: float = 0.0
    joint: int = -1

    @property
    def sensor(self) -> str:
        """Name of the sensor; empty for an external force."""
        return self.name.partition(".")[0] if "." in self.name else ""

    @property
    def kind(self) -> str:
        """Kind of the error, such as "delay"."""
        return self.name.rpartition(".")[2]


_KINDS = {
    "delay": ("delay_ms", 1, "ms", 1e-3),
    "mounting": ("mounting_arcsec", 3, "arcsec", ARCSECOND),
    "scale": ("scale_ppm", 3, "ppm", 1e-6),
    "misalignment": ("misalignment_arcsec", 6, "arcsec", ARCSECOND),
    "lever_arm": ("lever_arm_mm", 3, "mm", 1e-3),
    ZERO: ("zero_mrad", 0, "mrad", 1e-3),
}
"""The field with the σ of each kind, its number of entries (0: one per joint), unit and scale."""


def constant_errors(suite: SensorSuite, joint_count: int) -> tuple[ConstantError, ...]:
    """Return the constant errors with σ > 0 of a suite, for a spacecraft with so many joints."""
    found, forces, thrusters = list[ConstantError](), suite.disturbances, suite.thrusters
    if forces is not None:
        found += [
            ConstantError(
                ACCELERATION, 3, forces.acceleration, "m/s²", 1.0, forces.acceleration_walk
            ),
            ConstantError(TORQUE, 3, forces.torque, "N·m", 1.0, forces.torque_walk),
            ConstantError(THRUST_SCALE, 1, forces.thrust_scale, "%", 0.01),
            ConstantError(WHEEL, 3, forces.wheel, "N·m·s", 1.0),
            ConstantError(COMPLIANCE, 3, 1e-6 * forces.compliance_urad, "µrad/(N·m)", 1e-6),
            ConstantError(STRETCH, 3, 1e-6 * forces.translational_compliance_um, "µm/N", 1e-6),
        ]
    if thrusters is not None:
        found += [
            ConstantError(f"{name}.{VALVE_FORCE}", 1, valve.force_sigma / valve.force, "%", 0.01)
            for name, valve in thrusters.valves.items()
        ]
        for kind, sigma, unit, scale in (
            (COMMON_FORCE, thrusters.common_force, "%", 0.01),
            (VALVE_LOSS, thrusters.loss, "%", 0.01),
            (VALVE_DELAY, 1e-3 * thrusters.delay_ms, "ms", 1e-3),
        ):
            found.append(ConstantError(f"{THRUSTERS}.{kind}", 1, sigma, unit, scale))
    for sensor, errors in suite.present().items():
        for kind, (field, size, unit, scale) in _KINDS.items():
            name, sigma = f"{sensor}.{kind}", scale * getattr(errors, field, 0.0)
            found.append(ConstantError(name, size or joint_count, sigma, unit, scale))
        drift = 1e-3 * getattr(errors, "drift_mrad_per_s", 0.0)
        found += [  # one that drifts does not say that others do
            ConstantError(f"{sensor}.joint {j + 1}.{DRIFT}", 1, drift, "mrad/s", 1e-3, joint=j)
            for j in range(joint_count)
        ]
        if isinstance(errors, Gyro):  # a bias that is known exactly would have no σ
            sigma, walk = max(errors.bias_sigma, 1e-9), errors.bias_growth
            name = f"{sensor}.{BIAS}"
            found.append(ConstantError(name, 3, sigma, "deg/h", DEGREE_PER_HOUR, walk))
    return tuple(error for error in found if error.sigma > 0)


class Constants:
    """The constant errors of a suite, as a vector in units of their σ.

    Args:
        errors: the constant errors; default: none.

    Attributes:
        errors: the constant errors by name.
        size: length of the vector.

    """

    def __init__(self, errors: tuple[ConstantError, ...] = ()) -> None:
        self.errors = {error.name: error for error in errors}
        self.size = sum(error.size for error in errors)
        self._places = places_of({error.name: error.size for error in errors})

    @classmethod
    def of(cls, suite: SensorSuite, joint_count: int) -> "Constants":
        """Return the constant errors of a suite, for a spacecraft with so many joints."""
        return cls(constant_errors(suite, joint_count))

    def value(self, constants: NDArray[np.float64], name: str) -> NDArray[np.float64] | None:
        """Return one error [SI units, rad], from the vector (k,); None if there is no such one."""
        if name not in self.errors:
            return None
        return np.asarray(self.errors[name].sigma * constants[self._places[name]])

    def joint_errors(self, constants: NDArray[np.float64], kind: str) -> NDArray[np.float64]:
        """Return one kind of errors of measured joint positions (J,) [SI units]; zero if none."""
        found = [e for e in self.errors.values() if e.kind == kind]
        values = [error.sigma * constants[self._places[error.name]] for error in found]
        return np.concatenate(values) if values else np.zeros(1)

    @property
    def of_thrust(self) -> list[str]:
        """Names of the errors that change the thrust, of one entry each."""
        return [error.name for error in self.errors.values() if error.kind in OF_THRUST]

    def place(self, name: str) -> slice:
        """Return the place of an error in the vector."""
        return self._places[name]
