"""The log of thrust as forces of actuators, with what changes them.

An actuator pushes with a force a(t) along a direction at a point, or turns with a moment. Thrusters
with valves (`cpid_drake.sensors.thrusters`) are such actuators. A log of the total force and torque
in B is that of six: three moments and three forces at B's origin, with one error of their scale.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.likelihood.constants import (
    COMMON_FORCE,
    THRUST_SCALE,
    THRUSTERS,
    VALVE_DELAY,
    VALVE_FORCE,
    VALVE_LOSS,
    Constants,
)
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.thrusters import Thrusters


@dataclass(frozen=True, eq=False)
class Actuators:
    """Where V actuators act.

    Attributes:
        position: (V, 3) of the points [m], in B or C.
        direction: (V, 3) of the forces, in B, C or W.
        moment: (V, 3) beside that of the force, in B.
        on_target: (V,) whether the point, and a direction that is not in W, are in C.
        in_world: (V,) whether the direction is in W.

    """

    position: Array
    direction: Array
    moment: Array
    on_target: NDArray[np.bool_]
    in_world: NDArray[np.bool_]

    @classmethod
    def of_wrench(cls) -> "Actuators":
        """Return those of the torque about B's origin and of the force there, both in B."""
        zero, one, no = np.zeros((3, 3)), np.eye(3), np.zeros(6, bool)
        return cls(np.zeros((6, 3)), np.vstack([zero, one]), np.vstack([one, zero]), no, no)

    @classmethod
    def of_valves(cls, thrusters: Thrusters) -> "Actuators":
        """Return those of valves."""
        valves = thrusters.valves.values()
        direction = np.array([valve.direction for valve in valves])
        return cls(
            np.array([valve.position for valve in valves]),
            direction / np.linalg.norm(direction, axis=1, keepdims=True),
            np.zeros((len(direction), 3)),
            np.array([valve.on == "target" for valve in valves]),
            np.array([valve.axes == "world" for valve in valves]),
        )


@dataclass(frozen=True, eq=False)
class ThrustLog:
    """What the actuators do over time.

    Attributes:
        actuators: V actuators.
        samples: (M, V) force or moment of each, from its time until the next sample [N, N·m].
        by: (M, V, P) its derivatives by the errors of the thrust, in SI units.

    """

    actuators: Actuators
    samples: Samples
    by: Array

    def acts(self, start: float, end: float) -> bool:
        """Return whether there is any thrust between two times [s]."""
        inside = (self.samples.time > start) & (self.samples.time < end)
        return bool(self.samples.value[inside].any() or self.samples.held_at(start).any())


def thrust_log(
    samples: Samples, thrusters: Thrusters | None, constants: Constants, nominal: Array
) -> ThrustLog | None:
    """Return the log of thrust with given errors; None without samples.

    Args:
        samples: torque and force in B (M, 6), or the openings of the valves (M, V).
        thrusters: the valves; None for torque and force.
        constants: the constant errors.
        nominal: (k,) their values, in units of their σ.

    """
    names = constants.of_thrust
    by = np.zeros((*samples.value.shape, len(names)))

    def error(name: str) -> float:
        value = constants.value(nominal, name)
        return 0.0 if value is None else float(value[0])

    def put(name: str, derivative: Array) -> None:
        if name in names:
            by[..., names.index(name)] = derivative

    if not len(samples):
        return None
    if thrusters is None:
        put(THRUST_SCALE, samples.value)
        scaled = Samples(samples.time, (1 + error(THRUST_SCALE)) * samples.value)
        return ThrustLog(Actuators.of_wrench(), scaled, by)
    common, loss, delay = (
        f"{THRUSTERS}.{kind}" for kind in (COMMON_FORCE, VALVE_LOSS, VALVE_DELAY)
    )
    others = np.maximum(samples.value.sum(axis=1, keepdims=True) - 1, 0.0)
    relative = [f"{name}.{VALVE_FORCE}" for name in thrusters.valves]
    force = samples.value * np.array([valve.force for valve in thrusters.valves.values()])
    own, shared = 1 + np.array([error(name) for name in relative]), 1 + error(common)
    left = 1 - error(loss) * others
    put(common, force * own * left)
    put(loss, -force * own * shared * others)
    for k, (name, column) in enumerate(zip(relative, (force * shared * left).T)):
        put(name, column[:, None] * (np.arange(len(relative)) == k))
    late = Samples(samples.time + error(delay), force * own * shared * left)
    return ThrustLog(Actuators.of_valves(thrusters), late, by)
