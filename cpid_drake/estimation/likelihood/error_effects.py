"""How the constant errors act on motion and readings: one record for each kind.

`sensors.error_kinds` holds the kinds with their units, sizes and words. A model loops over the
errors that a log has, by the way in which they act, and asks each record how; it compares no kinds.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array

OfMotion = Literal["torque_W", "acceleration_W", "torque_B", "acceleration_B", "compliance"]
OfRotors = Literal["rotors_B", "rotors_C"]
OfRecords = Literal["thrust", "thrust_delay", "joints", "clock"]
OfReading = Literal["turn", "matrix", "offset", "point"]
Way = OfMotion | OfRotors | OfRecords | OfReading
"""Ways to act, each with what `ErrorEffect.how` is.

On the motion of the system:

- torque_W, torque_B: axes (3, n) of a steady torque about the centre of mass, in this frame.
- acceleration_W, acceleration_B: those of an acceleration of it; the latter to first order.
- rotors_B, rotors_C: those of the angular momentum of rotors in base or target.
- compliance: places among those of the joints, then those about and along C's axes; to first order.
- thrust: the share (M, V) by which actuators push more, from the samples of the thrust (M, V) and
  from which of them (V,) have the error.
- thrust_delay: nothing. The thrust acts later than its log.

On the motion of the joints, of which positions m (M, J) were measured at t (M, 1) since the origin:

- joints: x (M, J) by which they are too large, ∂x/∂m and ∂x/∂t.

On the readings of a sensor:

- clock: a and b of stamps that are late by a + b t, at t since the origin.
- turn: derivative (3, n) of the rotation vector of the sensor's axes.
- matrix, offset: that of the matrix that multiplies a reading, (9, n), or of what is added, (3, n).
- point: that of the point in B that is measured, (3, n).
"""

OF_FIRST_ORDER: tuple[Way, ...] = ("compliance", "acceleration_B")
"""Ways of effects of first order about zero: the predicted motion does not have them."""


@dataclass(frozen=True)
class ErrorEffect:
    """How the errors of a kind act.

    Attributes:
        way: see `Way`.
        how: likewise, for errors of 1 in SI units.
        on_wheels: whether wheels have it too, if it is an error of joints.

    """

    way: Way
    how: Any = None
    on_wheels: bool = True


def _of_all(openings: Array, having: NDArray[np.bool_]) -> Array:
    return np.ones(openings.shape[1])


def _less_by_others(openings: Array, having: NDArray[np.bool_]) -> Array:
    """Return that of valves which share a supply: each further open valve costs all of them."""
    others = np.maximum(openings.sum(axis=1, keepdims=True) - 1, 0.0)
    return np.asarray(-others)


_ONE, _OF_MATRIX = np.eye(3), np.eye(9)
_DIAGONAL = np.arange(0, 9, 4)

EFFECTS: dict[str, ErrorEffect] = {
    "acceleration": ErrorEffect("acceleration_W", _ONE),
    "torque": ErrorEffect("torque_W", _ONE),
    "acceleration_B": ErrorEffect("acceleration_B", _ONE),
    "torque_B": ErrorEffect("torque_B", _ONE),
    "wheel": ErrorEffect("rotors_B", _ONE),
    "target_wheel": ErrorEffect("rotors_C", _ONE),
    "joint_compliance": ErrorEffect("compliance", slice(None, -6)),
    "compliance": ErrorEffect("compliance", slice(-6, -3)),
    "translational_compliance": ErrorEffect("compliance", slice(-3, None)),
    "thrust_scale": ErrorEffect("thrust", _of_all),
    "force": ErrorEffect("thrust", lambda openings, having: having),
    "common_force": ErrorEffect("thrust", _of_all),
    "loss": ErrorEffect("thrust", _less_by_others),
    "valve_delay": ErrorEffect("thrust_delay"),
    "zero": ErrorEffect("joints", lambda m, t: (1.0, 0.0, 0.0)),
    "drift": ErrorEffect("joints", lambda m, t: (t, 0.0, 1.0)),
    "joint_scale": ErrorEffect("joints", lambda m, t: (m, 1.0, 0.0)),
    "eccentricity_sine": ErrorEffect(
        "joints", lambda m, t: (np.sin(m), np.cos(m), 0.0), on_wheels=False
    ),
    "eccentricity_cosine": ErrorEffect(
        "joints", lambda m, t: (np.cos(m), -np.sin(m), 0.0), on_wheels=False
    ),
    "delay": ErrorEffect("clock", (1.0, 0.0)),
    "clock_drift": ErrorEffect("clock", (0.0, 1.0)),
    "mounting": ErrorEffect("turn", _ONE),
    "scale": ErrorEffect("matrix", _OF_MATRIX[:, _DIAGONAL]),
    "misalignment": ErrorEffect("matrix", np.delete(_OF_MATRIX, _DIAGONAL, axis=1)),
    "bias": ErrorEffect("offset", _ONE),
    "lever_arm": ErrorEffect("point", _ONE),
}
"""The records by the names of `error_kinds.KINDS`."""
