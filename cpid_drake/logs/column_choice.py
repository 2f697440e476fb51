"""Chooses the columns of a file for each quantity, by a map and by the package's own names.

The package's own columns are the default map, in SI units and radians; either all columns of a
group are present or none:

- `time` [s], strictly increasing;
- `qw`, `qx`, `qy`, `qz`: attitude R_WB of the base as a unit quaternion;
- `x`, `y`, `z`: p_WBo_W, the base frame's origin [m];
- `wx`, `wy`, `wz`: w_WB_W, or `bwx`, `bwy`, `bwz`: w_WB_B, as gyros measure it [rad/s];
- `vx`, `vy`, `vz`: v_WBo_W [m/s];
- `q:<joint>`, `qd:<joint>`: joint positions and rates [rad, m, rad/s, m/s]. Rates of all joints or
  of none; positions of rotors, such as reaction wheels, may be absent;
- "thrust_fx", "thrust_fy", "thrust_fz", "thrust_tx", "thrust_ty", "thrust_tz": force on the base
  [N], and torque about its origin [N·m], of all thrusters together, in B. Each row holds until the
  next. Without the columns of the torque, the force acts at B's origin;
- "valve:<name>": opening of a valve, 0 or 1 or between; see `sensors.thrusters`.

Logs on a table have `yaw` [rad], the rotation of B about W's z axis, instead of the quaternion, and
of the others `x`, `y`, `vx`, `vy`, `wz` or `bwz`, "thrust_fx", "thrust_fy" and "thrust_tz" only.
What the table holds is exactly zero in the samples.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from cpid_drake.errors import InputError
from cpid_drake.logs.column_map import ColumnMap, JointPositionColumns, JointRateColumns
from cpid_drake.logs.log import THRUST_COLUMNS
from cpid_drake.logs.table import Table, shortened
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.thrusters import VALVE

YAW = "yaw"
"""The column of the angle of B about W's z axis."""


@dataclass(frozen=True, eq=False)
class ChosenColumns:
    """The columns of a file by their meaning; groups that are absent are empty.

    Attributes:
        time: the time, and perhaps nanoseconds.
        groups: columns of the sensors of the base, of "force" and of "torque", and of each valve.
        in_world: whether the angular velocity is expressed in W.
        is_planar: whether the base has x, y and yaw only.
        positions, rates: columns by joint.
        left_out: joints that the spacecraft does not have.

    """

    time: tuple[str, ...]
    groups: Mapping[str, tuple[str, ...]]
    in_world: bool
    is_planar: bool
    positions: Mapping[str, str]
    rates: Mapping[str, str]
    left_out: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """All chosen columns."""
        base = [name for group in self.groups.values() for name in group]
        return [*self.time, *base, *self.positions.values(), *self.rates.values()]


def choose_columns(
    given: ColumnMap,
    table: Table,
    where: str,
    *,
    map_name: str = "the map",
    joints: Collection[str] | None = None,
) -> ChosenColumns:
    """Return the columns that a map names, and of its other quantities the package's own columns.

    Args: see `read_columns`.

    Raises:
        InputError: no time, a column that the map names is missing, groups that are not complete,
            angular velocity both in W and in B or in W without the attitude, no joint positions,
            joints without a rate where others have one, or a column that cannot be read.

    """
    where = f"{where}: {table.header}" if table.header else where
    names = [*table.columns, *table.unreadable]
    explicit = given.named
    if names and names[0] == "1" and not {*explicit} & {*names}:
        raise InputError(
            f"{where} holds numbers; the first line must hold the columns' names, or a map must "
            "name the columns by their numbers, such as '1'"
        )
    free = [name for name in names if name not in explicit and name not in given.ignore_columns]
    unknown = [name for name in free if not _is_own(name)]
    _refuse_unreadable([*explicit, *filter(_is_own, free)], table, where)
    for name in explicit:
        if name not in names:
            if name == "time":
                raise InputError(f"{where}: there is no column 'time'{_likely('time', unknown)}")
            raise InputError(
                f"{where}: there is no column '{name}', which {map_name} names; the columns are "
                f"{shortened(names)}"
            )
    quaternion, gyro = SENSORS["attitude"].columns, SENSORS["gyro"]
    is_planar = given.attitude.order == "yaw" or (
        not given.attitude.columns and YAW in free and not {*quaternion} & {*free}
    )
    in_plane = slice(0, 2) if is_planar else slice(0, 3)
    about_normal = slice(2, 3) if is_planar else slice(0, 3)
    in_B, in_W = gyro.columns[about_normal], gyro.columns_in_W[about_normal]
    groups: dict[str, tuple[str, ...]] = {}
    for key, columns, *own in (
        ("attitude", given.attitude.columns, (YAW,) if is_planar else quaternion),
        ("gyro", given.angular_velocity.columns, in_B, in_W),
        ("position", given.position.columns, SENSORS["position"].columns[in_plane]),
        ("velocity", given.velocity.columns, SENSORS["velocity"].columns[in_plane]),
        ("force", given.thrust.force, THRUST_COLUMNS[3:][in_plane]),
        ("torque", given.thrust.torque, THRUST_COLUMNS[:3][about_normal]),
    ):
        label = SENSORS[key].quantity if key in SENSORS else f"the {key} of thrusters"
        there = [] if columns else [each for each in own if {*each} & {*free}]
        for each in there:
            missing = [name for name in each if name not in free]
            if missing:
                raise InputError(
                    f"{where}: {label} needs the columns {', '.join(each)}; missing: "
                    f"{', '.join(missing)}{_likely(missing[0], unknown)}"
                )
        if len(there) > 1:
            raise InputError(
                f"{where}: {label} is there twice, in the body ({', '.join(there[0])}) and in the "
                f"world ({', '.join(there[1])}); keep one of them"
            )
        groups[key] = tuple(columns or (there[0] if there else ()))
    groups |= {name: (name,) for name in free if name.startswith(VALVE)}
    frame = given.angular_velocity.frame
    in_world = frame == "world" or (frame is None and groups["gyro"] == in_W)
    if groups["gyro"] and in_world and not groups["attitude"]:
        raise InputError(
            f"{where}: angular velocity in the world ({', '.join(groups['gyro'])}) needs the "
            "attitude (qw, qx, qy, qz) to be rotated into the body; if it is in the body, name it "
            f"{', '.join(in_B)}"
        )
    positions, rates, left_out = _of_joints(given, free, joints)
    for joint in given.joint_positions.constant:
        if joint in positions or joint in rates:
            raise InputError(
                f"{where}: the joint '{joint}' has a column and a constant position "
                f"(joint_positions.constant of {map_name})"
            )
    if not positions and not given.joint_positions.constant and (joints is None or joints):
        near = _likely("q:joint", unknown)
        raise InputError(f"{where}: there are no joint positions, columns 'q:<joint>'{near}")
    for joint in positions if rates else ():
        if joint not in rates:
            raise InputError(
                f"{where}: there is a column 'q:{joint}', but no 'qd:{joint}'; give joint rates of "
                "all joints or of none, or leave the joint out (ignore_joints of a map of columns)"
            )
    time = (given.time.column, *([given.time.nanoseconds] if given.time.nanoseconds else []))
    chosen = ChosenColumns(time, groups, in_world, is_planar, positions, rates, left_out)
    _refuse_unreadable(chosen.names, table, where)
    return chosen


def _refuse_unreadable(names: Sequence[str], table: Table, where: str) -> None:
    for name in names:
        if name in table.unreadable:
            raise InputError(f"{where}: the column '{name}' {table.unreadable[name]}")


def _is_own(name: str) -> bool:
    """Return whether the package's own columns have this name."""
    own = {"time", YAW, *THRUST_COLUMNS}
    for sensor in SENSORS.values():
        own |= {*sensor.columns, *sensor.columns_in_W}
    return name in own or (name.startswith(("q:", "qd:", VALVE)) and not name.endswith(":"))


def _likely(wanted: str, unknown: Sequence[str]) -> str:
    """Return a remedy, if there are columns of unknown meaning."""
    if close := get_close_matches(wanted, unknown, n=1):
        return f"; did you mean '{close[0]}'?"
    shown = shortened([f"'{name:.40}'" for name in unknown])
    remedy = "`cpid log map` finds out what the columns of a log mean"
    return f"; ignored columns: {shown}; {remedy}" if unknown else ""


def _of_joints(
    given: ColumnMap, free: Sequence[str], joints: Collection[str] | None
) -> tuple[dict[str, str], dict[str, str], tuple[str, ...]]:
    """Return the columns of positions and rates by joint, and joints that the spacecraft lacks.

    The latter have no columns, unless the log lacks one of the spacecraft's joints, which may have
    one of these names.
    """

    def columns(section: JointPositionColumns | JointRateColumns) -> dict[str, str]:
        prefix, suffix, found = section.prefix, section.suffix, dict(section.columns)
        for name in free if prefix or suffix else ():
            is_long = len(name) > len(prefix) + len(suffix)
            if is_long and name.startswith(prefix) and name.endswith(suffix):
                found.setdefault(name[len(prefix) : len(name) - len(suffix)], name)
        return {joint: name for joint, name in found.items() if joint not in given.ignore_joints}

    positions, rates = columns(given.joint_positions), columns(given.joint_rates)
    everything = {**positions, **rates}
    if joints is None or any(joint not in everything for joint in joints):
        return positions, rates, ()
    kept = [{j: name for j, name in part.items() if j in joints} for part in (positions, rates)]
    return kept[0], kept[1], tuple(joint for joint in everything if joint not in joints)
