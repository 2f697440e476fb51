"""Whether a table carries the spacecraft of a log, and what contradicts that.

A log whose base has x, y and yaw only is identified in the plane: nothing else is possible. Such
a log is recognized by tilts and heights that are exactly zero. A log of all six coordinates is
identified in the plane if the caller says so, because a free spacecraft whose bodies are all
symmetric about a plane moves in the same way, and then shows more than four parameters.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.plane import NORMAL_W, mean_normal, tilt
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError
from cpid_drake.identification.words import PLANAR_ASSUMED
from cpid_drake.logs.log import Log
from cpid_drake.spacecraft.spacecraft import Spacecraft

LEVEL = np.radians(5.0)
"""Angle between the table's normal and an axis of B up to which they are taken for the same."""

WOBBLE = np.radians(1.0)
"""Largest change of the tilt of a base on a table, as a standard deviation [rad]."""

HEIGHT = 0.005
"""Change of the height of a base on a level table, as a standard deviation [m]."""


def placed(
    spacecraft: Spacecraft, measurements: Log, planar: bool | None
) -> tuple[Spacecraft, tuple[str, ...], tuple[str, ...]]:
    """Return the spacecraft, on a table if the log is one of a table, warnings and failures.

    `planar` is that of `identify`.
    """
    normal, warnings = spacecraft.tree.normal_B, tuple[str, ...]()
    if normal is None:
        attitude, position = measurements.attitude.value, measurements.position.value
        is_held = not (attitude[:, 1:3].any() or position[:, 2].any())
        if planar is None and len(attitude) and is_held and np.ptp(attitude[:, 3]) > 0:
            planar, warnings = True, (PLANAR_ASSUMED,)
        if not planar:
            return spacecraft, (), ()
        normal = normal_in_base(measurements.attitude.value)
        spacecraft = spacecraft.on_table(normal)
    return spacecraft, warnings, _contradictions(normal, measurements)


def normal_in_base(attitude: Array) -> Array:
    """Return the table's normal (3,) in B, of attitudes (N, 4).

    It is the axis of B that is nearest to it, unless it is more than `LEVEL` away from all axes.
    """
    if not len(attitude):
        return NORMAL_W
    normal = mean_normal(attitude)
    axis = int(np.abs(normal).argmax())
    nearest = np.sign(normal[axis]) * np.eye(3)[axis]
    return nearest if normal @ nearest > np.cos(LEVEL) else normal


def common_normal(normals: Mapping[str, Array | None]) -> Array | None:
    """Return the table's normal (3,) in B of several logs, by their names; None without a table.

    Raises:
        InputError: only some have one, or it is not the same in all of them.

    """
    on_table = {name: normal for name, normal in normals.items() if normal is not None}
    if not on_table:
        return None
    [(first, normal), *others] = on_table.items()
    for name in normals:
        if name not in on_table:
            raise InputError(
                f"{first} has x, y and yaw only, as on a table, and {name} has not: say --planar "
                "or --no-planar"
            )
    for name, other in others:
        if other @ normal < np.cos(LEVEL):
            angle = np.degrees(np.arccos(np.clip(other @ normal, -1.0, 1.0)))
            raise InputError(
                f"{name} and {first} have other axes of the base along the table's normal "
                f"({angle:.0f}° apart): identify them one by one, and combine the results"
            )
    total = np.sum(list(on_table.values()), axis=0)
    return np.asarray(total / np.linalg.norm(total))


def could_be_planar(tree: KinematicTree, attitude: Array) -> bool:
    """Return whether a table that is not known may carry the base, for attitudes (N, 4)."""
    if tree.normal_B is not None or not any(body.joint >= 0 for body in tree.bodies):
        return False
    return replace(tree, normal_B=normal_in_base(attitude)).normal_C is not None


def _contradictions(normal_B: Array, measurements: Log) -> tuple[str, ...]:
    """Return the reasons why no table can have carried the base of a log."""
    attitude, position, reasons = measurements.attitude.value, measurements.position.value, []
    if len(attitude):
        angles = tilt(attitude, normal_B)
        if np.linalg.norm(_spread(angles)) > WOBBLE:
            largest = np.degrees(np.linalg.norm(angles - angles.mean(axis=0), axis=1).max())
            reasons.append(f"the base tilts by up to {largest:.2g} deg")
    if len(position):
        spread = _spread(position)
        if spread[2] > HEIGHT + np.sin(LEVEL) * np.hypot(*spread[:2]):
            reasons.append(f"the base's height changes by {np.ptp(position[:, 2]):.2g} m")
    if not reasons:
        return ()
    return (f"no table carries this spacecraft: {', and '.join(reasons)}; leave out --planar",)


def _spread(values: Array) -> Array:
    """Return the σ of columns (N, d) without white noise, which neighbours show (Neumann 1941)."""
    # E[(y_{k+1} − y_k)²] = 2 σ²
    white = np.mean(np.diff(values, axis=0) ** 2, axis=0) / 2 if len(values) > 1 else 0.0
    return np.asarray(np.sqrt(np.maximum(np.var(values, axis=0) - white, 0.0)))
