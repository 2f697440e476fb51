"""Fills a map of columns with the package's own names, for what a map leaves out.

The package's own columns are the default map, in SI units and radians; either all columns of a
group are present or none:

- `time` [s], strictly increasing;
- `qw`, `qx`, `qy`, `qz`: attitude R_WB of the base as a unit quaternion;
- `x`, `y`, `z`: p_WBo_W, the base frame's origin [m];
- `wx`, `wy`, `wz`: w_WB_W, or `bwx`, `bwy`, `bwz`: w_WB_B, as gyros measure it [rad/s];
- `vx`, `vy`, `vz`: v_WBo_W, or `bvx`, `bvy`, `bvz`: v_WBo_B, as odometry has it [m/s];
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

from collections.abc import Collection, Iterable, Sequence
from copy import deepcopy
from difflib import get_close_matches

from cpid_drake.files.errors import InputError, listed
from cpid_drake.logs.column_map import ColumnMap, JointPositionColumns, JointRateColumns
from cpid_drake.logs.log import THRUST_COLUMNS
from cpid_drake.logs.table import LogTable
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.thrusters import VALVE

YAW = "yaw"
"""The column of the angle of B about W's z axis."""

VELOCITY_IN_B: tuple[str, ...] = ("bvx", "bvy", "bvz")
"""The columns of a velocity expressed in B, which need the attitude on their row."""


def with_own_columns(
    given: ColumnMap,
    table: LogTable,
    where: str,
    *,
    map_name: str = "the map",
    joints: Collection[str] | None = None,
) -> ColumnMap:
    """Return a map that names all columns of a file that are read.

    Those of what the given map does not name are the package's own, if they are in the file. Joints
    that the spacecraft lacks are ignored. The arguments are those of `read_columns`.

    Raises:
        InputError: no time, a column that the map names is missing, groups that are not complete,
            angular velocity both in W and in B or in W without the attitude, no joint positions
            although the spacecraft has joints, or columns of unknown meaning may be joints, joints
            without a rate where others have one, or a column that cannot be read.

    """
    where = f"{where}: {table.header}" if table.header else where
    names = [*table.columns, *table.unreadable]
    explicit = given.named
    free = [name for name in names if name not in explicit and name not in given.ignore_columns]
    unknown = [name for name in free if not _is_own(name)]
    _require_named(explicit, names, unknown, where, map_name)
    _require_readable([*explicit, *filter(_is_own, free)], table, where)
    used = deepcopy(given)
    _take_own_vectors(used, free, unknown, where)
    for name in free:
        if name.startswith(VALVE):
            used.valves.setdefault(name.removeprefix(VALVE), name)
    _settle_frames(used, where)
    _require_no_unit(free, where)
    _find_joints(used, free, joints)
    may_have_joints = {*free} - {*used.named} if joints is None else joints
    _require_joints(used, unknown, where, map_name, is_jointed=bool(may_have_joints))
    _require_readable(used.named, table, where)
    return used


def _require_named(
    explicit: Collection[str],
    names: Sequence[str],
    unknown: Sequence[str],
    where: str,
    map_name: str,
) -> None:
    """Raise an error if a column that the map names is missing."""
    if names and names[0] == "1" and not {*explicit} & {*names}:
        raise InputError(
            f"{where} holds numbers; the first line must hold the columns' names, or a map must "
            "name the columns by their numbers, such as '1'"
        )
    for name in explicit:
        if name not in names and name == "time":
            raise InputError(f"{where}: there is no column 'time'{_likely('time', unknown)}")
        if name not in names:
            raise InputError(
                f"{where}: there is no column '{name}', which {map_name} names; the columns are "
                f"{listed(names)}"
            )


def _require_readable(names: Iterable[str], table: LogTable, where: str) -> None:
    """Raise an error if a column cannot be read."""
    for name in names:
        if name in table.unreadable:
            raise InputError(f"{where}: the column '{name}' {table.unreadable[name]}")


def _take_own_vectors(
    used: ColumnMap, free: Collection[str], unknown: Sequence[str], where: str
) -> None:
    """Give a map the package's own columns of what it does not name, if they are in the file."""
    quaternion, gyro = SENSORS["attitude"].columns, SENSORS["gyro"]
    if not used.attitude.columns and YAW in free and not {*quaternion} & {*free}:
        used.attitude.order = "yaw"
    is_planar = used.attitude.order == "yaw"
    in_plane, about_normal = _parts(used)
    position, velocity = (SENSORS[name].columns[in_plane] for name in ("position", "velocity"))
    rates = gyro.columns[about_normal], gyro.columns_in_W[about_normal]
    force, torque = THRUST_COLUMNS[3:][in_plane], THRUST_COLUMNS[:3][about_normal]
    for section, key, label, alternatives in (
        (used.attitude, "columns", "attitude", ((YAW,) if is_planar else quaternion,)),
        (used.angular_velocity, "columns", gyro.quantity, rates),
        (used.position, "columns", "position", (position,)),
        (used.velocity, "columns", "velocity", (VELOCITY_IN_B[in_plane], velocity)),
        (used.thrust, "force", "the force of thrusters", (force,)),
        (used.thrust, "torque", "the torque of thrusters", (torque,)),
    ):
        if getattr(section, key):
            continue
        present = [columns for columns in alternatives if {*columns} & {*free}]
        for columns in present:
            missing = [name for name in columns if name not in free]
            if missing:
                raise InputError(
                    f"{where}: {label} needs the columns {', '.join(columns)}; missing: "
                    f"{', '.join(missing)}{_likely(missing[0], unknown)}"
                )
        if len(present) > 1:
            raise InputError(
                f"{where}: {label} is there twice, in the body ({', '.join(present[0])}) and in "
                f"the world ({', '.join(present[1])}); keep one of them"
            )
        if present:
            setattr(section, key, list(present[0]))


def _parts(used: ColumnMap) -> tuple[slice, slice]:
    """Return which entries of vectors a log has: all, or on a table x and y, and that about z."""
    if used.attitude.order == "yaw":
        return slice(0, 2), slice(2, 3)
    return slice(0, 3), slice(0, 3)


def _settle_frames(used: ColumnMap, where: str) -> None:
    """Give a map the frames of its rates and velocities, by their columns' names."""
    in_plane, about_normal = _parts(used)
    gyro, rate, speed = SENSORS["gyro"], used.angular_velocity, used.velocity
    is_in_W = tuple(rate.columns) == gyro.columns_in_W[about_normal]
    rate.frame = rate.frame or ("world" if is_in_W else "body")
    is_in_B = tuple(speed.columns) == VELOCITY_IN_B[in_plane]
    speed.frame = speed.frame or ("body" if is_in_B else "world")
    if rate.columns and rate.frame == "world" and not used.attitude.columns:
        raise InputError(
            f"{where}: angular velocity in the world ({', '.join(rate.columns)}) needs the "
            "attitude (qw, qx, qy, qz) to be rotated into the body; if it is in the body, name it "
            f"{', '.join(gyro.columns[about_normal])}"
        )


def _require_no_unit(free: Iterable[str], where: str) -> None:
    """Raise an error if one of the package's own columns states its unit."""
    for name in free:
        plain, bracket, _ = name.partition("[")
        if bracket and _is_own(plain.strip()):
            raise InputError(
                f"{where}: the column '{name}' states its unit: a map of columns must name it "
                "(`cpid log map` writes one), or ignore it (ignore_columns)"
            )


def _require_joints(
    used: ColumnMap, unknown: Sequence[str], where: str, map_name: str, *, is_jointed: bool
) -> None:
    """Raise an error if joints have no column or two, or some have rates and others none."""
    positions, constant = used.joint_positions.columns, used.joint_positions.constant
    for joint in constant:
        if joint in positions or joint in used.joint_rates.columns:
            raise InputError(
                f"{where}: the joint '{joint}' has a column and a constant position "
                f"(joint_positions.constant of {map_name})"
            )
    if not positions and not constant and is_jointed:
        near = _likely("q:joint", unknown)
        raise InputError(f"{where}: there are no joint positions, columns 'q:<joint>'{near}")
    for joint in positions if used.joint_rates.columns else ():
        if joint not in used.joint_rates.columns:
            raise InputError(
                f"{where}: there is a column 'q:{joint}', but no 'qd:{joint}'; give joint rates of "
                "all joints or of none, or leave the joint out (ignore_joints of a map of columns)"
            )


_OWN = {"time", YAW, *VELOCITY_IN_B, *THRUST_COLUMNS}.union(
    *(s.columns + s.columns_in_W for s in SENSORS.values())
)


def _is_own(name: str) -> bool:
    """Return whether the package's own columns have this name."""
    return name in _OWN or (name.startswith(("q:", "qd:", VALVE)) and not name.endswith(":"))


def _likely(wanted: str, unknown: Sequence[str]) -> str:
    """Return a remedy, if there are columns of unknown meaning."""
    if close := get_close_matches(wanted, unknown, n=1):
        return f"; did you mean '{close[0]}'?"
    shown = listed([f"'{name:.40}'" for name in unknown])
    remedy = "`cpid log map` finds out what the columns of a log mean"
    return f"; ignored columns: {shown}; {remedy}" if unknown else ""


def _find_joints(used: ColumnMap, free: Sequence[str], joints: Collection[str] | None) -> None:
    """Find the columns of positions and rates by joint; ignore joints that the spacecraft lacks.

    None is ignored if the log lacks one of the spacecraft's joints, which may have another's name.
    """
    sections: tuple[JointPositionColumns | JointRateColumns, ...]
    sections = used.joint_positions, used.joint_rates
    for section in sections:
        prefix, suffix = section.prefix, section.suffix
        for name in free if prefix or suffix else ():
            is_long = len(name) > len(prefix) + len(suffix)
            if is_long and name.startswith(prefix) and name.endswith(suffix):
                joint = name[len(prefix) : len(name) - len(suffix)]
                section.columns.setdefault(joint, name)
    everything = {**used.joint_positions.columns, **used.joint_rates.columns}
    if joints and all(joint in everything for joint in joints):
        lacking = [joint for joint in everything if joint not in joints]
        used.ignore_joints += [joint for joint in lacking if joint not in used.ignore_joints]
    for section in sections:
        kept = {j: name for j, name in section.columns.items() if j not in used.ignore_joints}
        section.columns = kept
