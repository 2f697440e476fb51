"""The log of thrust as forces of actuators, with what changes them.

An actuator pushes with a force a(t) along a direction at a point, or turns with a moment. Thrusters
with valves (`cpid_drake.sensors.thrusters`) are such actuators. A log of the total force and torque
in B is that of six: three moments and three forces at B's origin, with one error of their scale.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.likelihood.constants import Constants
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
    if not len(samples):
        return None
    names, force = list[str](), np.ones(samples.value.shape[1])
    actuators = Actuators.of_wrench()
    if thrusters is not None:
        actuators, names = Actuators.of_valves(thrusters), list(thrusters.valves)
        force = np.array([valve.force for valve in thrusters.valves.values()])
    # f = openings · force · Π (1 + e_k g_k), with the share g_k of a unit of the error e_k
    value, errors = samples.value * force, constants.acting["thrust"]
    each = [e.effect.how(samples.value, np.array([n == e.sensor for n in names])) for e in errors]
    shares = np.array([np.broadcast_to(share, value.shape) for share in each], dtype=float)
    shares = shares.reshape(len(errors), *value.shape)
    sizes = np.array([constants.value(nominal, error)[0] for error in errors])
    factors = 1 + sizes[:, None, None] * shares
    by = np.zeros((*value.shape, len(errors)))
    for k, share in enumerate(shares):
        by[..., k] = value * share * np.delete(factors, k, axis=0).prod(axis=0)
    late = sum(float(constants.value(nominal, e)[0]) for e in constants.acting["thrust_delay"])
    return ThrustLog(actuators, Samples(samples.time + late, value * factors.prod(axis=0)), by)
