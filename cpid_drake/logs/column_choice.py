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

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from cpid_drake.errors import InputError
from cpid_drake.logs.column_map import ColumnMap, JointPositionColumns, JointRateColumns
from cpid_drake.logs.log import THRUST_COLUMNS
from cpid_drake.logs.table import Table
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.thrusters import VALVE

YAW = "yaw"
"""The column of the angle of B about W's z axis."""

_SHOWN = 8  # columns in a message


@dataclass(frozen=True, eq=False)
class ChosenColumns:
    """The columns of a file by their meaning; groups that are absent are empty.

    Attributes:
        groups: columns of the sensors of the base, of "force" and of "torque".
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
        InputError: a repeated column, no time, a column that the map names is missing, groups that
            are not complete, angular velocity both in W and in B or in W without the attitude, no
            joint positions, or joints without a rate where others have one.

    """
    where = f"{where}: {table.header}" if table.header else where
    names = [*table.columns, *table.unreadable]
    explicit = [name for name in _named(given) if name != "time" or "time" in names]
    if not table.has_names and not {*explicit} & {*names}:
        raise InputError(
            f"{where} holds numbers; the first line must hold the columns' names, or a map must "
            "name the columns by their numbers, such as '1'"
        )
    free = [name for name in names if name not in explicit and name not in given.ignore_columns]
    unknown = [name for name in free if not _is_own(name)]

    def refuse_twice(names: Iterable[str]) -> None:
        for name in names:
            if name in table.twice:
                raise InputError(f"{where}: the column '{name}' is there {table.twice[name]} times")

    refuse_twice([*explicit, *filter(_is_own, free)])
    if given.time.column == "time" and "time" not in names:
        raise InputError(f"{where}: there is no column 'time'{_likely('time', unknown)}")
    for name in explicit:
        if name not in names:
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            raise InputError(
                f"{where}: there is no column '{name}', which {map_name} names; the columns are "
                f"{', '.join(names[:_SHOWN])}{more}"
            )

    def group(columns: list[str], label: str, *own: Sequence[str]) -> tuple[str, ...]:
        """Return the given columns, or the package's own if they are in the file."""
        there = [] if columns else [each for each in own if any(name in free for name in each)]
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
        return tuple(columns or (there[0] if there else ()))

    quaternion = SENSORS["attitude"].columns
    is_planar = given.attitude.order == "yaw" or (
        not given.attitude.columns and YAW in free and not {*quaternion} & {*free}
    )
    last = slice(2, 3) if is_planar else slice(0, 3)  # entries about the table's normal
    first = slice(0, 2) if is_planar else slice(0, 3)
    gyro = SENSORS["gyro"]
    in_B, in_W = gyro.columns[last], gyro.columns_in_W[last]
    rate = given.angular_velocity
    groups = {
        "attitude": group(given.attitude.columns, "attitude", (YAW,) if is_planar else quaternion),
        "gyro": group(rate.columns, gyro.label, in_B, in_W),
        "position": group(given.position.columns, "position", SENSORS["position"].columns[first]),
        "velocity": group(given.velocity.columns, "velocity", SENSORS["velocity"].columns[first]),
        "force": group(given.thrust.force, "the force of thrusters", THRUST_COLUMNS[3:][first]),
        "torque": group(given.thrust.torque, "the torque of thrusters", THRUST_COLUMNS[:3][last]),
    }
    groups |= {name: (name,) for name in free if name.startswith(VALVE)}
    in_world = rate.frame == "world" or (rate.frame is None and groups["gyro"] == in_W)
    if groups["gyro"] and in_world and not groups["attitude"]:
        raise InputError(
            f"{where}: angular velocity in the world ({', '.join(groups['gyro'])}) needs the "
            "attitude (qw, qx, qy, qz) to be rotated into the body; if it is in the body, name it "
            f"{', '.join(in_B)}"
        )
    of_joints = [
        _joint_columns(section, free, given.ignore_joints)
        for section in (given.joint_positions, given.joint_rates)
    ]
    positions, rates, left_out = _without_others(of_joints[0], of_joints[1], joints)
    constant = given.joint_positions.constant
    for joint in constant:
        if joint in positions or joint in rates:
            raise InputError(
                f"{where}: the joint '{joint}' has a column and a constant position "
                f"(joint_positions.constant of {map_name})"
            )
    has_joints = joints is None or len(joints) > 0
    if has_joints and not positions and not constant:
        near = _likely("q:joint", unknown)
        raise InputError(f"{where}: there are no joint positions, columns 'q:<joint>'{near}")
    without = [joint for joint in positions if rates and joint not in rates]
    if without:
        raise InputError(
            f"{where}: there is a column 'q:{without[0]}', but no 'qd:{without[0]}'; give joint "
            "rates of all joints or of none, or leave the joint out (ignore_joints of a map of "
            "columns)"
        )
    chosen = ChosenColumns(
        (given.time.column, *([given.time.nanoseconds] if given.time.nanoseconds else [])),
        groups,
        in_world,
        is_planar,
        positions,
        rates,
        left_out,
    )
    refuse_twice(chosen.names)
    return chosen


def _named(given: ColumnMap) -> Iterable[str]:
    """Return the columns that a map names, in its order."""
    names = [given.time.column, *([given.time.nanoseconds] if given.time.nanoseconds else [])]
    for group in (given.attitude, given.position, given.velocity, given.angular_velocity):
        names += group.columns
    for section in (given.joint_positions, given.joint_rates):
        names += section.columns.values()
    return dict.fromkeys([*names, *given.thrust.force, *given.thrust.torque])


def _is_own(name: str) -> bool:
    """Return whether the package's own columns have this name."""
    own = {"time", YAW, *THRUST_COLUMNS}
    for sensor in SENSORS.values():
        own |= {*sensor.columns, *sensor.columns_in_W}
    return name in own or (name.startswith(("q:", "qd:", VALVE)) and not name.endswith(":"))


def _likely(wanted: str, unknown: Sequence[str]) -> str:
    if not unknown:
        return ""
    close = get_close_matches(wanted, unknown, n=1)
    if close:
        return f"; did you mean '{close[0]}'?"
    shown = ", ".join(f"'{name:.40}'" for name in unknown[:_SHOWN])
    more = f" and {len(unknown) - _SHOWN} more" if len(unknown) > _SHOWN else ""
    return (
        f"; ignored columns: {shown}{more}; `cpid log map` finds out what the columns of a log mean"
    )


def _joint_columns(
    section: JointPositionColumns | JointRateColumns, free: Sequence[str], ignored: Sequence[str]
) -> dict[str, str]:
    """Return the columns by joint, in the file's order where the names follow the pattern."""
    prefix, suffix = section.prefix, section.suffix
    found = dict(section.columns)
    for name in free if prefix or suffix else ():
        is_long = len(name) > len(prefix) + len(suffix)
        if is_long and name.startswith(prefix) and name.endswith(suffix):
            found.setdefault(name[len(prefix) : len(name) - len(suffix)], name)
    return {joint: name for joint, name in found.items() if joint not in ignored}


def _without_others(
    positions: dict[str, str], rates: dict[str, str], joints: Collection[str] | None
) -> tuple[dict[str, str], dict[str, str], tuple[str, ...]]:
    """Return the columns without joints that the spacecraft lacks, and these joints."""
    everything = {**positions, **rates}
    if joints is None or any(joint not in everything for joint in joints):
        return positions, rates, ()  # the joint that is missing may have one of the other names
    kept = [{j: name for j, name in part.items() if j in joints} for part in (positions, rates)]
    return kept[0], kept[1], tuple(joint for joint in everything if joint not in joints)
