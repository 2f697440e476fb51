"""Constant errors as unknowns of the likelihood: their σ, and their places in a state.

`SensorSuite` declares the σ of the constant errors of sensors and of the external forces. They are
the prior of the estimate. Every entry of one constant error has the same σ.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import indices_of, places_of
from cpid_drake.sensors.error_kinds import KINDS, OF_JOINTS, ErrorKind
from cpid_drake.sensors.sensors import Gyro
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

ACCELERATION_B, TORQUE_B = "acceleration_B", "torque_B"
"""Names of the same in B."""

WHEEL = "wheel"
"""Name of the angular momentum of rotors in the base, in B."""

YIELDING = ("joint_compliance", "compliance", "translational_compliance")
"""Names of the compliances of the joints, and of the grasp about and along the axes of C."""

TARGET_WHEEL = "target_wheel"
"""Name of the angular momentum of rotors in the target, in C."""

ZERO, DRIFT, JOINT_SCALE = "zero", "drift", "joint_scale"
SINE, COSINE = "eccentricity_sine", "eccentricity_cosine"
"""Kinds of errors of joints; see `joint_errors`."""

DELAY, CLOCK_DRIFT = "delay", "clock_drift"
"""Kinds of errors of stamps: their delay at the start of a log, and its growth in a second."""

BIAS = "bias"
"""Kind of a gyro's bias, which walks from block to block."""

NO_BIAS = 1e-9
"""σ of the bias of a gyro that has none: one that is exact would have no σ [rad/s]."""

OF_FIRST_ORDER = (*YIELDING, ACCELERATION_B)
"""Kinds whose effect is of first order about zero: the predicted motion does not have it."""


@dataclass(frozen=True)
class ConstantError:
    """One constant error.

    Attributes:
        name: a kind (see `error_kinds.KINDS`), or a sensor and a kind, such as "attitude.delay".
        size: number of entries.
        sigma: σ of each entry [SI units, rad].
        unit: unit in texts.
        scale: SI value of this unit.
        walk: random walk: the σ of the change after a time t is this value times √t [SI units/√s].

    """

    name: str
    size: int
    sigma: float
    unit: str
    scale: float
    walk: float = 0.0

    @property
    def sensor(self) -> str:
        """Name of the sensor; empty for an external force."""
        return self.name.partition(".")[0] if "." in self.name else ""

    @property
    def kind(self) -> str:
        """Kind of the error, such as "delay"."""
        return self.name.rpartition(".")[2]

    @property
    def is_shared(self) -> bool:
        """Whether all logs of one hardware have the same error."""
        return KINDS[self.kind].is_shared


def constant_errors(suite: SensorSuite, joint_count: int) -> tuple[ConstantError, ...]:
    """Return the constant errors with σ > 0 of a suite, for a spacecraft with so many joints."""
    table, forces, thrusters = list[ConstantError](), suite.disturbances, suite.thrusters

    def add(kind: ErrorKind, owner: Any, before: str = "") -> None:
        """Add a kind of errors if its owner has it."""
        sigma = kind.to_SI * (getattr(owner, kind.field, None) or 0.0)
        if kind.owner == "valve":
            sigma /= owner.force
        walk = getattr(owner, f"{kind.field}_walk", None) or 0.0
        if isinstance(owner, Gyro) and kind.name == BIAS:
            sigma, walk = max(sigma, NO_BIAS), owner.bias_growth
        size = kind.entries or joint_count
        if sigma > 0 and size:
            name = f"{before}{kind.name}"
            table.append(ConstantError(name, size, sigma, kind.unit, kind.scale, walk))

    owners: list[tuple[str, Any, str]] = [("disturbances", forces, "")]
    if thrusters is not None:
        owners += [("valve", valve, f"{name}.") for name, valve in thrusters.valves.items()]
        owners.append(("thrusters", thrusters, f"{THRUSTERS}."))
    owners += [("sensor", errors, f"{name}.") for name, errors in suite.present().items()]
    for owner, errors, before in owners:
        for kind in KINDS.values():
            if kind.owner == owner:
                add(kind, errors, before)
    return tuple(table)


class Constants:
    """The constant errors of a suite, as a vector in units of their σ.

    Args:
        errors: the constant errors; default: none.

    Attributes:
        errors: the constant errors by name.
        size: length of the vector.
        of_first_order: names of those of first order.
        first_order: (n,) their places in the vector.
        of_joints: those that change the joints' motion.

    """

    def __init__(self, errors: tuple[ConstantError, ...] = ()) -> None:
        self.errors = {error.name: error for error in errors}
        self.size = sum(error.size for error in errors)
        self._places = places_of({error.name: error.size for error in errors})
        self.of_first_order = tuple(name for name in OF_FIRST_ORDER if name in self.errors)
        self.first_order = indices_of(self._places, self.of_first_order)
        self.of_joints = tuple(error for error in errors if error.kind in OF_JOINTS)

    @classmethod
    def of(cls, suite: SensorSuite, joint_count: int) -> "Constants":
        """Return the constant errors of a suite, for a spacecraft with so many joints."""
        return cls(constant_errors(suite, joint_count))

    def value(self, constants: Array, name: str) -> Array | None:
        """Return one error [SI units, rad], from the vector (k,); None if there is no such one."""
        if name not in self.errors:
            return None
        return np.asarray(self.errors[name].sigma * constants[self._places[name]])

    @property
    def yields(self) -> bool:
        """Whether joints or grasp are flexible."""
        return any(error.kind in YIELDING for error in self.errors.values())

    @property
    def of_thrust(self) -> list[str]:
        """Names of the errors that change the thrust, of one entry each."""
        return [error.name for error in self.errors.values() if error.kind in OF_THRUST]

    def place(self, name: str) -> slice:
        """Return the place of an error in the vector."""
        return self._places[name]
