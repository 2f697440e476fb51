"""Constant errors as unknowns of the likelihood: their σ, and their places in a state.

`SensorSuite` declares the σ of the constant errors of sensors and of the external forces. They are
the prior of the estimate. Every entry of one constant error has the same σ.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import indices_of, places_of
from cpid_drake.estimation.likelihood.error_effects import (
    EFFECTS,
    OF_FIRST_ORDER,
    ErrorEffect,
    Way,
)
from cpid_drake.sensors.error_kinds import KINDS, ErrorKind
from cpid_drake.sensors.suite import SensorSuite

ACCELERATION, TORQUE = "acceleration", "torque"
"""Kinds of a steady acceleration of the system's centre of mass and a torque about it, in W."""

ACCELERATION_B, TORQUE_B = "acceleration_B", "torque_B"
"""Kinds of the same in B."""

BIAS = "bias"
"""Kind of a gyro's bias, which walks from block to block."""

NO_BIAS = KINDS[BIAS].least
"""σ of the bias of a gyro that has none: one that is exact would have no σ [rad/s]."""

VALVE_FORCE = "force"
"""Kind of the force of a valve, which may fail."""

THRUSTERS = "thrusters"
"""Name before the errors that all valves have in common."""


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

    @cached_property
    def sensor(self) -> str:
        """Name of the sensor or the valve; empty for an external force."""
        return self.name.partition(".")[0] if "." in self.name else ""

    @cached_property
    def kind(self) -> str:
        """Kind of the error, such as "delay"."""
        return self.name.rpartition(".")[2]

    @cached_property
    def effect(self) -> ErrorEffect:
        """How it acts."""
        return EFFECTS[self.kind]

    @property
    def is_shared(self) -> bool:
        """Whether all logs of one hardware have the same error."""
        return KINDS[self.kind].is_shared


def constant_errors(suite: SensorSuite, joint_count: int) -> tuple[ConstantError, ...]:
    """Return the constant errors with σ > 0 of a suite, for a spacecraft with so many joints."""
    table, forces, thrusters = list[ConstantError](), suite.disturbances, suite.thrusters

    def add(kind: ErrorKind, owner: Any, before: str = "") -> None:
        """Add a kind of errors if its owner has it."""
        if not hasattr(owner, kind.field):
            return
        sigma = max(kind.to_SI * (getattr(owner, kind.field) or 0.0), kind.least)
        if kind.owner == "valve":
            sigma /= owner.force
        walk = getattr(owner, kind.walk, None) or 0.0
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
        acting: the errors by `Way`, and those of one sensor or valve by both.

    """

    def __init__(self, errors: tuple[ConstantError, ...] = ()) -> None:
        self.errors = {error.name: error for error in errors}
        self.size = sum(error.size for error in errors)
        self._places = places_of({error.name: error.size for error in errors})
        self.acting = defaultdict[str | tuple[str, str], tuple[ConstantError, ...]](tuple)
        for error in errors:
            for key in (error.effect.way, (error.effect.way, error.sensor)):
                self.acting[key] += (error,)
        rough = [error for way in OF_FIRST_ORDER for error in self.acting[way]]
        self.of_first_order = tuple(error.name for error in rough)
        self.first_order = indices_of(self._places, self.of_first_order)

    @classmethod
    def of(cls, suite: SensorSuite, joint_count: int) -> "Constants":
        """Return the constant errors of a suite, for a spacecraft with so many joints."""
        return cls(constant_errors(suite, joint_count))

    def value(self, constants: Array, error: ConstantError) -> Array:
        """Return one error [SI units, rad], from the vector (k,)."""
        return np.asarray(error.sigma * constants[self._places[error.name]])

    def sum(self, constants: Array, sensor: str, way: Way, size: int) -> Array:
        """Return what the errors of a sensor that act in a way change together, (size,)."""
        total = np.zeros(size)
        for error in self.acting[way, sensor]:
            total += error.effect.how @ self.value(constants, error)
        return total

    def place(self, name: str) -> slice:
        """Return the place of an error in the vector."""
        return self._places[name]
