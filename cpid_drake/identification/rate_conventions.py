"""Names the unit or frame of logged rates with which momentum is conserved.

`sensing.files.consistency` compares rates with positions. The comparison here needs no positions,
but the spacecraft: it solves the momentum rows with the rates in every other convention. The right
one explains almost all of the known bodies' momentum, and the convention as read does not.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rows import RELATIVE_ROWS, STANDARD_ROWS, RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.momentum_rows import momentum_rows
from cpid_drake.identification.row_estimator import complete_samples
from cpid_drake.sensing.measurements import Measurements

_MOST_SAMPLES = 400
EXPLAINS = 0.05
"""Largest residual, as a share of the momentum, of a convention that explains the rows."""

CLEARLY = 5.0
"""Ratio of residuals from which a convention explains the rows clearly better."""

_ROUNDING = 1e-12
"""Share of the right-hand side up to which residuals are errors of the arithmetic alone."""

_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
_TURNS = {"degrees per second": np.pi / 180, "revolutions per minute (rpm)": np.pi / 30}

Change = Callable[[Telemetry], Telemetry]


def other_convention(tree: KinematicTree, measurements: Measurements) -> str:
    """Return the other unit or frame of the rates that the conservation of momentum asks for.

    Empty if the convention as read is as good as any, if no convention explains the samples, or if
    the sensors were not sampled at the same times.

    Args:
        tree: the known spacecraft.
        measurements: screened samples, joints in the spacecraft's order.

    """
    has_velocity = len(measurements.velocity) > 0
    family = STANDARD_ROWS if has_velocity else RELATIVE_ROWS
    telemetry = complete_samples(measurements, family)
    if telemetry is None or len(telemetry) < len(tree.unknowns) + family.momentum_size:
        return ""
    telemetry = telemetry.select(slice(0, 50 * _MOST_SAMPLES))
    has_attitude, has_position = len(measurements.attitude) > 0, len(measurements.position) > 0

    def unexplained(change: Change) -> float:
        motion = change(telemetry)
        if has_velocity and not has_position:
            travel = cumulative_trapezoid(motion.v_WB, motion.time, axis=0, initial=0.0)
            motion = replace(motion, p_WB=travel)
        motion = motion.select(slice(0, None, -(-len(motion) // _MOST_SAMPLES)))
        return _unexplained(tree, motion, family, is_turning=has_attitude)

    as_read = unexplained(lambda motion: motion)
    candidates = _conventions(tree, has_velocity=has_velocity, has_attitude=has_attitude)
    least, text = min((unexplained(change), text) for text, change in candidates)
    return text if least < min(EXPLAINS, as_read / CLEARLY) else ""


def _unexplained(
    tree: KinematicTree, motion: Telemetry, family: RowFamily, *, is_turning: bool
) -> float:
    """Return the residuals of the momentum rows as a share of their right-hand side.

    Without attitudes the momentum in W has no constant coordinates in B, so it is assumed zero.
    """
    momentum = TotalMomentum.unknown() if is_turning else TotalMomentum.zero()
    rows = momentum_rows(tree, motion, family, momentum)
    return unexplained_share(rows[:, :-1], rows[:, -1])


def unexplained_share(A: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the root mean square of the residuals of A x = b as a share of that of b.

    Errors of the arithmetic tell nothing: all shares below 1e-12 are returned as 1e-12.
    """
    sizes = np.linalg.norm(A, axis=0)
    A = A / np.where(sizes > 0, sizes, 1.0)
    x, *_ = np.linalg.lstsq(A, b, rcond=1e-10)
    share = float(np.linalg.norm(b - A @ x)) / max(float(np.linalg.norm(b)), 1e-300)
    return max(share, _ROUNDING)


def _conventions(
    tree: KinematicTree, *, has_velocity: bool, has_attitude: bool
) -> Iterator[tuple[str, Change]]:
    """Yield the conventions in which rates are often logged, as messages and changes of a log."""
    joints = sum(body.joint >= 0 for body in tree.bodies)
    rotors = np.array([tree.is_rotor(k) for k in range(joints)], dtype=bool)
    for unit, size in _TURNS.items():
        yield f"the angular velocity is in {unit}: it must be in rad/s", _scaled("w_WB", size)
        yield f"the joint rates are in {unit}: they must be in rad/s", _scaled("qdot", size)
        if rotors.any():
            sizes = np.where(rotors, size, 1.0)
            yield f"the wheels' rates are in {unit}: they must be in rad/s", _scaled("qdot", sizes)
    if has_velocity:
        for unit, size in _LENGTHS.items():
            text = f"the velocity is in {unit} per second: it must be in m/s"
            yield text, _scaled("v_WB", size)
    if has_attitude:
        if has_velocity:
            yield "the velocity is expressed in B's axes: it must be in W's axes", _from_B("v_WB")
        yield "the angular velocity is expressed in W's axes, not in B's", _from_W


def _scaled(name: str, size: float | NDArray[np.float64]) -> Change:
    """Return the change that multiplies a quantity."""

    def change(motion: Telemetry) -> Telemetry:
        return replace(motion, **{name: size * getattr(motion, name)})

    return change


def _from_B(name: str) -> Change:
    """Return the change that turns a vector from B's axes to W's axes."""

    def change(motion: Telemetry) -> Telemetry:
        R_WB = Rotation.from_quat(motion.quaternion_WB, scalar_first=True)
        return replace(motion, **{name: R_WB.apply(getattr(motion, name))})

    return change


def _from_W(motion: Telemetry) -> Telemetry:
    """Return the motion if the logged angular velocity is in W, not in B as it was read."""
    R_WB = Rotation.from_quat(motion.quaternion_WB, scalar_first=True)
    return replace(motion, w_WB=R_WB.inv().apply(motion.w_WB))
