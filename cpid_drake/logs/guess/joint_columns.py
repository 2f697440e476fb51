"""Guesses which columns of a log belong to which joint of the spacecraft, and their units."""

from typing import Any, cast

import numpy as np

from cpid_drake.files.errors import InputError
from cpid_drake.logs.guess.guessed_map import GuessedMap
from cpid_drake.logs.guess.names import (
    WORDS,
    groups_by_number,
    letters_of,
    unit_of,
    words_of,
)
from cpid_drake.logs.unlogged_joints import lock_unlogged

_OTHERS = WORDS["other of joint"] | WORDS["command"]
_NUMBERED_OTHERS = _OTHERS | WORDS["of the base"]


def find_joints(guess: GuessedMap) -> set[str]:
    """Choose the columns of the joints by their names, else by numbers; return all of joints."""
    craft, free = guess.spacecraft, [c for c in guess.columns if c != guess.column_map.time.column]
    names, used = craft.joint_names, set[str]()
    needed = [name for k, name in enumerate(names) if not craft.tree.is_rotor(k)]
    named, rated = dict[str, dict[str, str]](), dict[str, dict[str, str]]()
    logged = [j for j in names if any(_stem(column, j) is not None for column in free)]
    if logged:
        guess.spacecraft, _ = lock_unlogged(craft, logged)
        needed = [joint for joint in needed if joint in guess.spacecraft.joint_names]
    for column in free:
        for joint in sorted(names, key=len, reverse=True):
            if (stem := _stem(column, joint)) is not None:
                used.add(column)
                words = words_of(stem)
                if not words & _OTHERS:
                    by_stem = rated if words & WORDS["joint rate"] else named
                    by_stem.setdefault(stem, {}).setdefault(joint, column)
                break
    positions, rates = _chosen(named), _chosen(rated)
    if any(joint in positions for joint in needed):
        guess.say("joint_positions", "the columns have the names of the spacecraft's joints")
    else:
        for columns_of, is_rate in ((rates, True), (positions, False)):
            columns_of.update(columns_of or _numbered(guess, free, needed, is_rate))
        used |= {*positions.values(), *rates.values()}
    for joint in needed:
        if joint not in positions:
            raise InputError(
                f"no column can be the position of joint '{joint}': none has its name, and there "
                f"are no {len(needed)} numbered columns; the columns of numbers are "
                f"{', '.join(free[:20])}; a log of motion capture alone needs the "
                "joint positions beside it, on the same clock"
            )
    without = [joint for joint in positions if joint not in rates]
    if rates and without:
        guess.say("joint_positions", f"rates are not used: there is none of {', '.join(without)}")
    elif rates:
        guess.say("joint_rates", "columns beside the positions, named as rates")
        guess.column_map.joint_rates.columns = {j: rates[j] for j in names if j in rates}
    guess.column_map.joint_positions.columns = {j: positions[j] for j in names if j in positions}
    if others := [c[2:] for c in free if c.startswith("q:") and c not in used]:
        guess.column_map.ignore_joints = others
        guess.say("ignore_joints", "the spacecraft has no such joints")
    return used


def _chosen(named: dict[str, dict[str, str]]) -> dict[str, str]:
    """Return columns by joint: those of names alike in most joints, else the first.

    `named` are columns by what is around the joint's name, and by joint.
    """

    def rank(stem: str) -> tuple[int, bool, bool]:
        """Return how well all columns of a form fit the joints."""
        is_joint = not words_of(stem).isdisjoint({"joint", "joints"})
        return len(named[stem]), stem in ("q:*", "qd:*"), is_joint

    chosen = dict[str, str]()
    for stem in sorted(named, key=rank, reverse=True):  # equal ones stay in the order of the file
        chosen = named[stem] | chosen
    return chosen


def _stem(column: str, joint: str) -> str | None:
    """Return a column's name with * for the joint's name; None if it does not contain it."""
    wanted = letters_of(joint.rsplit("::", 1)[-1])
    places = [k for k, letter in enumerate(column) if letter.isascii() and letter.isalnum()]
    start = letters_of(column).find(wanted)
    if start < 0 or not wanted:
        return None
    behind = column[places[start + len(wanted) - 1] + 1 :]
    if wanted[-1].isdigit() and behind[:1].isdigit():
        return None  # joint1 is not joint10
    return f"{column[: places[start]]}*{behind}"


def _numbered(
    guess: GuessedMap, free: list[str], needed: list[str], is_rate: bool
) -> dict[str, str]:
    """Return numbered columns by joint, in the joints' order."""
    names = guess.spacecraft.joint_names
    groups = [
        group
        for group in groups_by_number(free)
        if not group.words & _NUMBERED_OTHERS
        and bool(group.words & WORDS["joint rate"]) == is_rate
        and not (len(group.members) == 4 and guess.has_unit_norm(group.members.values()))
    ]
    named = [g for g in groups if g.words & (WORDS["joint rate"] if is_rate else WORDS["joint"])]
    for group in named:
        order = names if len(group.members) == len(names) else needed
        if len(group.members) == len(order):
            text = f"{len(order)} numbered columns {group.stem}, in the model's joint order"
            guess.say("joint_positions", text)
            return dict(zip(order, group.members.values()))
    fitting = [g for g in groups if len(g.members) == len(needed) and not is_rate]
    if len(fitting) != 1:
        return {}
    text = (
        "are the only numbered columns that are as many as the joints, in the model's joint order"
    )
    guess.say("joint_positions", f"{fitting[0].stem} {text}")
    return dict(zip(needed, fitting[0].members.values()))


def find_joint_units(guess: GuessedMap) -> None:
    """Choose the units of joints by names, and by the joints' limits."""
    craft, at = guess.spacecraft, guess.column_map.joint_positions
    rate_at = guess.column_map.joint_rates
    names, low, high = craft.joint_names, craft.limits.lowest, craft.limits.highest
    slides = {names[k] for k in craft.tree.sliding}
    for joint in slides & at.columns.keys():
        k, column = names.index(joint), at.columns[joint]
        far = guess.largest([column]) > 2 * max(abs(low[k]), abs(high[k]))
        at.units[joint] = length = cast(Any, unit_of(column) or ("mm" if far else "m"))
        if joint in rate_at.columns:
            rate_at.units[joint] = cast(Any, f"{length}/s")
    turning = [joint for joint in at.columns if joint not in slides]
    # A wheel's angle grows without limit, and has no effect on the momentum.
    arms = {j: names.index(j) for j in turning if not craft.tree.is_rotor(names.index(j))}
    stated = unit_of(*(at.columns[joint] for joint in turning))
    rate_stated = unit_of(*(rate_at.columns[j] for j in turning if j in rate_at.columns))

    def is_within(scale: float, beyond: float = 0.1) -> bool:
        return all(
            low[k] - beyond <= scale * np.nanmin(guess.columns[at.columns[joint]])
            and scale * np.nanmax(guess.columns[at.columns[joint]]) <= high[k] + beyond
            for joint, k in arms.items()
        )

    if stated in ("deg", "rad", "mrad"):
        at.unit = cast(Any, stated)
        guess.say("joint_positions", f"in {at.unit}: the names say so")
    elif not is_within(1.0, np.pi) and is_within(np.pi / 180):
        at.unit = "deg"
        guess.say("joint_positions", "in deg: in rad they would far exceed the joints' limits")
    elif arms:
        guess.free.add("joint_positions.unit")
    if rate_stated in ("deg", "rad", "mrad", "rpm"):
        rate_at.unit = cast(Any, rate_stated if rate_stated == "rpm" else f"{rate_stated}/s")
        guess.say("joint_rates", f"in {rate_at.unit}: the names say so")
    elif rate_at.columns:
        guess.free.add("joint_rates.unit")
