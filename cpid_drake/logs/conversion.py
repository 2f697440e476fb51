"""Converts the columns of a file to a log in SI units, as a `ColumnMap` says.

`column_choice` explains the columns of the package itself, which are the default map.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.rotations import rotate_by_quaternion
from cpid_drake.errors import InputError
from cpid_drake.logs.clock import time_from_rates
from cpid_drake.logs.column_choice import ChosenColumns, choose_columns
from cpid_drake.logs.column_map import (
    QUATERNION_ORDERS,
    ColumnMap,
    JointPositionColumns,
    JointRateColumns,
    check_column_map,
    scale_of,
    with_entries,
)
from cpid_drake.logs.log import (
    THRUST,
    Log,
    Samples,
)
from cpid_drake.logs.table import Table
from cpid_drake.sensors.thrusters import VALVE

LARGEST = 1e9
"""Largest plausible number in a file [SI units, rad]."""

LARGEST_TIME = 1e11
"""Largest plausible time in a file [s]."""

_NORM = 1e-3
"""Largest deviation of the norm of a quaternion from 1."""

_EULER = {"yaw_pitch_roll": "ZYX", "euler_xyz": "XYZ"}

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LogFile:
    """A log as read from a file, and what is wrong in the file.

    Attributes:
        measurements: the samples of every sensor that have no problem.
        row_count: number of rows in the file.
        problems: the problems with their places, in the order of rows.
        partial: by sensor, the number of incomplete samples, which are left out.
        ignored: columns that are not used.
        left_out_joints: joints of the log that the spacecraft does not have.

    """

    measurements: Log
    row_count: int
    problems: Sequence[str] = ()
    partial: Mapping[str, int] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()
    left_out_joints: tuple[str, ...] = ()


def from_columns(columns: Mapping[str, ArrayLike], column_map: ColumnMap | None = None) -> Log:
    """Return a log from columns in memory, such as those of a MATLAB file or a data frame.

    Args:
        columns: by name, numbers (N,), NaN for absent samples.
        column_map: what the columns mean; None for the package's own columns.

    Raises:
        InputError: a column is no array of N numbers; or for the same reasons as `read_columns`,
            also for the first bad row.

    """
    arrays = {}
    for name, column in columns.items():
        try:
            arrays[name] = np.asarray(column, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"column '{name}' is not made of numbers: {error}") from error
    shapes = {array.shape for array in arrays.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise InputError("all columns must have one dimension and the same length")
    found = read_columns(column_map or ColumnMap(), Table(arrays), "the columns")
    if found.problems:
        raise InputError(found.problems[0])
    return found.measurements


def read_columns(
    given: ColumnMap,
    table: Table,
    where: str,
    *,
    map_name: str = "the map",
    joints: Collection[str] | None = None,
) -> LogFile:
    """Convert the columns of a file to a log.

    Args:
        given: the map of the columns.
        table: the columns.
        where: the file's name in messages.
        map_name: the map's name in messages.
        joints: the spacecraft's joints, if they are known; columns of others are then left out,
            unless the log lacks one of the spacecraft's joints.

    Raises:
        InputError: see `choose_columns`; or there are no samples.

    """
    check_column_map(given, map_name)
    chosen = choose_columns(given, table, where, map_name=map_name, joints=joints)
    for name in chosen.names:
        if name in table.unreadable:
            raise InputError(f"{where}: '{name}' {table.unreadable[name]}")
    conversion = _Conversion(given, table, chosen)
    measurements = conversion.measurements()
    if not np.isfinite(measurements.interval[0]) and not conversion.problems:
        raise InputError(f"{where}: the file has no samples")
    used = set(chosen.names)
    return LogFile(
        measurements,
        len(table) + len(table.problems),
        [text for _, text in sorted(conversion.problems, key=lambda problem: problem[0])],
        {name: count for name, count in conversion.partial.items() if count},
        tuple(name for name in (*table.columns, *table.unreadable) if name not in used),
        chosen.left_out,
    )


# -- values ---------------------------------------------------------------------------------------


class _Conversion:
    """The conversion of one file, with what is wrong in it.

    Attributes:
        problems: numbers of rows, and texts.
        partial: by sensor, the number of incomplete samples.

    """

    def __init__(self, given: ColumnMap, table: Table, chosen: ChosenColumns) -> None:
        self._map, self._table, self._chosen = given, table, chosen
        self.problems = list(table.problems)
        self.partial = Counter(table.rejected)
        self._usable = np.ones(len(table), dtype=bool)
        self._samples: dict[str, Samples] = {}

    def measurements(self) -> Log:
        """Return the samples without problems; positions of joints with rates only are NaN."""
        given, chosen = self._map, self._chosen
        self._refuse_texts()
        time = self._times()
        constant = given.joint_positions.constant
        still = dict.fromkeys(constant, 0.0) if chosen.rates else {}
        blocks = {
            "attitude": self._block("attitude", given.attitude.unit),
            "gyro": self._block("gyro", given.angular_velocity.unit),
            "position": self._block("position", given.position.unit),
            "velocity": self._block("velocity", given.velocity.unit),
            "encoders": self._joint_block(given.joint_positions, chosen.positions, constant),
            "joint_rates": self._joint_block(given.joint_rates, chosen.rates, still),
            "force": self._block("force", given.thrust.force_unit),
            "torque": self._block("torque", given.thrust.torque_unit),
        }
        self._refuse_order(time)
        q = self._quaternions(blocks["attitude"])
        inverse = q * [1.0, -1.0, -1.0, -1.0]
        w = self._spatial(blocks["gyro"], last=True) @ given.angular_velocity.R_BS.T
        in_B = rotate_by_quaternion(inverse, w) if chosen.in_world else w
        p, arm = self._spatial(blocks["position"]), given.position.point_B
        if arm.any():
            p = p - rotate_by_quaternion(q, arm)
        v, point = self._spatial(blocks["velocity"]), given.velocity.point_B
        if given.velocity.frame == "body":
            v = rotate_by_quaternion(q, v)
        if point.any():
            v = v - rotate_by_quaternion(q, np.cross(in_B, point))
        has_digits = given.attitude.order in QUATERNION_ORDERS and not chosen.is_planar
        has_digits &= np.array_equal(given.attitude.R_BS, np.eye(3))
        attitude = self._ordered(blocks["attitude"]) if has_digits else q
        for name, value in (
            ("attitude", attitude),
            ("gyro", in_B),
            ("position", p),
            ("velocity", v),
            ("encoders", blocks["encoders"]),
            ("joint_rates", blocks["joint_rates"]),
        ):
            self._take(name, time, value, blocks[name])
        positions = [*chosen.positions, *constant]
        joints = tuple(dict.fromkeys([*positions, *chosen.rates]))
        if len(joints) > len(positions):
            samples = self._samples["encoders"]
            value = np.full((len(samples), len(joints)), np.nan)
            value[:, [joints.index(joint) for joint in positions]] = samples.value
            self._samples["encoders"] = Samples(samples.time, value)
        force, torque = blocks["force"], blocks["torque"]
        if force.shape[1] or torque.shape[1]:
            nothing = np.zeros((len(force), 3))
            f = self._spatial(force) if force.shape[1] else nothing
            tau = self._spatial(torque, last=True) if torque.shape[1] else nothing
            wrench = np.hstack([tau + np.cross(given.thrust.point_B, f), f])
            self._take(THRUST, time, wrench, np.hstack([force, torque]))
        for name in chosen.groups:
            if name.startswith(VALVE):
                opening = self._plausible((name,), self._table.block((name,)))
                self._take(name, time, opening, opening)
        frame = "world" if chosen.in_world else "body"  # also where names of columns say it
        used = with_entries(given, {"angular_velocity.frame": frame})
        found = time_from_rates(self._samples) if given.time.from_rates else self._samples
        return Log(joints, found, used)

    def _take(self, name: str, time: Array, value: Array, logged: Array) -> None:
        """Add the complete samples of a sensor; count those of which some cells are absent."""
        if not logged.shape[1] and name != "encoders":
            return
        # A conversion makes all entries NaN if it lacks a cell, also of another quantity.
        there = np.isfinite(value).all(axis=1) & np.isfinite(logged).all(axis=1) & self._usable
        self.partial[name] += int((self._usable & np.isfinite(logged).any(axis=1) & ~there).sum())
        everything = there.all()
        self._samples[name] = Samples(
            time if everything else time[there], value if everything else value[there]
        )

    def _block(self, group: str, unit: str) -> Array:
        """Return the columns of a group in SI units; entries of quaternions have no unit."""
        columns = self._chosen.groups[group]
        is_quaternion = group == "attitude" and len(columns) == 4
        block = self._table.block(columns)
        scale = 1.0 if is_quaternion else scale_of(unit)
        return self._plausible(columns, block if scale == 1.0 else block * scale)

    def _joint_block(
        self,
        section: JointPositionColumns | JointRateColumns,
        columns: Mapping[str, str],
        constant: Mapping[str, float],
    ) -> Array:
        """Return the columns of joints in SI units, then those of constant joints."""
        scales = np.array([scale_of(section.units.get(joint, section.unit)) for joint in columns])
        scales *= [-1.0 if joint in self._map.reversed_joints else 1.0 for joint in columns]
        block = self._table.block(columns.values())
        block = block if (scales == 1.0).all() else block * scales
        block = self._plausible(tuple(columns.values()), block)
        if not constant:
            return block
        return np.hstack([block, np.tile([*constant.values()], (len(block), 1))])

    def _spatial(self, block: Array, *, last: bool = False) -> Array:
        """Return vectors (N, 3): what a table holds is zero; NaN without columns."""
        if block.shape[1] == 3:
            return block
        if not block.shape[1]:
            return np.full((len(block), 3), np.nan)
        zeros = np.zeros((len(block), 3 - block.shape[1]))
        return np.hstack([zeros, block] if last else [block, zeros])

    def _ordered(self, block: Array) -> Array:
        """Return quaternions of R_WB, scalar first, with the logged digits."""
        given = self._map.attitude
        q = block[:, [3, 0, 1, 2]] if given.order == "xyzw" and block.shape[1] else block
        return q * [1.0, -1.0, -1.0, -1.0] if given.direction == "R_BW" and q.shape[1] else q

    def _quaternions(self, block: Array) -> Array:
        """Return unit quaternions of R_WB (N, 4), scalar first; NaN where the attitude is absent.

        Quaternions of another norm than 1 are problems.
        """
        given, q = self._map.attitude, np.full((len(block), 4), np.nan)
        there = np.isfinite(block).all(axis=1) & (block.shape[1] > 0)
        if not there.any():
            return q
        if block.shape[1] == 4:
            q = self._ordered(block)
            with np.errstate(over="ignore"):
                norm = np.linalg.norm(q, axis=1)
            for row in np.flatnonzero(self._usable & (np.abs(norm - 1) > _NORM)):
                self._refuse(row, "", f"the quaternion's norm is {norm[row]:.6g}, not 1")
            return self._in_base(q / np.where(self._usable & there, norm, np.nan)[:, None])
        if self._chosen.is_planar:
            half = block[there, 0] / 2
            zeros = np.zeros((len(half), 2))
            q[there] = np.column_stack([np.cos(half), zeros, np.sin(half)])
        else:
            q[there] = self._rotation(block[there]).as_quat(scalar_first=True)
        return self._in_base(q * [1.0, -1.0, -1.0, -1.0] if given.direction == "R_BW" else q)

    def _in_base(self, q: Array) -> Array:
        """Return quaternions of R_WB from those of the axes S of the map."""
        R_BS, there = self._map.attitude.R_BS, np.isfinite(q).all(axis=1)
        if np.array_equal(R_BS, np.eye(3)) or not there.any():
            return q
        Rotation = scipy.spatial.transform.Rotation
        turned = Rotation.from_quat(q[there], scalar_first=True) * Rotation.from_matrix(R_BS.T)
        q = q.copy()
        q[there] = turned.as_quat(scalar_first=True)
        return q

    def _rotation(self, angles: Array) -> "scipy.spatial.transform.Rotation":
        Rotation = scipy.spatial.transform.Rotation  # imported at its first use: it takes 0.25 s
        order = self._map.attitude.order
        if order == "rotation_vector":
            return Rotation.from_rotvec(angles)
        if order == "roll_pitch_yaw":
            order, angles = "yaw_pitch_roll", angles[:, ::-1]
        return Rotation.from_euler(_EULER[order], angles)

    # -- problems ----------------------------------------------------------------------------

    def _refuse(self, row: int | np.intp, column: str, text: str) -> None:
        number, place = self._table.place(row, column)
        self.problems.append((number, f"{place}: {text}"))
        self._usable[row] = False

    def _refuse_texts(self) -> None:
        for name in self._chosen.names:
            for row, cell in self._table.texts.get(name, {}).items():
                remedy = "give a number with a decimal point"
                if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
                    remedy = "leave the cell of an absent sample empty"
                self._refuse(row, name, f"'{cell:.40}' is not a finite number; {remedy}")

    def _times(self) -> Array:
        """Return the time (N,) [s]; rows without a plausible one are problems."""
        given, column = self._map.time, self._chosen.time[0]
        ticks = self._table.columns[column] - given.epoch
        time = ticks / given.rate if given.rate else ticks * scale_of(given.unit)
        if given.nanoseconds is not None:
            time = time + self._table.columns[given.nanoseconds] * 1e-9
        for row in np.flatnonzero(self._usable & ~np.isfinite(time)):
            self._refuse(row, column, "the time is absent")
        for row in np.flatnonzero(self._usable & (np.abs(time) > LARGEST_TIME)):
            self._refuse(
                row,
                column,
                f"{time[row]:g} is implausible: beyond {LARGEST_TIME:g}; is it in ns? It must be "
                "in s, unless a map of columns says otherwise",
            )
        return time

    def _refuse_order(self, time: Array) -> None:
        latest = np.fmax.accumulate(np.append(-np.inf, np.where(self._usable, time, -np.inf)))[:-1]
        for row in np.flatnonzero(self._usable & (time <= latest)):
            now, before = (
                np.format_float_positional(t, trim="-") for t in (time[row], latest[row])
            )
            what = "is there twice" if time[row] == latest[row] else f"comes after {before} s"
            self._refuse(row, self._chosen.time[0], f"time {now} s {what}")

    def _plausible(self, columns: Sequence[str], block: Array) -> Array:
        """Return a block in SI units, after a look for implausibly large numbers."""
        if block.size and max(np.nanmax(block, initial=0), -np.nanmin(block, initial=0)) > LARGEST:
            for row, k in np.argwhere(np.abs(block) > LARGEST):
                text = f"{block[row, k]:g} is implausible: beyond {LARGEST:g}"
                self._refuse(row, columns[k], text)
        return block
