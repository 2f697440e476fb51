"""A map of a log's columns: their names, units, frames and conventions, as a YAML file.

Everything that a map does not say is as in the package's own format (`logs.column_choice`), so an
empty map changes nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.checked_yaml import load_yaml
from cpid_drake.files.constraints import Limits, Numbers, Vector
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import resolve_model

Length = Literal["m", "cm", "mm", "km", "in"]
Angle = Literal["rad", "mrad", "deg"]
Speed = Literal["m/s", "cm/s", "mm/s", "km/s", "in/s"]
AngularRate = Literal["rad/s", "mrad/s", "deg/s", "rpm"]
Force = Literal["N", "mN"]
Torque = Literal["N*m", "mN*m"]
TimeUnit = Literal["s", "ms", "us", "ns", "frame"]
BodyAxes = Literal[
    "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ"
]
"""The axes of three rotations of a body, each about one of its axes as they are then: "ZYX" turns
about z, then the new y, then the new x, by yaw, pitch and roll.
"""

WorldAxes = Literal[
    "xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "xyx", "xzx", "yxy", "yzy", "zxz", "zyz"
]
"""The axes of W of three rotations: "xyz" is the attitude of "ZYX", by roll, pitch and yaw."""

Order = Literal["wxyz", "xyzw", "rotation_vector", "mrp", "yaw", BodyAxes, WorldAxes]
"""Entries of an attitude: a quaternion, a rotation vector, modified Rodrigues parameters (the axis
times the tangent of a quarter of the angle, or their shadow set), the angle about z alone, of a
base on a table, or three Euler angles in the order of their axes.
"""

QUATERNION_ORDERS = ("wxyz", "xyzw")

_WIDTHS = {"wxyz": 4, "xyzw": 4, "yaw": 1}
"""Number of entries of orders that have not three."""

UNITS = {
    "m": (1.0, "metres meters"),
    "mm": (1e-3, "millimetres millimeters"),
    "cm": (0.01, "centimetres centimeters"),
    "km": (1e3, "kilometres kilometers"),
    "in": (0.0254, "inches inch"),
    "rad": (1.0, "radians rads"),
    "mrad": (1e-3, "milliradians"),
    "deg": (np.pi / 180, "degrees degree degs ° dps"),
    "rpm": (2 * np.pi / 60, "rpm"),
    "s": (1.0, "seconds sec secs"),
    "ms": (1e-3, "milliseconds msec millis"),
    "us": (1e-6, "microseconds µs usec micros"),
    "ns": (1e-9, "nanoseconds nsec nsecs nanos nanosec"),
    "N": (1.0, "newtons"),
    "mN": (1e-3, "millinewtons"),
    "N*m": (1.0, ""),
    "mN*m": (1e-3, ""),
}
"""By unit, its size in SI units and radians, and its names in words, the usual one first."""


UNIT_OF = {word: unit for unit, (_, words) in UNITS.items() for word in (unit, *words.split())}
"""The unit of each of its names."""


def scale_of(unit: str) -> float:
    """Return the size of a unit in SI units and radians."""
    return UNITS[unit.removesuffix("/s")][0]


Axes = Annotated[Array, Numbers(3, 3)]


@dataclass
class TimeColumn:
    """The time.

    Attributes:
        column: its name in the log.
        unit: its unit; "frame" for numbers of frames.
        rate: frames per second, if the unit is "frame" [Hz].
        epoch: the log's number, in its unit, at which the time is zero.
        nanoseconds: a column of nanoseconds that are added, as in a ROS 2 stamp; null for none.
        from_rates: whether the intervals between rows are those on which positions and rates agree,
            for logs that count steps; see `logs.clock`.

    """

    column: str = "time"
    unit: TimeUnit = "s"
    rate: Annotated[float, Limits(gt=0)] | None = None
    epoch: float = 0.0
    nanoseconds: str | None = None
    from_rates: bool = False


@dataclass
class AttitudeColumns:
    """The attitude of the base.

    With the order "yaw" the base is on a table; see `logs.column_choice`. Position and
    velocity then have two columns, along x and y, and the angular velocity one, about z.

    Attributes:
        columns: names in the log, in the order of `order`; empty for qw, qx, qy, qz, or for yaw.
        order: the entries' order and meaning.
        unit: unit of angles and of rotation vectors.
        direction: the rotation that is logged: R_WB has B's axes in W as its columns.
        R_BS: (3, 3) rotation from the axes S whose attitude is logged, such as those of a star
            tracker or of a tracked marker, to B.

    """

    columns: list[str] = field(default_factory=list)
    order: Order = "wxyz"
    unit: Angle = "rad"
    direction: Literal["R_WB", "R_BW"] = "R_WB"
    R_BS: Axes = field(default_factory=lambda: np.eye(3))


@dataclass
class PositionColumns:
    """The position of a point P of the base in W.

    Attributes:
        columns: names in the log; empty for x, y, z.
        unit: unit of the log.
        point_B: (3,) p_BP_B: P, such as a marker, from B's origin in B [m].

    """

    columns: list[str] = field(default_factory=list)
    unit: Length = "m"
    point_B: Vector = field(default_factory=lambda: np.zeros(3))


@dataclass
class VelocityColumns:
    """The velocity of a point P of the base relative to W.

    Attributes:
        columns: names in the log; empty for vx, vy, vz or bvx, bvy, bvz.
        unit: unit of the log.
        frame: the axes in which the velocity is expressed, those of W or of B; null for those that
            the names of columns say: B for bvx, bvy, bvz, W for all others.
        point_B: (3,) p_BP_B [m]; a point other than zero needs the angular velocity.

    """

    columns: list[str] = field(default_factory=list)
    unit: Speed = "m/s"
    frame: Literal["world", "body"] | None = None
    point_B: Vector = field(default_factory=lambda: np.zeros(3))


@dataclass
class AngularVelocityColumns:
    """The angular velocity of the base relative to W.

    Attributes:
        columns: names in the log; empty for bwx, bwy, bwz or wx, wy, wz.
        unit: unit of the log.
        frame: the axes in which it is expressed, those of W or of B; null for those that the names
            of columns say: B for bwx, bwy, bwz and for columns with a name of their own.
        R_BS: (3, 3) rotation from the gyro's axes S to B; a row may have the other sign, if one of
            the gyro's axes has.

    """

    columns: list[str] = field(default_factory=list)
    unit: AngularRate = "rad/s"
    frame: Literal["world", "body"] | None = None
    R_BS: Axes = field(default_factory=lambda: np.eye(3))


@dataclass
class ThrustColumns:
    """Force and torque of all thrusters together, in B; each row holds until the next.

    Attributes:
        force: names in the log; empty for thrust_fx, thrust_fy, thrust_fz.
        torque: names in the log of the torque about the point at which the force is given; empty
            for thrust_tx, thrust_ty, thrust_tz.
        force_unit, torque_unit: units of the log.
        point_B: (3,) p_BP_B: the point, from B's origin in B [m].

    """

    force: list[str] = field(default_factory=list)
    torque: list[str] = field(default_factory=list)
    force_unit: Force = "N"
    torque_unit: Torque = "N*m"
    point_B: Vector = field(default_factory=lambda: np.zeros(3))


@dataclass
class JointPositionColumns:
    """The positions of the joints.

    Attributes:
        prefix, suffix: a column PREFIX + JOINT + SUFFIX holds the positions of this joint.
        columns: by joint, the column in the log, where it is not of this form.
        unit: unit of all joints.
        units: by joint, the unit where it is another.
        constant: by joint without a column, its constant position [rad or m].

    """

    prefix: str = "q:"
    suffix: str = ""
    columns: dict[str, str] = field(default_factory=dict)
    unit: Angle | Length = "rad"
    units: dict[str, Angle | Length] = field(default_factory=dict)
    constant: dict[str, float] = field(default_factory=dict)

    def column(self, joint: str) -> str:
        """Return the column of a joint."""
        return self.columns.get(joint, f"{self.prefix}{joint}{self.suffix}")


@dataclass
class JointRateColumns:
    """The rates of the joints; see `JointPositionColumns`. Constant joints have the rate zero."""

    prefix: str = "qd:"
    suffix: str = ""
    columns: dict[str, str] = field(default_factory=dict)
    unit: AngularRate | Speed = "rad/s"
    units: dict[str, AngularRate | Speed] = field(default_factory=dict)

    def column(self, joint: str) -> str:
        """Return the column of a joint."""
        return self.columns.get(joint, f"{self.prefix}{joint}{self.suffix}")


@dataclass
class ColumnMap:
    """A map of a log's columns; what is not given is as in the package's own format.

    Attributes:
        time, attitude, position, velocity, angular_velocity, joint_positions, joint_rates, thrust:
            the columns of each quantity.
        valves: by valve of the thrusters, the column of its opening where it is not "valve:NAME".
        reversed_joints: joints whose positions and rates have the opposite sign of the model's.
        ignore_joints: joints of the log that are not used, such as those of a gripper.
        ignore_columns: columns of the log that are not used although their names have a meaning.

    """

    time: TimeColumn = field(default_factory=TimeColumn)
    attitude: AttitudeColumns = field(default_factory=AttitudeColumns)
    position: PositionColumns = field(default_factory=PositionColumns)
    velocity: VelocityColumns = field(default_factory=VelocityColumns)
    angular_velocity: AngularVelocityColumns = field(default_factory=AngularVelocityColumns)
    joint_positions: JointPositionColumns = field(default_factory=JointPositionColumns)
    joint_rates: JointRateColumns = field(default_factory=JointRateColumns)
    thrust: ThrustColumns = field(default_factory=ThrustColumns)
    valves: dict[str, str] = field(default_factory=dict)
    reversed_joints: list[str] = field(default_factory=list)
    ignore_joints: list[str] = field(default_factory=list)
    ignore_columns: list[str] = field(default_factory=list)

    @property
    def named(self) -> list[str]:
        """The columns that the map names, in its order, also those that it names twice."""
        names = [self.time.column, *([self.time.nanoseconds] if self.time.nanoseconds else [])]
        names += [name for columns in self.of_sensors.values() for name in columns]
        return [*names, *self.thrust.force, *self.thrust.torque, *self.valves.values()]

    @property
    def of_sensors(self) -> dict[str, list[str]]:
        """The columns of each sensor that the map names."""
        return {
            "attitude": self.attitude.columns,
            "position": self.position.columns,
            "velocity": self.velocity.columns,
            "gyro": self.angular_velocity.columns,
            "encoders": [*self.joint_positions.columns.values()],
            "joint_rates": [*self.joint_rates.columns.values()],
        }


def with_entries(column_map: ColumnMap, entries: Mapping[str, Any]) -> ColumnMap:
    """Return a map with other values of some keys, such as "position.unit"."""
    for key, value in entries.items():
        section, _, rest = key.partition(".")
        if not rest:
            column_map = replace(column_map, **{section: value})
            continue
        name, _, joint = rest.partition(".")
        given = getattr(column_map, section)
        if joint:
            value = {**getattr(given, name), joint: value}
        elif isinstance(getattr(given, name), np.ndarray):
            value = np.asarray(value, dtype=float)
        column_map = replace(column_map, **{section: replace(given, **{name: value})})
    return column_map


def load_column_map(path: str | Path) -> ColumnMap:
    """Read a map of columns from a YAML file.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values that `check_column_map` refuses.

    """
    column_map = load_yaml(ColumnMap, resolve_model(path), str(path), "a map of columns")
    check_column_map(column_map, str(path))
    return column_map


def check_column_map(column_map: ColumnMap, where: str) -> None:
    """Refuse a map that contradicts itself; messages begin with `where`.

    Raises:
        InputError: a wrong number of columns, a column that is named twice, frames without a rate,
            nanoseconds besides a time that is not in seconds, a unit of modified Rodrigues
            parameters, or axes that are none.

    """
    time, attitude, rate = column_map.time, column_map.attitude, column_map.angular_velocity
    if (time.unit == "frame") != (time.rate is not None):
        raise InputError(f"{where}: time.rate (frames per second) and time.unit: frame go together")
    if time.nanoseconds is not None and time.unit != "s":
        raise InputError(f"{where}: time.nanoseconds are added to a time of the unit s only")
    for key, R in (("attitude", attitude.R_BS), ("angular_velocity", rate.R_BS)):
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or (key == "attitude" and np.linalg.det(R) < 0):
            raise InputError(f"{where}: {key}.R_BS must be a rotation: three orthogonal unit rows")
    if rate.frame == "world" and not np.array_equal(rate.R_BS, np.eye(3)):
        raise InputError(f"{where}: angular_velocity.R_BS is for a gyro, in the frame body")
    if attitude.order == "mrp" and attitude.unit != "rad":
        raise InputError(f"{where}: attitude.unit is of angles: the order mrp has none")
    entries = _WIDTHS.get(attitude.order, 3)
    vector, angles = (2, 1) if attitude.order == "yaw" else (3, 3)
    for key, columns, width in (
        ("attitude.columns", attitude.columns, entries),
        ("position.columns", column_map.position.columns, vector),
        ("velocity.columns", column_map.velocity.columns, vector),
        ("angular_velocity.columns", rate.columns, angles),
        ("thrust.force", column_map.thrust.force, vector),
        ("thrust.torque", column_map.thrust.torque, angles),
    ):
        if len(columns) not in (0, width):
            raise InputError(f"{where}: {key} must name {width}, not {len(columns)}")
    if not attitude.columns and entries == 3:
        raise InputError(f"{where}: attitude.columns must name the three of {attitude.order}")
    named = column_map.named
    for name in named:
        if named.count(name) > 1:
            raise InputError(f"{where}: the column '{name}' is named {named.count(name)} times")
    for name in column_map.ignore_columns:
        if name in named:
            raise InputError(f"{where}: the column '{name}' is named, and ignored too")
