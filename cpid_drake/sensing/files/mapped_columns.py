"""Converts the tables of a log to the package's own columns, as a `ColumnMap` says."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from cpid_drake.dynamics.rotations import rotate_by_quaternion
from cpid_drake.errors import InputError
from cpid_drake.sensing.files.column_map import (
    QUATERNION_ORDERS,
    ColumnMap,
    JointPositionColumns,
    JointRateColumns,
    check_column_map,
    load_column_map,
    scale_of,
)
from cpid_drake.sensing.files.planar_columns import YAW, held, is_planar, yaw_quaternion
from cpid_drake.sensing.files.table import TelemetryTable, check_columns, known_column
from cpid_drake.sensing.measurements import FORCE_COLUMNS, THRUST, TORQUE_COLUMNS
from cpid_drake.sensing.sensors import SENSORS

_QUATERNION = SENSORS["attitude"].columns
_POSITION = SENSORS["position"].columns
_VELOCITY = SENSORS["velocity"].columns
_RATE_IN_B = SENSORS["gyro"].columns
_RATE_IN_W = SENSORS["gyro"].columns_in_W

_EULER = {"yaw_pitch_roll": "ZYX", "euler_xyz": "XYZ"}


@dataclass(frozen=True)
class _Found:
    """The columns of a log by their meaning; groups that are absent are empty."""

    time: str
    attitude: tuple[str, ...]
    position: tuple[str, ...]
    velocity: tuple[str, ...]
    angular_velocity: tuple[str, ...]
    rate_frame: str
    joint_positions: Mapping[str, str]
    joint_rates: Mapping[str, str]
    force: tuple[str, ...]
    torque: tuple[str, ...]
    others: tuple[str, ...]
    is_planar: bool


def columns_of(
    columns: "ColumnMap | str | Path | None", joints: Collection[str] | None = None
) -> "MappedColumns":
    """Return the columns to read for a map, a map's YAML file, or None for the package's own.

    Args:
        columns: the map.
        joints: the spacecraft's joints, if they are known; see `MappedColumns`.

    Raises:
        InputError: for the same reasons as `load_column_map` and `check_column_map`.

    """
    if columns is None:
        return MappedColumns(joints=joints)
    if isinstance(columns, ColumnMap):
        check_column_map(columns, "the map")
        return MappedColumns(columns, joints=joints)
    return MappedColumns(load_column_map(columns), str(columns), joints)


class MappedColumns:
    """The columns that a map selects, and their conversion.

    Args:
        column_map: a map that `check_column_map` accepts; None for the package's own columns.
        name: the map's name in error messages, such as its file.
        joints: the spacecraft's joints, if they are known; columns of others are then left out,
            unless the log lacks one of the spacecraft's joints.

    Attributes:
        is_house_format: whether there is no map: the log's columns are the package's own.

    """

    texts: dict[str, str] | None = None

    def __init__(
        self,
        column_map: ColumnMap | None = None,
        name: str = "the map",
        joints: Collection[str] | None = None,
    ) -> None:
        self._map, self._name, self._joints = column_map or ColumnMap(), name, joints
        self.is_house_format = column_map is None

    def select(self, names: Sequence[str], where: str) -> list[str]:
        """Return the columns of a log that are read.

        Args:
            names: all columns of the log.
            where: the log's name in error messages.

        Raises:
            InputError: a column that the map names is missing; or the columns that result are
                refused by `check_columns`.

        """
        if self.is_house_format:
            left_out = {f"{q}:{joint}" for q in ("q", "qd") for joint in self.left_out(names)}
            names = [name for name in names if name not in left_out]
            check_columns(names, where)
            return [name for name in names if known_column(name)]
        found = self._find(names)
        named = [found.time, *found.attitude, *found.position, *found.velocity]
        named += [*found.angular_velocity, *found.joint_positions.values()]
        named += [*found.joint_rates.values(), *found.force, *found.torque, *found.others]
        if self._map.time.nanoseconds is not None:
            named.append(self._map.time.nanoseconds)
        for name in named:
            if name not in names and (name != "time" or self._map.time.column != "time"):
                more = f" and {len(names) - 8} more" if len(names) > 8 else ""
                raise InputError(
                    f"{where}: there is no column '{name}', which {self._name} names; the columns "
                    f"are {', '.join(names[:8])}{more}"
                )
        kept = [name for name in names if name in named]
        for name in kept:
            if kept.count(name) > 1:
                raise InputError(f"{where}: the column '{name}' is there {kept.count(name)} times")
        unused = [name for name in names if name not in named and not known_column(name)]
        check_columns([*self._names(found), *unused], where)
        return kept

    def left_out(self, names: Sequence[str]) -> list[str]:
        """Return the joints of a log that are left out because the spacecraft lacks them."""
        if self._joints is None:
            return []
        explicit = self._explicit()
        free = [name for name in names if name not in explicit]
        found = self._joint_columns(self._map.joint_positions, free)
        rates = self._joint_columns(self._map.joint_rates, free)
        if any(joint not in found and joint not in rates for joint in self._joints):
            return []  # the joint that is missing may have one of the other names
        return [joint for joint in {**found, **rates} if joint not in self._joints]

    def house(self, table: TelemetryTable) -> TelemetryTable:
        """Return a table of a log in the package's own columns, SI units and radians."""
        if self.is_house_format:
            return table
        found = self._find(table.columns)
        index = {name: k for k, name in enumerate(table.columns)}

        def block(columns: Sequence[str]) -> NDArray[np.float64]:
            return table.values[:, [index[name] for name in columns]]

        given = self._map
        clock = [found.time, *([given.time.nanoseconds] if given.time.nanoseconds else [])]
        blocks = [self._time(block(clock))]
        quaternion = np.full((len(table.values), 4), np.nan)
        if found.attitude:
            blocks.append(self._quaternion(block(found.attitude), found.is_planar))
            quaternion = _unit_or_nan(blocks[-1])
        rate_B = np.full((len(table.values), 3), np.nan)
        if found.angular_velocity:
            rate = block(found.angular_velocity) * scale_of(given.angular_velocity.unit)
            if found.is_planar:
                rate = np.hstack([held(rate[:, 0], 2), rate])
            blocks.append(rate)
            inverse = quaternion * [1.0, -1.0, -1.0, -1.0]
            in_world = found.rate_frame == "world"
            rate_B = rotate_by_quaternion(inverse, rate) if in_world else rate
        if found.position:
            position = block(found.position) * scale_of(given.position.unit)
            if found.is_planar:
                position = np.hstack([position, held(position[:, 0], 1)])
            if given.position.point_B.any():
                position = position - rotate_by_quaternion(quaternion, given.position.point_B)
            blocks.append(position)
        if found.velocity:
            velocity = block(found.velocity) * scale_of(given.velocity.unit)
            if found.is_planar:
                velocity = np.hstack([velocity, held(velocity[:, 0], 1)])
            if given.velocity.frame == "body":
                velocity = rotate_by_quaternion(quaternion, velocity)
            if given.velocity.point_B.any():
                about = np.cross(rate_B, given.velocity.point_B)
                velocity = velocity - rotate_by_quaternion(quaternion, about)
            blocks.append(velocity)
        for joints, columns in (
            (given.joint_positions, found.joint_positions),
            (given.joint_rates, found.joint_rates),
        ):
            scales = [scale_of(joints.units.get(joint, joints.unit)) for joint in columns]
            blocks.append(block(list(columns.values())) * np.array(scales))
        if found.force or found.torque:
            blocks.append(self._thrust(block(found.force), block(found.torque)))
        blocks.append(block(found.others))
        names = self._names(found)
        mixed = {
            "attitude": found.attitude,
            "gyro": found.angular_velocity,
            "position": found.position,
            "velocity": found.velocity,
            THRUST: (*found.force, *found.torque),
        }
        return replace(
            table,
            columns=tuple(names),
            values=np.hstack(blocks),
            original=dict(zip(names, self._originals(found))),
            logged={k: np.asarray(~np.isnan(block(v)).all(axis=1)) for k, v in mixed.items() if v},
        )

    # -- names -------------------------------------------------------------------------------

    def _find(self, names: Sequence[str]) -> _Found:
        given, explicit = self._map, self._explicit()
        free = [name for name in names if name not in explicit]

        def group(columns: list[str], *defaults: Sequence[str]) -> tuple[str, ...]:
            """Return the given columns, or the first defaults that are in the log."""
            there = (d for d in defaults if any(name in free for name in d))
            return tuple(columns) or tuple(next(there, ()))

        attitude = group(given.attitude.columns, _QUATERNION)
        planar = given.attitude.order == "yaw" or (not attitude and is_planar(free))
        if planar:
            attitude = group(given.attitude.columns, (YAW,))
        first, few = (2, 2) if planar else (0, 3)
        in_B, in_W = _RATE_IN_B[first:], _RATE_IN_W[first:]
        rates = group(given.angular_velocity.columns, in_B, in_W)
        frame = given.angular_velocity.frame or ("world" if rates == in_W else "body")
        positions = self._joint_columns(given.joint_positions, free)
        joint_rates = self._joint_columns(given.joint_rates, free)
        for joint in self.left_out(names):
            positions.pop(joint, None)
            joint_rates.pop(joint, None)
        standard = {"time", YAW, *_QUATERNION, *_POSITION, *_VELOCITY, *_RATE_IN_B, *_RATE_IN_W}
        standard |= {*FORCE_COLUMNS, *TORQUE_COLUMNS}
        added = [name for name in free if known_column(name) and name not in standard]
        return _Found(
            given.time.column,
            attitude,
            group(given.position.columns, _POSITION[:few]),
            group(given.velocity.columns, _VELOCITY[:few]),
            rates,
            frame,
            positions,
            joint_rates,
            group(given.thrust.force, FORCE_COLUMNS[:few]),
            group(given.thrust.torque, TORQUE_COLUMNS[first:]),
            tuple(name for name in added if not name.startswith(("q:", "qd:"))),
            planar,
        )

    def _explicit(self) -> set[str]:
        """Return the columns that the map names, also those to ignore."""
        given = self._map
        explicit = {given.time.column, given.time.nanoseconds or "", *given.ignore_columns}
        for group in (given.attitude, given.position, given.velocity, given.angular_velocity):
            explicit.update(group.columns)
        explicit.update(given.thrust.force, given.thrust.torque)
        for joints in (given.joint_positions, given.joint_rates):
            explicit.update(joints.columns.values())
        return explicit

    def _joint_columns(
        self, joints: JointPositionColumns | JointRateColumns, free: Sequence[str]
    ) -> dict[str, str]:
        """Return the columns by joint, in the log's order where the names follow the pattern."""
        prefix, suffix = joints.prefix, joints.suffix
        found = dict(joints.columns)
        if prefix or suffix:
            for name in free:
                is_long = len(name) > len(prefix) + len(suffix)
                if is_long and name.startswith(prefix) and name.endswith(suffix):
                    joint = name[len(prefix) : len(name) - len(suffix)]
                    found.setdefault(joint, name)
        ignored = self._map.ignore_joints
        return {joint: name for joint, name in found.items() if joint not in ignored}

    def _names(self, found: _Found) -> list[str]:
        """Return the package's names of the found columns, in the order of `house`."""
        names = ["time"]
        names += _QUATERNION if found.attitude else ()
        if found.angular_velocity:
            names += _RATE_IN_W if found.rate_frame == "world" else _RATE_IN_B
        names += _POSITION if found.position else ()
        names += _VELOCITY if found.velocity else ()
        names += [f"q:{joint}" for joint in found.joint_positions]
        names += [f"qd:{joint}" for joint in found.joint_rates]
        names += (*FORCE_COLUMNS, *TORQUE_COLUMNS) if found.force or found.torque else ()
        return [*names, *found.others]

    def _originals(self, found: _Found) -> list[str]:
        """Return the log's names, in the same order; an attitude has the name of its first."""
        attitude = found.attitude
        names = [found.time, *(attitude if len(attitude) == 4 else attitude[:1] * 4)]
        if self._map.attitude.order == "xyzw" and attitude:
            names[1:] = [attitude[3], *attitude[:3]]
        for group in (found.angular_velocity, found.position, found.velocity):
            names += [*group, *group[:1] * (3 - len(group) if group else 0)]
        names += [*found.joint_positions.values(), *found.joint_rates.values()]
        if found.force or found.torque:
            first = (found.force or found.torque)[:1]
            for group in (found.force, found.torque):
                names += group if len(group) == 3 else first * 3
        return [*names, *found.others]

    # -- values ------------------------------------------------------------------------------

    def _time(self, logged: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the time (N, 1) [s] of the logged ticks and nanoseconds (N, 1) or (N, 2)."""
        given = self._map.time
        ticks = logged[:, :1] - given.epoch
        time = ticks / given.rate if given.rate else ticks * scale_of(given.unit)
        return time + logged[:, 1:] * 1e-9 if given.nanoseconds is not None else time

    def _quaternion(self, logged: NDArray[np.float64], planar: bool) -> NDArray[np.float64]:
        """Return the quaternion of R_WB (N, 4), scalar first; NaN where it is absent."""
        given = self._map.attitude
        if planar:
            quaternion = yaw_quaternion(logged[:, 0] * scale_of(given.unit))
        elif given.order in QUATERNION_ORDERS:
            quaternion = logged[:, [3, 0, 1, 2]] if given.order == "xyzw" else logged
        else:
            quaternion = np.full((len(logged), 4), np.nan)
            there = np.isfinite(logged).all(axis=1)
            if there.any():
                quaternion[there] = self._rotation(logged[there]).as_quat(scalar_first=True)
        return quaternion * [1.0, -1.0, -1.0, -1.0] if given.direction == "R_BW" else quaternion

    def _thrust(
        self, force: NDArray[np.float64], torque: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return force, and torque about B's origin, (N, 6) in B; one of them may be absent."""
        given = self._map.thrust
        force, torque = force * scale_of(given.force_unit), torque * scale_of(given.torque_unit)
        like = force[:, 0] if force.shape[1] else torque[:, 0]
        if force.shape[1] < 3:
            force = np.hstack([force, held(like, 3 - force.shape[1])])
        if torque.shape[1] < 3:
            torque = np.hstack([held(like, 3 - torque.shape[1]), torque])
        return np.hstack([force, torque + np.cross(given.point_B, force)])

    def _rotation(self, logged: NDArray[np.float64]) -> "scipy.spatial.transform.Rotation":
        Rotation = scipy.spatial.transform.Rotation  # imported at its first use: it takes 0.25 s
        order, angles = self._map.attitude.order, logged * scale_of(self._map.attitude.unit)
        if order == "rotation_vector":
            return Rotation.from_rotvec(angles)
        if order == "roll_pitch_yaw":
            order, angles = "yaw_pitch_roll", angles[:, ::-1]
        return Rotation.from_euler(_EULER[order], angles)


def _unit_or_nan(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4), NaN where they are not of unit norm."""
    with np.errstate(over="ignore"):
        unit = np.abs(np.linalg.norm(quaternion, axis=1, keepdims=True) - 1) < 1e-3
    return np.where(unit, quaternion, np.nan)
