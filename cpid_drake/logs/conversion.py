"""Converts the columns of a file to a log in SI units, as a `ColumnMap` says.

`column_choice` explains the columns of the package itself, which are the default map.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import conjugate, rotate_by_quaternion
from cpid_drake.files.errors import InputError, listed, prefix_errors
from cpid_drake.logs.clock import refuse_single_precision, time_from_rates
from cpid_drake.logs.column_choice import with_own_columns
from cpid_drake.logs.column_map import (
    QUATERNION_ORDERS,
    ColumnMap,
    JointPositionColumns,
    JointRateColumns,
    check_column_map,
    scale_of,
)
from cpid_drake.logs.dropouts import without_marks
from cpid_drake.logs.joined import files_of_sensors
from cpid_drake.logs.log import THRUST, Log, Samples, with_fixed_joints
from cpid_drake.logs.noise_estimation import FEWEST
from cpid_drake.logs.screening import LARGEST, QUATERNION_NORM, is_later
from cpid_drake.logs.table import LogTable
from cpid_drake.logs.unwrapping import unwrapped
from cpid_drake.sensors.thrusters import VALVE

LARGEST_TIME = 1e11
"""Largest plausible time in a file [s]."""


@dataclass(frozen=True, eq=False)
class LogFile:
    """A log as read from a file, and what is wrong in the file.

    Attributes:
        log: the samples of every sensor that have no problem.
        time: (N,) of the rows [s].
        row_count: number of rows in the file.
        problems: the problems with their places, in the order of rows.
        partial: by sensor, the number of incomplete samples, which are left out.
        ignored: columns that are not used.
        left_out_joints: joints of the log that the spacecraft does not have.

    """

    log: Log
    time: Array
    row_count: int
    problems: Sequence[str] = ()
    partial: Mapping[str, int] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()
    left_out_joints: tuple[str, ...] = ()


def read_columns(
    given: ColumnMap,
    table: LogTable,
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
        InputError: see `with_own_columns`; or there are no samples.

    """
    check_column_map(given, map_name)
    used = with_own_columns(given, table, where, map_name=map_name, joints=joints)
    table = without_marks(table, used)
    conversion = _Conversion(used, table)
    with prefix_errors(where):
        log = conversion.log()
    left_out = tuple(joint for joint in used.ignore_joints if joint not in given.ignore_joints)
    travels = {joint: _travel(table, used, joint) for joint in left_out}
    log = with_fixed_joints(log, travels)
    if not np.isfinite(log.interval[0]) and not conversion.problems:
        raise InputError(f"{where}: the file has no samples")
    names = {*used.named}
    return LogFile(
        log,
        conversion.time,
        len(table) + len(table.problems),
        [text for _, text in sorted(conversion.problems, key=lambda problem: problem[0])],
        {name: count for name, count in conversion.partial.items() if count},
        tuple(name for name in (*table.columns, *table.unreadable) if name not in names),
        left_out,
    )


def _travel(table: LogTable, used: ColumnMap, joint: str) -> float:
    """Return the range of positions of a joint that is not used, in the log's unit."""
    section = used.joint_positions
    column = table.columns.get(f"{section.prefix}{joint}{section.suffix}", np.empty(0))
    column = column[np.isfinite(column)]
    return float(np.ptp(column)) if column.size else 0.0


# -- values ---------------------------------------------------------------------------------------


class _Conversion:
    """The conversion of one file, with what is wrong in it.

    Attributes:
        time: (N,) of the rows [s].
        problems: numbers of rows, and texts.
        partial: by sensor, the number of incomplete samples.

    """

    def __init__(self, used: ColumnMap, table: LogTable) -> None:
        self._map, self._table = used, table
        self.problems = list(table.problems)
        self.partial = Counter(table.rejected)
        self._usable = np.ones(len(table), dtype=bool)
        self.time = np.empty(0)
        self._samples: dict[str, Samples] = {}
        self.notes = dict[str, tuple[str, ...]](table.notes)
        rates, positions = used.joint_rates.columns, used.joint_positions.columns
        empty = [joint for joint, column in rates.items() if table.is_empty(column)]
        if empty:
            used.joint_rates.columns = {}
            text = "empty or NaN in all rows: not filled"
            if len(empty) < len(rates):
                text = f"those of {listed(empty)} are not filled, and those of all are left out"
            self.notes["joint_rates"] = (*self.notes.get("joint_rates", ()), text)
        for joint in [each for each in positions if each in used.joint_rates.columns]:
            if table.is_empty(positions[joint]):
                del positions[joint]

    def log(self) -> Log:
        """Return the samples without problems; positions of joints with rates only are NaN."""
        used = self._map
        self._refuse_texts()
        self.time = time = self._times()
        has_angles = used.attitude.order not in (*QUATERNION_ORDERS, "mrp")
        attitude = self._block(used.attitude.columns, used.attitude.unit if has_angles else "")
        gyro, position, velocity = (
            self._block(part.columns, part.unit)
            for part in (used.angular_velocity, used.position, used.velocity)
        )
        force = self._block(used.thrust.force, used.thrust.force_unit)
        torque = self._block(used.thrust.torque, used.thrust.torque_unit)
        constant, rates = used.joint_positions.constant, used.joint_rates
        encoders = self._joint_block(used.joint_positions, constant)
        joint_rates = self._joint_block(
            rates, dict.fromkeys(constant, 0.0) if rates.columns else {}
        )
        self._refuse_order(time)
        encoders = self._in_common_rows("encoders", time, encoders)
        joint_rates = self._in_common_rows("joint_rates", time, joint_rates)
        q = self._quaternions(attitude)
        R_WB = q / np.linalg.norm(q, axis=1, keepdims=True)
        w = _spatial(gyro, last=True) @ used.angular_velocity.R_BS.T
        if used.angular_velocity.frame == "world":
            w = rotate_by_quaternion(conjugate(R_WB), w)
        p, v = _spatial(position), _spatial(velocity)
        if used.position.point_B.any():
            p = p - rotate_by_quaternion(R_WB, used.position.point_B)
        if used.velocity.frame == "body":
            v = rotate_by_quaternion(R_WB, v)
        if used.velocity.point_B.any():
            v = v - rotate_by_quaternion(R_WB, np.cross(w, used.velocity.point_B))
        f, tau = (
            _spatial(part, last=part is torque) if part.shape[1] else np.zeros((len(part), 3))
            for part in (force, torque)
        )
        wrench = np.hstack([tau + np.cross(used.thrust.point_B, f), f])
        parts = {"attitude": (q, attitude), "gyro": (w, gyro)}
        parts |= {"position": (p, position), "velocity": (v, velocity)}
        parts |= {"encoders": (encoders, encoders), "joint_rates": (joint_rates, joint_rates)}
        parts[THRUST] = wrench, np.hstack([force, torque])
        for valve, column in used.valves.items():
            parts[VALVE + valve] = 2 * (self._block([column]),)
        for name, (value, logged) in parts.items():
            self._take(name, time, value, logged)
        positions = [*used.joint_positions.columns, *constant]
        joints = tuple(dict.fromkeys([*positions, *rates.columns]))
        if len(joints) > len(positions):
            samples = self._samples["encoders"]
            value = np.full((len(samples), len(joints)), np.nan)
            value[:, [joints.index(joint) for joint in positions]] = samples.value
            self._samples["encoders"] = Samples(samples.time, value)
        kept = time_from_rates(self._samples) if used.time.from_rates else self._samples
        return Log(joints, kept, used, notes=self.notes, clocks=files_of_sensors(used, self._table))

    def _take(self, name: str, time: Array, value: Array, logged: Array) -> None:
        """Add the complete samples of a sensor; count those of which some cells are absent."""
        if not logged.shape[1] and name != "encoders":
            return
        # A conversion makes all entries NaN if it lacks a cell, also of another quantity.
        is_usable = np.isfinite(value).all(axis=1) & np.isfinite(logged).all(axis=1) & self._usable
        self.partial[name] += int(
            (self._usable & np.isfinite(logged).any(axis=1) & ~is_usable).sum()
        )
        samples = Samples(time, value)
        self._samples[name] = samples if is_usable.all() else samples.where(is_usable)

    def _block(self, columns: Sequence[str], unit: str = "", scales: ArrayLike = 1.0) -> Array:
        """Return columns in SI units."""
        block = self._table.block(columns)
        scales = np.asarray(scale_of(unit) if unit else scales)
        block = block if (scales == 1.0).all() else block * scales
        if block.size and max(np.nanmax(block, initial=0), -np.nanmin(block, initial=0)) > LARGEST:
            for row, k in np.argwhere(np.abs(block) > LARGEST):
                text = f"{block[row, k]:g} is implausible: beyond {LARGEST:g}"
                self._refuse(row, columns[k], text)
        return block

    def _joint_block(
        self, section: JointPositionColumns | JointRateColumns, constant: Mapping[str, float]
    ) -> Array:
        """Return the columns of joints in SI units, then those of constant joints."""
        units = [section.units.get(joint, section.unit) for joint in section.columns]
        signs = [-1.0 if joint in self._map.reversed_joints else 1.0 for joint in section.columns]
        scales = np.array([*map(scale_of, units)]) * signs
        block = self._block([*section.columns.values()], scales=scales)
        return np.hstack([block, np.tile([*constant.values()], (len(block), 1))])

    def _quaternions(self, block: Array) -> Array:
        """Return quaternions of R_WB (N, 4), scalar first, with their digits; NaN where absent.

        Quaternions of another norm than 1 are problems.
        """
        given, q = self._map.attitude, np.full((len(block), 4), np.nan)
        is_usable = np.isfinite(block).all(axis=1) & (block.shape[1] > 0)
        if not is_usable.any():
            return q
        if block.shape[1] == 4:
            q = block[:, [3, 0, 1, 2]] if given.order == "xyzw" else block
            with np.errstate(over="ignore"):
                norm = np.linalg.norm(q, axis=1)
            for row in np.flatnonzero(self._usable & (np.abs(norm - 1) > QUATERNION_NORM)):
                self._refuse(row, "", f"the quaternion's norm is {norm[row]:.6g}, not 1")
            is_usable &= self._usable
            q = np.where(is_usable[:, None], q, np.nan)
        else:
            q[is_usable] = _rotation(block[is_usable], given.order).as_quat(scalar_first=True)
        if given.direction == "R_BW":
            q = conjugate(q)
        if not np.array_equal(given.R_BS, np.eye(3)) and is_usable.any():
            R_BS = Rotation.from_matrix(given.R_BS)
            turned = Rotation.from_quat(q[is_usable], scalar_first=True) * R_BS.inv()
            q[is_usable] = turned.as_quat(scalar_first=True)
        return q

    def _in_common_rows(self, name: str, time: Array, block: Array) -> Array:
        """Return samples of joints that come in rows of their own at those of the rarest joint."""
        is_usable = np.isfinite(block) & self._usable[:, None]
        for each in is_usable.T:
            each[each] = is_later(time[each])
        counts = is_usable.sum(axis=0)
        if not counts.size or not counts.all() or is_usable.all(axis=1).sum() > counts.min() / 2:
            return block
        rows = np.flatnonzero(is_usable[:, counts.argmin()])
        new = np.full(block.shape, np.nan)
        for k, each in enumerate(is_usable.T):
            own = time[each]
            if len(own) < 2:
                return block
            right = np.searchsorted(own, time[rows]).clip(1, len(own) - 1)
            is_near = own[right] - own[right - 1] <= 3 * np.median(np.diff(own))
            is_near &= (time[rows] >= own[0]) & (time[rows] <= own[-1])
            value, _ = unwrapped(block[each, k], np.zeros(len(own)))
            new[rows, k] = np.where(is_near, CubicSpline(own, value)(time[rows]), np.nan)
        again = int((np.isfinite(block) & self._usable[:, None]).sum() - is_usable.sum())
        self.partial[name] += again
        text = "come in rows of their own, interpolated to those of the rarest joint"
        text += f"; {again} with a repeated stamp, left out" * bool(again)
        self.notes[name] = (*self.notes.get(name, ()), text)
        return new

    # -- problems ----------------------------------------------------------------------------

    def _refuse(self, row: int | np.intp, column: str, text: str) -> None:
        number, place = self._table.place(row, column)
        self.problems.append((number, f"{place}: {text}"))
        self._usable[row] = False

    def _refuse_texts(self) -> None:
        for name in self._map.named:
            for row, cell in self._table.texts.get(name, {}).items():
                remedy = "give a number with a decimal point"
                if cell.lower().lstrip("+-") in ("inf", "infinity"):
                    remedy = "leave the cell of an absent sample empty"
                elif name == self._map.time.column and "," not in cell:
                    remedy = "give seconds, or all stamps in the same form of ISO 8601 or hh:mm:ss"
                self._refuse(row, name, f"'{cell:.40}' is not a finite number; {remedy}")

    def _times(self) -> Array:
        """Return the time (N,) [s]; rows without a plausible one are problems."""
        given, column = self._map.time, self._map.time.column
        refuse_single_precision(self._table.columns[column], column)
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
        """Refuse rows whose time goes back; screening judges samples that repeat a stamp."""
        latest = np.fmax.accumulate(np.append(-np.inf, np.where(self._usable, time, -np.inf)))[:-1]
        back, column = self._usable & (time < latest), self._map.time.column
        stamps = time[self._usable]
        if stamps.size >= FEWEST and (stamps == stamps[0]).all():
            text = (
                f"the time is {stamps[0]:.17g} s in all rows: was it rounded, as spreadsheets do?"
            )
            raise InputError(f"column '{column}': {text}")
        for start, end in _runs(self._usable & (time <= latest)):
            if not back[start:end].any():
                continue
            start += int(back[start:end].argmax())
            now, before = (
                np.format_float_positional(t, trim="-") for t in (time[start], latest[start])
            )
            if end - start >= FEWEST and (np.diff(time[start:end]) >= 0).all():
                self._refuse(
                    start,
                    column,
                    f"the time starts again at {now} s after {before} s, for {end - start} rows: "
                    "are these several logs, one after the other? Cut the file there",
                )
                self._usable[start:end] = False
                continue
            for row in start + np.flatnonzero(back[start:end]):
                now = np.format_float_positional(time[row], trim="-")
                self._refuse(row, column, f"time {now} s comes after {before} s")


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return start and end of all runs of true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [*zip(edges[::2].tolist(), edges[1::2].tolist())]


def _spatial(block: Array, *, last: bool = False) -> Array:
    """Return vectors (N, 3): what a table holds is zero; NaN without columns."""
    if not block.shape[1]:
        return np.full((len(block), 3), np.nan)
    zeros = np.zeros((len(block), 3 - block.shape[1]))
    return np.hstack([zeros, block] if last else [block, zeros])


def _rotation(entries: Array, order: str) -> Rotation:
    """Return rotations from rotation vectors, MRPs or Euler angles (N, 3), or yaw (N, 1) [rad]."""
    if order == "rotation_vector":
        return Rotation.from_rotvec(entries)
    if order == "mrp":
        return Rotation.from_mrp(entries)
    return Rotation.from_euler("z" if order == "yaw" else order, entries)
