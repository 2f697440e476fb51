"""Guesses the map of a log's columns: names first, then the conventions that explain it best.

Names say which columns are which quantity, and perhaps units. What they do not determine is chosen
among `alternatives.alternatives` by `logs.search`: joint rates decide about the
joints and the clock, the gyro about the attitude, the conservation of momentum about the rest.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.files.errors import InputError, listed
from cpid_drake.files.one_thread import one_thread
from cpid_drake.logs.alternatives import Alternative
from cpid_drake.logs.column_map import ColumnMap, with_entries
from cpid_drake.logs.combined_alternatives import together
from cpid_drake.logs.common_clock import delay_notes, file_delays
from cpid_drake.logs.conventions import DIFFERS
from cpid_drake.logs.guess.columns import find_columns
from cpid_drake.logs.guess.guessed_map import GuessedMap
from cpid_drake.logs.instants import instants_of
from cpid_drake.logs.noise_estimation import sensor_noise
from cpid_drake.logs.score import MOMENTUM, WORSE
from cpid_drake.logs.search import AGREES, EXPLAINS, Search
from cpid_drake.logs.table import LogTable
from cpid_drake.spacecraft.spacecraft import Spacecraft

_ANGLES = {"attitude.order", "attitude.unit"}
_ATTITUDE = _ANGLES | {"attitude.direction", "angular_velocity.unit"}
_CLOCK = {"time.unit"}
_JOINTS, _GYRO_AXES = {"joint_positions.unit", "joint_rates.unit"}, "angular_velocity.R_BS"

_STAGES = (
    ("q:", ({"joint_rates.unit"}, {"joint_positions.unit"})),
    ("attitude", (_ATTITUDE | {"angular_velocity.frame"},)),
    (MOMENTUM, (_ATTITUDE, _JOINTS, {"position.unit", "position.point_B"})),
    ("position", ({"velocity.frame"}, {"velocity.unit"})),
)
"""Comparisons that decide about conventions, one after the other: the beginning of their names, and
groups of keys of which they may change one each."""


@one_thread
def guess_map(
    table: LogTable, spacecraft: Spacecraft, base: str = "", frame_rate: float | None = None
) -> GuessedMap:
    """Guess the meaning of a log's columns.

    Args:
        table: the log's columns.
        spacecraft: the spacecraft model, whose joints the log has.
        base: name of the base body, which distinguishes the base's columns from those of other
            bodies.
        frame_rate: frames per second, if the log counts frames and does not say it [Hz].

    Raises:
        InputError: there are no rows; no column can be the time, or none the position of a joint;
            the message lists the columns.

    """
    numbers = {n: c for n, c in table.columns.items() if n not in table.texts}
    columns = {name: column for name, column in numbers.items() if np.isfinite(column).any()}
    if not columns:
        raise InputError("the file has no rows of numbers")
    if "1" in columns:
        raise InputError(
            "the file does not name its columns: write a map that names them by their numbers, "
            "such as '1', and check it with `cpid log check --columns`"
        )
    guess = GuessedMap(table.of_columns(columns), spacecraft, base)
    find_columns(guess, frame_rate)
    if table.files:
        log = guess.with_all_clocks
        guess.delays = file_delays(log, spacecraft.tree)
        for note in delay_notes(log, guess.delays):
            guess.say("time", note)
    whole = guess.table
    guess.table = guess.compared.table
    _settle_clock(guess)
    explained, given = _settle_conventions(guess), guess.column_map.attitude
    if "time.unit" in guess.free:
        guess.missing.append(f"the time may be in {' or '.join(guess.time_units)} (time.unit)")
    is_open = {key: f"attitude.{key}" in guess.free for key in ("order", "direction")}
    if given.columns and any(is_open.values()):
        keys = [key for key, value in is_open.items() if value]
        guess.missing.append(
            f"{' and '.join(keys)} of the attitude {'are' if keys[1:] else 'is'} not determined: "
            f"{given.order}, {given.direction} are assumed ({explained}) "
            f"({', '.join(f'attitude.{key}' for key in keys)})"
        )
    if "attitude.unit" in guess.free:
        guess.missing.append("the angles of the attitude may be in rad or deg (attitude.unit)")
    if "joint_positions.unit" in guess.free:
        _assume_joint_unit(guess)
    guess.table = whole
    if unused := guess.read(table).ignored:
        guess.say("ignore_columns", f"not used: {listed(unused, 20)}")
    return guess


def _settle_clock(guess: GuessedMap) -> None:
    """Choose the unit of time in which any positions and rates agree."""
    for name in ("q:", "attitude", "position"):
        is_open = not _CLOCK.isdisjoint(guess.free)
        compared = _compared(guess, name, [_CLOCK, guess.free - _CLOCK]) if is_open else []
        if compared and compared[0][0] < AGREES:
            unit = compared[0][1].time.unit
            guess.column_map = with_entries(guess.column_map, {"time.unit": unit})
            guess.free -= _CLOCK
            guess.say("time", f"in {unit}: positions and rates then agree")


def _settle_conventions(guess: GuessedMap) -> str:
    """Choose the conventions that names do not determine; return what momentum shows.

    A key is settled if every other value of it leaves a clearly larger residual.
    """
    explained = "nothing moves"
    for name, groups in _STAGES:
        column_map = guess.column_map
        if name == "position" and column_map.angular_velocity.columns:
            column_map.velocity.point_B = column_map.position.point_B
        if name == MOMENTUM and not column_map.attitude.columns:
            continue
        compared = _compared(guess, name, groups)
        if name == "attitude" and compared and compared[0][0] > AGREES:
            guess.free.add(_GYRO_AXES)
            turned = _compared(guess, name, [{_GYRO_AXES} | _ANGLES])
            compared = turned if turned[0][0] < AGREES else compared
        if not compared:
            continue
        residual, chosen = compared[0]
        what = "positions and rates"
        if name == MOMENTUM:
            explained = f"momentum leaves {min(residual, 1.0):.0%} of the base's motion unexplained"
            what = "the motion of the base and what conservation of momentum allows"
        if residual <= (EXPLAINS if name == MOMENTUM else DIFFERS):
            guess.column_map = chosen
            alike = [each for value, each in compared if value <= WORSE * residual]
            if not _ANGLES.isdisjoint(set[str]().union(*groups)):
                read = [(each.attitude.order, each.attitude.unit) for each in alike]
                guess.attitudes = tuple(a for a in guess.attitudes if (a.order, a.unit) in read)
            for key in sorted({_GYRO_AXES}.union(*groups) & guess.free):
                value = _entry(chosen, key)
                rivals = [each for each in alike if _entry(each, key) != value]
                is_of_angles = key == "attitude.order" and bool(guess.attitudes)
                if is_of_angles:  # another order may differ by less than another axis or sign
                    rivals = [each for each in rivals if _differ(guess, chosen, each)]
                if not rivals and not (is_of_angles and residual > AGREES):
                    guess.free.discard(key)
                    section, _, entry = key.partition(".")
                    guess.say(section, f"{entry} {value}: {what} then differ by {residual:.2%}")
        elif name == MOMENTUM:  # the likeliest is assumed, and stays open
            given, gyro = chosen.attitude, chosen.angular_velocity
            guess.column_map = replace(guess.column_map, attitude=given, angular_velocity=gyro)
        elif name == "attitude":  # the gyro contradicts everything
            guess.missing.append(
                "the attitude does not rotate at the angular velocity in any convention (they "
                f"differ by {residual:.0%} at least): order and direction of the attitude, or the "
                "axes of one of the sensors, are not determined"
            )
            guess.free -= _ATTITUDE  # momentum cannot decide against the gyro
    return explained


def _assume_joint_unit(guess: GuessedMap) -> None:
    """Decide on the unit of joint positions by their size, or leave it open."""
    given = guess.column_map.joint_positions
    size = guess.largest(given.columns.values())
    if size > 4 * np.pi:
        given.unit = "deg"
        guess.say("joint_positions", f"in deg: in rad, {size:.4g} would be more than two turns")
        return
    guess.say("joint_positions", f"in {given.unit}: assumed")
    guess.missing.append("the joint positions may be in rad or deg (joint_positions.unit)")


def _differ(guess: GuessedMap, one: ColumnMap, other: ColumnMap) -> bool:
    """Return whether two orders, in one unit, read attitudes that differ by more than noise."""
    one = with_entries(one, {"attitude.unit": other.attitude.unit})
    logs = [replace(guess, column_map=each).log for each in (one, other)]
    first, second = map(instants_of, logs)
    if first is None or second is None or not np.array_equal(first.time, second.time):
        return True
    turns = Rotation.from_matrix(np.swapaxes(first.R_WB, 1, 2) @ second.R_WB).magnitude()
    return bool(np.sqrt(np.mean(turns**2)) > sensor_noise("attitude", logs[0].attitude))


def _entry(column_map: ColumnMap, key: str) -> str:
    section, _, name = key.partition(".")
    return str(getattr(getattr(column_map, section), name))


def _compared(
    guess: GuessedMap, name: str, groups: Sequence[set[str]]
) -> list[tuple[float, ColumnMap]]:
    """Return residuals of the map in other conventions, the one to adopt first.

    Of conventions that are about as good, the first is chosen: what is usual comes first.

    Args:
        guess: the guess so far.
        name: beginning of the comparisons' names; the residual is the mean of theirs.
        groups: keys of the map; of those that are free, one alternative of each group, or none.

    """
    given = instants_of(guess.log)
    if given is None:
        return []
    keys = [group & guess.free for group in groups]
    tree, names = guess.spacecraft.tree.lumped, guess.spacecraft.joint_names
    search = Search(given, names, tree if name == MOMENTUM else None, {"attitude"})
    for reading in _readings(guess, keys):
        column_map = with_entries(guess.column_map, reading)
        log = instants_of(replace(guess, column_map=column_map).log) if reading else given
        if log is not None:
            base = Alternative("", log, tree, reading, 0)
            changed = together(base, names, guess.column_map, keys)
            search.compare(each for each in changed if _has_clock(guess, each))
    ranked = search.ranked(name)
    return [(value, with_entries(guess.column_map, each.entries)) for value, each in ranked]


def _readings(guess: GuessedMap, keys: Sequence[set[str]]) -> list[dict[str, Any]]:
    """Return entries of an attitude of angles, as names allow them: of any order and unit.

    No change of a quaternion gives another order of angles, or another unit.
    """
    given = guess.column_map.attitude
    if not guess.attitudes or _ANGLES.isdisjoint(set[str]().union(*keys)):
        return [{}]
    return [
        {f"attitude.{key}": getattr(each, key) for key in ("columns", "order", "unit")}
        for each in guess.attitudes
        if ("attitude.order" in guess.free or each.order == given.order)
        and ("attitude.unit" in guess.free or each.unit == given.unit)
    ]


def _has_clock(guess: GuessedMap, each: Alternative) -> bool:
    """Return whether a reading has a unit of time that the steps allow."""
    return each.entries.get("time.unit") in (None, *guess.time_units)
