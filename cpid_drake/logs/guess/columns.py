"""Chooses the columns of a log for each quantity by names and values."""

from collections.abc import Collection
from typing import Any, cast

import numpy as np

from cpid_drake.files.errors import InputError
from cpid_drake.logs.column_map import TimeUnit, scale_of
from cpid_drake.logs.guess.angles import find_angles
from cpid_drake.logs.guess.guessed_map import GuessedMap
from cpid_drake.logs.guess.joint_columns import find_joint_units, find_joints
from cpid_drake.logs.guess.names import (
    NO_VECTOR,
    WORDS,
    Group,
    frame_rate_of,
    groups_by_axis,
    groups_by_number,
    unit_of,
    words_of,
)

_TIMES = ("stamp", "timestamp", "time", "t", "clock", "secs", "sec", "seconds", "utc", "frame")
_YEARS = (5e8, 4e9)
"""Seconds since 1970 in the years 1985 to 2096."""

_NO_SPIN = NO_VECTOR | WORDS["other of joint"] | {"linear"}
_STEPS = (1e-4, 0.5, 5.0)
"""Shortest and longest step of a log, and the one above which the time may be in a smaller unit,
between them [s]."""


def find_columns(guess: GuessedMap, frame_rate: float | None) -> None:
    """Choose the columns of all quantities, and the units that names and values state.

    An angle alone, without a height of the base, is that of a spacecraft on a table.

    Raises:
        InputError: no column can be the time, or it counts frames of an unknown rate; or none can
            be the position of a joint that is not a rotor.

    """
    _find_time(guess, frame_rate)
    taken = {guess.column_map.time.column, *find_joints(guess)}
    free = [name for name in guess.columns if name not in taken]
    axes = groups_by_axis(free)
    _find_attitude(guess, free, axes)
    if guess.is_planar:
        axes = groups_by_axis(free, "xy")
        if guess.spacecraft.tree.normal_B is None:
            guess.spacecraft = guess.spacecraft.on_table()
    _find_vectors(guess, free, axes)
    _find_thrust(guess, axes)
    find_joint_units(guess)


def _find_time(guess: GuessedMap, frame_rate: float | None) -> None:
    candidates = []
    for name, column in guess.columns.items():
        words, stamps = words_of(name), column[np.isfinite(column)]
        ranks = [k for k, word in enumerate(_TIMES) if word in words]
        increases = (
            stamps.size > 1 and np.mean(np.diff(stamps) >= 0) > 0.98 and stamps[-1] > stamps[0]
        )
        is_first = name == next(iter(guess.columns))
        if (ranks or is_first) and increases and not words & WORDS["nanoseconds"]:
            is_other = not ranks or bool(words & WORDS["other clock"])
            # A stamp of one topic is in the rows of this topic only.
            candidates.append((is_other, -stamps.size, [*ranks, len(_TIMES)][0], name))
    if not candidates:
        raise InputError(
            "no column can be the time: it increases, and is the first or has a name such as "
            f"'time' or 'stamp'; the columns of numbers are {', '.join([*guess.columns][:12])}"
        )
    name, time = min(candidates)[-1], guess.column_map.time
    ticks = guess.columns[name][np.isfinite(guess.columns[name])]
    steps = np.diff(ticks)
    step = float(np.median(steps[steps > 0]))
    time.column = name
    guess.say("time", f"'{name}' increases, from {ticks[0]:.12g} in steps of {step:.6g}")
    if "frame" in words_of(name):
        time.unit, time.rate = "frame", frame_rate_of(name) or frame_rate
        if time.rate is None:
            raise InputError(
                f"the column '{name}' counts frames, and the log does not say how many there are "
                "in a second: give --frame-rate"
            )
        time.epoch = float(ticks[0])
        guess.say("time", f"{time.rate:g} frames per second")
        return
    rest = words_of(name) - {"sec", "secs", "seconds"}
    beside = [c for c in guess.columns if words_of(c) - WORDS["nanoseconds"] == rest != words_of(c)]
    if beside and rest != words_of(name):
        time.nanoseconds = beside[0]
        guess.say("time", f"'{time.nanoseconds}' holds the nanoseconds")
    else:
        time.unit, why, guess.time_units = _time_unit(unit_of(name), float(ticks[0]), step)
        guess.free |= {"time.unit"} if guess.time_units else set()
        guess.say("time", f"in {time.unit}: {why}")
    if abs(ticks[0]) * scale_of(time.unit) > 1e5:
        time.epoch = float(ticks[0])
        guess.say("time", "the time starts at zero at the first row")


def _time_unit(
    stated: str | None, first: float, step: float
) -> tuple[TimeUnit, str, tuple[TimeUnit, ...]]:
    """Return the unit of a clock, the reason, and all units if several are possible."""
    units: tuple[TimeUnit, ...] = ("s", "ms", "us", "ns")
    for unit in units:
        if unit == stated:
            return unit, "the name says so", ()
        if stated not in units and _YEARS[0] < first * scale_of(unit) < _YEARS[1]:
            return unit, "it counts from 1970", ()
    possible = tuple(u for u in units if _STEPS[0] <= step * scale_of(u) <= _STEPS[2])
    if not possible:
        return "s", "assumed", ()
    size = step * scale_of(possible[0])
    is_open = size >= _STEPS[1] and len(possible) > 1
    return possible[0], f"the steps are then {size:.4g} s", possible if is_open else ()


# -- the base -------------------------------------------------------------------------------------


def _find_attitude(guess: GuessedMap, free: list[str], axes: list[Group]) -> None:
    """Choose the columns of the attitude: a quaternion, else angles."""
    given = guess.column_map.attitude
    quaternions = [g for g in axes if "w" in g.members]
    quaternions += [g for g in groups_by_number(free) if len(g.members) == 4]
    quaternions = [g for g in quaternions if guess.has_unit_norm(g.members.values())]
    guess.free.add("attitude.direction")
    if quaternions:
        members = _nearest(guess, quaternions, WORDS["attitude"]).members
        letters, how = "".join(members), "their letters say the order"
        given.columns = [*members.values()]
        if "w" not in members:
            guess.free.add("attitude.order")
            how = "the order follows from the motion"
        elif letters in ("wxyz", "xyzw"):
            given.order = cast(Any, letters)
        else:
            given.columns = [members[letter] for letter in "wxyz"]
        text = f"four columns {', '.join(given.columns)} of norm 1: a quaternion; {how}"
        guess.say("attitude", text)
        return
    find_angles(guess, free, axes)


def _find_vectors(guess: GuessedMap, free: list[str], axes: list[Group]) -> None:
    """Choose the columns of position, velocity and angular velocity by their names."""
    spins = _spins(free, axes) if guess.is_planar else []
    if guess.is_planar:
        axes = [Group(g.stem, {k: g.members[k] for k in "xy"}) for g in axes]
    else:
        axes = [*axes, *(g for g in groups_by_number(free) if len(g.members) == 3)]
    groups, used = axes, {*guess.column_map.attitude.columns}
    groups = [g for g in groups if not used & {*g.members.values()} and not g.words & NO_VECTOR]
    guess.free |= {"angular_velocity.frame", "velocity.frame", "position.point_B"}
    for key in ("angular_velocity", "velocity", "position"):
        words = WORDS[key]
        choices = [g for g in groups if g.words & words]
        if key == "position":  # r is a rotation, too
            choices = [g for g in groups if guess.is_place(g)]
            choices = choices or [g for g in groups if "r" in g.words]
        if key == "angular_velocity":
            choices = spins or [g for g in choices if "linear" not in g.words]
        groups = [g for g in groups if g not in choices]
        if not choices:
            guess.say(key, f"no {key.replace('_', ' ')}: no columns have names for it")
            continue
        group, section = _nearest(guess, choices, words), getattr(guess.column_map, key)
        ordered = sorted(group.members, key=lambda axis: (len(axis), axis))  # x, y, z or 9, 10, 11
        section.columns = [group.members[axis] for axis in ordered if axis != "w"]
        if key == "angular_velocity":
            guess.column_map.angular_velocity.frame = "body"
        others = [g.stem for g in choices if g is not group]
        besides = f" (not used: {', '.join(others)})" if others else ""
        guess.say(key, f"{', '.join(section.columns)}: by their names{besides}")
        if unit := unit_of(section.columns[0]):
            section.unit = unit if key == "position" or unit == "rpm" else f"{unit}/s"
            guess.say(key, f"in {section.unit}: the names say so")
        else:
            guess.free.add(f"{key}.unit")


def _spins(free: list[str], axes: list[Group]) -> list[Group]:
    """Return the columns that may be the rate about the normal of a table, as groups of one."""
    across = {group.members[axis] for group in axes for axis in "xy"}
    spins = []
    for name in free:
        words = words_of(name)
        is_rate = words & WORDS["angular_velocity"] or (
            words & WORDS["heading"] and words & WORDS["joint rate"]
        )
        if is_rate and name not in across and not words & _NO_SPIN:
            spins.append(Group(name, {"z": name}))
    return spins


def _find_thrust(guess: GuessedMap, axes: list[Group]) -> None:
    """Choose the columns of the thrusters' force and torque, if their names say what they are."""
    given, left = guess.column_map.thrust, []
    axes_of = {"force": "xy", "torque": "z"} if guess.is_planar else {}
    for group in (g for g in axes if g.words & WORDS["thrust"] and not g.words & WORDS["command"]):
        key = (
            "torque"
            if group.words & WORDS["torque"] and not group.words & WORDS["force"]
            else "force"
        )
        columns = [group.members.get(axis, "") for axis in axes_of.get(key, "xyz")]
        if getattr(given, key) or not all(columns):
            left.append(group.stem)
        else:
            setattr(given, key, columns)
    if columns := [*given.force, *given.torque]:
        text = "by their names; in N and N*m, in the axes of the base, and the force at its origin"
        guess.say("thrust", f"{', '.join(columns)}: {text} (point_B)")
    if left:
        guess.say("thrust", f"not used: {', '.join(left)}")


def _nearest(guess: GuessedMap, groups: list[Group], words: Collection[str]) -> Group:
    """Return the group of the base body, else the one whose name has most of the words."""
    return max(groups, key=lambda group: guess.nearness(group, words))
