"""Columns of logs on a table, whose base has three coordinates: x, y and yaw.

A table with a column `yaw` [rad] and no quaternion is such a log: `yaw` is the rotation of B about
W's z axis, the table's normal, and `x`, `y`, `vx`, `vy`, `wz` or `bwz`, and the thrust
"thrust_fx", "thrust_fy" and "thrust_tz" need no further columns. What the table holds is constant:
roll, pitch, z and their rates are exactly zero in the samples.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.measurements import FORCE_COLUMNS, TORQUE_COLUMNS
from cpid_drake.sensing.sensors import SENSORS

YAW = "yaw"
"""The column of the angle of B about W's z axis."""

_QUATERNION = SENSORS["attitude"].columns
_IN_PLANE = {
    ("x", "y"): SENSORS["position"].columns,
    ("vx", "vy"): SENSORS["velocity"].columns,
    ("wz",): SENSORS["gyro"].columns_in_W,
    ("bwz",): SENSORS["gyro"].columns,
    FORCE_COLUMNS[:2]: FORCE_COLUMNS,
    TORQUE_COLUMNS[2:]: TORQUE_COLUMNS,
}


def is_planar(names: Sequence[str]) -> bool:
    """Return whether a table with these columns is a log on a table."""
    return YAW in names and not any(name in names for name in _QUATERNION)


def spatial_names(names: Sequence[str]) -> list[str]:
    """Return the columns of `spatial`."""
    if not is_planar(names):
        return list(names)
    result = [name for name in names if name != YAW] + list(_QUATERNION)
    for few, all_three in _IN_PLANE.items():
        if all(name in names for name in few):
            result += [name for name in all_three if name not in names]
    return result


def spatial(columns: Sequence[str], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values (N, D) of the columns `spatial_names`, from those (N, C) of `columns`."""
    if not is_planar(columns):
        return values
    place = {name: k for k, name in enumerate(columns)}
    kept = [k for name, k in place.items() if name != YAW]
    blocks = [values[:, kept], yaw_quaternion(values[:, place[YAW]])]
    for few, all_three in _IN_PLANE.items():
        if all(name in place for name in few):
            missing = [name for name in all_three if name not in place]
            blocks.append(held(values[:, place[few[0]]], len(missing)))
    return np.hstack(blocks)


def yaw_quaternion(yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions (N, 4), scalar first, of rotations about z by angles (N,) [rad]."""
    nothing = held(yaw, 2)
    return np.column_stack([np.cos(yaw / 2), nothing, np.sin(yaw / 2)])


def held(like: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return zeros (N, count) for what a table holds; NaN where a sample (N,) is absent."""
    return np.tile(np.where(np.isnan(like), np.nan, 0.0)[:, None], (1, count))
