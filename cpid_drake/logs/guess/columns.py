"""Chooses the columns of a log for each quantity by names and values."""

from typing import Any, cast

import numpy as np

from cpid_drake.logs.guess.draft import MapDraft
from cpid_drake.logs.guess.joints import JointColumnsFound
from cpid_drake.logs.guess.names import (
    Group,
    groups_by_angle,
    groups_by_axis,
    groups_by_number,
    unit_of,
    words_of,
)

_POSITION = {"position", "pos", "p", "t", "translation", "trans", "location", "xyz"}
_VELOCITY = {"velocity", "vel", "v", "linear", "speed"}
_RATE = {"angular", "gyro", "gyr", "omega", "w", "bw", "rates", "rate", "angvel", "wb", "gyroscope"}
_ATTITUDE = {"attitude", "att", "orientation", "quat", "quaternion", "q", "rotation", "rot", "r"}
_OTHER = {"acceleration", "accel", "acc", "covariance", "cov", "force", "torque", "magnetic", "mag"}
_THRUST = {"thrust", "thruster", "thrusters", "rcs", "propulsion"}
_FORCE, _TORQUE = {"force", "forces", "f"}, {"torque", "torques", "moment", "tau", "t", "m"}
_COMMANDS = {"command", "cmd", "commanded", "desired", "ref", "reference", "setpoint"}
_OTHER |= _THRUST
_OTHER |= {"command", "cmd", "desired", "ref", "reference", "setpoint", "target", "goal"}


def choose_columns(draft: MapDraft, joints: JointColumnsFound) -> None:
    """Choose the columns of joints, attitude, position, velocity and angular velocity."""
    _choose_joints(draft, joints)
    taken = {*joints.all_columns, draft.map.time.column}
    free = [name for name in draft.raw.values if name not in taken]
    axes = groups_by_axis(free)
    _choose_attitude(draft, free, axes)
    _choose_vectors(draft, free, axes)
    _choose_thrust(draft, axes)


def _choose_joints(draft: MapDraft, found: JointColumnsFound) -> None:
    names = draft.spacecraft.joint_names
    for section, columns in (
        (draft.map.joint_positions, found.positions),
        (draft.map.joint_rates, found.rates),
    ):
        section.columns = {joint: columns[joint] for joint in names if joint in columns}
    draft.map.ignore_joints = found.others
    draft.reasons["joint_positions"] = list(found.reasons)
    if found.rates:
        draft.say("joint_rates", "columns beside the positions, named as rates")
    if found.others:
        draft.say("ignore_joints", "the spacecraft has no such joints")


def _choose_attitude(draft: MapDraft, free: list[str], axes: list[Group]) -> None:
    """Choose the columns of the attitude: a quaternion, else angles."""
    quaternions = []
    for group in axes:
        if "w" in group.members and draft.raw.has_unit_norm(group.members.values()):
            columns = list(group.members.values())
            letters = "".join(group.members)
            order = letters if letters in ("wxyz", "xyzw") else "wxyz"
            if letters != order:
                columns = [group.members[letter] for letter in order]
            quaternions.append((group, columns, order, "their letters say the order"))
    for group in groups_by_number(free):
        if len(group.members) == 4 and draft.raw.has_unit_norm(group.members.values()):
            columns = list(group.members.values())
            quaternions.append((group, columns, "", "the order follows from the motion"))
    if quaternions:
        chosen = _nearest(draft, [entry[0] for entry in quaternions], _ATTITUDE)
        _, columns, order, how = next(e for e in quaternions if e[0] is chosen)
        draft.map.attitude.columns = columns
        draft.map.attitude.order = cast(Any, order or "wxyz")
        draft.has_free_order = not order
        norm = np.linalg.norm([draft.raw.values[c] for c in columns], axis=0)
        low, high = np.nanmin(norm), np.nanmax(norm)
        draft.say(
            "attitude",
            f"four columns {', '.join(columns)} of norm {low:.5g} to {high:.5g}: a quaternion; "
            f"{how}",
        )
        return
    draft.has_free_order = False
    _choose_angles(draft, free, axes)


def _choose_angles(draft: MapDraft, free: list[str], axes: list[Group]) -> None:
    """Choose three angles as the attitude."""
    given = draft.map.attitude
    for group in groups_by_angle(free):
        if not group.words & (_RATE | _OTHER):
            given.columns = [group.members[key] for key in ("roll", "pitch", "yaw")]
            given.order = "roll_pitch_yaw"
            _angle_unit(draft, "the names say roll, pitch and yaw")
            return
    rotations = [g for g in axes if g.words & {"r", "rot", "rotation", "rotvec", "euler"}]
    rotations = [g for g in rotations if "w" not in g.members]
    if rotations:
        group = _nearest(draft, rotations, _ATTITUDE)
        given.columns = [group.members[key] for key in "xyz"]
        given.order = "euler_xyz" if "euler" in group.words else "rotation_vector"
        _angle_unit(draft, "three columns of a rotation")
        return
    draft.say("attitude", "no four columns have the norm 1, and none are named as angles")


def _angle_unit(draft: MapDraft, why: str) -> None:
    given = draft.map.attitude
    unit = unit_of(given.columns[0])
    size = max(np.nanmax(np.abs(draft.raw.values[c])) for c in given.columns)
    given.unit = "deg" if unit == "deg" or (unit is None and size > 2 * np.pi) else "rad"
    named = "the name says so" if unit else f"the largest is {size:.4g}"
    draft.say("attitude", f"{', '.join(given.columns)}: {why}; in {given.unit}: {named}")


def _choose_vectors(draft: MapDraft, free: list[str], axes: list[Group]) -> None:
    """Choose the columns of position, velocity and angular velocity by their names."""
    used = set(draft.map.attitude.columns)
    groups = [g for g in axes if not used & set(g.members.values())]
    numbered = [g for g in groups_by_number(free) if len(g.members) == 3]
    groups += [g for g in numbered if not used & set(g.members.values())]
    groups = [g for g in groups if not g.words & _OTHER]
    rates = [g for g in groups if g.words & _RATE and "linear" not in g.words]
    velocities = [g for g in groups if g not in rates and g.words & _VELOCITY]
    named = {id(g) for g in (*rates, *velocities)}
    positions = [g for g in groups if id(g) not in named]
    positions = [g for g in positions if g.words & _POSITION or g.stem == "*"]
    for key, choices, words in (
        ("angular_velocity", rates, _RATE),
        ("velocity", velocities, _VELOCITY),
        ("position", positions, _POSITION),
    ):
        if not choices:
            draft.say(key, f"no {key.replace('_', ' ')}: no three columns have names for it")
            continue
        group = _nearest(draft, choices, words)
        columns = [name for axis, name in group.members.items() if axis != "w"]
        section = getattr(draft.map, key)
        section.columns = columns
        unit = unit_of(columns[0])
        suffix = "" if key == "position" else "/s"
        if unit:
            section.unit = unit if unit == "rpm" else unit + suffix
        others = [g.stem for g in choices if g is not group]
        besides = f" (not used: {', '.join(others)})" if others else ""
        draft.say(key, f"{', '.join(columns)}: by their names{besides}")
        if unit:
            draft.say(key, f"in {section.unit}: the names say so")
    draft.map.angular_velocity.frame = "body"


def _choose_thrust(draft: MapDraft, axes: list[Group]) -> None:
    """Choose the columns of the thrusters' force and torque, if their names say what they are."""
    groups = [g for g in axes if g.words & _THRUST and not g.words & _COMMANDS]
    given, found = draft.map.thrust, False
    for group in groups:
        columns = [group.members[axis] for axis in "xyz"]
        is_torque = bool(group.words & _TORQUE) and not group.words & _FORCE
        if is_torque and not given.torque:
            given.torque, found = columns, True
        elif not is_torque and not given.force:
            given.force, found = columns, True
    if not found:
        return
    columns = [*given.force, *given.torque]
    draft.say(
        "thrust",
        f"{', '.join(columns)}: by their names; in N and N*m, in the axes of the base, and the "
        "force at its origin (point_B)",
    )
    left = [g.stem for g in groups if not {*g.members.values()} & {*columns}]
    if left:
        draft.say("thrust", f"not used: {', '.join(left)}")


def _nearest(draft: MapDraft, groups: list[Group], words: set[str]) -> Group:
    """Return the group of the base body, else the one whose name has most of the words."""
    names = {draft.base.lower(), *words_of(draft.base)} - {""}
    usual = {"base", "bus", "body", "chaser", "servicer", "spacecraft"}
    return max(
        groups,
        key=lambda g: (len(g.words & names), len(g.words & usual), len(g.words & words)),
    )
