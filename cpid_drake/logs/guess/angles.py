"""Chooses the columns of an attitude that is no quaternion, and the orders that names allow."""

from dataclasses import replace
from itertools import permutations, product
from typing import cast, get_args

import numpy as np

from cpid_drake.logs.column_map import Angle, BodyAxes, Order, WorldAxes
from cpid_drake.logs.guess.guessed_map import GuessedMap
from cpid_drake.logs.guess.names import (
    NO_VECTOR,
    WORDS,
    Group,
    groups_by_angle,
    groups_by_axis,
    groups_by_number,
    unit_of,
    words_of,
)

_NO_ANGLE = NO_VECTOR | WORDS["angular_velocity"]
_NO_HEADING = _NO_ANGLE | WORDS["joint rate"] | WORDS["other of joint"]
_ROTATIONS = WORDS["rotation"] - {"r"}  # a position may be r, too
_ROLLS = ("roll", "phi", "pitch", "theta", "yaw", "psi")
_AXES = {**dict(zip(_ROLLS, "xxyyzz")), **dict(zip("xyz", "xyz"))}


def find_angles(guess: GuessedMap, free: list[str], axes: list[Group]) -> None:
    """Choose the columns of an attitude of angles or MRPs by their names.

    Orders and units that names do not state stay open.

    Args:
        guess: the guess so far; it is changed.
        free: columns that are neither the time nor of joints.
        axes: the groups of these that differ in their axis.

    """
    triples = [g for g in axes if "w" not in g.members and g.words & WORDS["rotation"]]
    numbered = [g for g in groups_by_number(free) if len(g.members) == 3]
    triples += [g for g in numbered if g.words & _ROTATIONS]
    headings = [Group(c, {"yaw": c}) for c in free if words_of(c) & WORDS["heading"]]
    headings = [g for g in headings if not g.words & _NO_HEADING]
    if guess.spacecraft.tree.normal_B is None and not _is_flat(guess, free):
        headings = []
    choices = next(
        (
            named
            for groups in (
                groups_by_angle(free),
                [g for g in triples if g.words & _ROTATIONS],
                triples,
                headings,
            )
            if (named := [g for g in groups if not g.words & _NO_ANGLE])
        ),
        [],
    )
    if not choices:
        guess.say("attitude", "no four columns have the norm 1, and none are named as its angles")
        guess.missing.append("no columns are an attitude (attitude.columns)")
        return

    def nearness(group: Group) -> tuple[int, int, int]:
        return guess.nearness(group, WORDS["attitude"])

    group, *others = sorted(choices, key=nearness, reverse=True)
    if others and nearness(others[0]) == nearness(group):
        text = f"the attitude may be {' or '.join(g.stem for g in (group, *others))}"
        guess.say("attitude", f"open: {text}")
        guess.missing.append(f"{text} (attitude.columns)")
        return
    besides = f" (not used: {', '.join(g.stem for g in others)})" if others else ""
    guess.say("attitude", f"{', '.join(group.members.values())}: by their names{besides}")
    _allow(guess, group)


def _is_flat(guess: GuessedMap, names: list[str]) -> bool:
    """Return whether columns are those of a base with a place in a plane, and no height or tilt."""
    groups = [group for group in groups_by_axis(names, "xy") if not group.words & NO_VECTOR]
    places = [group for group in groups if guess.is_place(group)]
    has_tilt = any(words_of(name) & {"roll", "pitch", "phi"} for name in names)
    return bool(places) and not has_tilt and not any("z" in g.members for g in places)


def _allow(guess: GuessedMap, group: Group) -> None:
    """Note the orders and units that names of columns allow, and assume the usual ones."""
    given, orders = guess.column_map.attitude, _orders_of(group)
    columns = [*group.members.values()]
    stated, is_large = unit_of(*columns), guess.largest(columns) > 2 * np.pi
    units: tuple[Angle, ...] = ("deg", "rad") if is_large else ("rad", "deg")
    if stated in get_args(Angle):
        units = (cast(Angle, stated),)
        guess.say("attitude", f"in {stated}: the names say so")
    if orders[0][0] == "mrp":
        units = ("rad",)
    guess.attitudes = tuple(
        replace(given, columns=sorted_columns, order=order, unit=unit)
        for (order, sorted_columns), unit in product(orders, units)
    )
    guess.column_map.attitude = guess.attitudes[0]
    for key, values in (("order", orders), ("unit", units)):
        if len(values) > 1:
            guess.free.add(f"attitude.{key}")
            guess.say("attitude", f"the {key} follows from the motion")


def _orders_of(group: Group) -> list[tuple[Order, list[str]]]:
    """Return the orders that names allow, the usual one first, each with the columns in it."""
    members, words = group.members, group.words
    columns = [*members.values()]
    if len(columns) == 1:
        return [("yaw", columns)]
    if not members.keys() <= _AXES.keys() and "rpy" in words:
        members = dict(zip(("roll", "pitch", "yaw"), columns))
    if members.keys() <= _AXES.keys():
        columns = [members[key] for key in sorted(members, key=_AXES.__getitem__)]
    if words & WORDS["mrp"]:
        return [("mrp", columns)]
    if "rotvec" in words:
        return [("rotation_vector", columns)]
    sequences = [*get_args(BodyAxes), *get_args(WorldAxes)]
    orders = [(cast(Order, sequence), columns) for sequence in sequences]
    is_roll = not members.keys().isdisjoint(_ROLLS)
    if members.keys() <= _AXES.keys():  # all orders of three axes that are named
        by_axis = dict(zip("xyz", columns))
        orders = [
            (cast(Order, sequence if is_roll else sequence.upper()), [by_axis[n] for n in sequence])
            for sequence in map("".join, permutations("xyz"))
        ]
    is_euler = is_roll or "euler" in words
    return orders if is_euler else [("rotation_vector", columns), *orders]
