"""Guesses the map of a log's columns: names first, then the conventions that explain it best.

Names say which columns are which quantity, and perhaps units. What they leave open is chosen among
`alternatives.alternatives` by the comparisons of `logs.score`: the gyro decides about the attitude,
joint rates about the joints, the conservation of momentum about the rest.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from cpid_drake.logs.column_map import ColumnMap, TimeUnit
from cpid_drake.logs.conventions import AGREES
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.guess.clock import guess_time
from cpid_drake.logs.guess.columns import choose_columns
from cpid_drake.logs.guess.draft import CLEAR, MapDraft, stated_unit
from cpid_drake.logs.guess.joints import find_joints
from cpid_drake.logs.guess.names import unit_of
from cpid_drake.logs.guess.raw_log import RawLog
from cpid_drake.logs.log import Log
from cpid_drake.logs.score import (
    Instants,
    centre_of_mass,
    compare_rates,
    instants_of,
)
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft

_SHOWN = 20  # unused columns that are named
_MOST = 0.5  # residual above which two quantities say nothing about each other
_GYRO = ("angular_velocity.unit", "angular_velocity.frame")

Residual = Callable[[Instants], float | None]


@dataclass(frozen=True, eq=False)
class GuessedMap:
    """A guess at the map of a log's columns.

    Attributes:
        column_map: the map.
        reasons: by key of the map, the reasons for its entries.
        measurements: the samples as read with the map, joints in the spacecraft's order.
        missing: what the map lacks or nothing in the log confirms, in words.

    """

    column_map: ColumnMap
    reasons: dict[str, list[str]]
    measurements: Log
    missing: tuple[str, ...] = ()


def guess_map(
    raw: RawLog, spacecraft: Spacecraft, base: str = "", frame_rate: float | None = None
) -> GuessedMap:
    """Guess the meaning of a log's columns.

    Args:
        raw: the log's columns.
        spacecraft: the known spacecraft, whose joints the log has.
        base: name of the base body, which tells the base's columns from those of other bodies.
        frame_rate: frames per second, if the log counts frames and does not say it [Hz].

    Raises:
        InputError: no column can be the time, or none the position of a joint; the message lists
            the columns.

    """
    guess, others = _guess(raw, spacecraft, base, frame_rate)
    if not others or _rates_agree(guess.measurements):
        return guess
    for unit in others:
        other, _ = _guess(raw, spacecraft, base, frame_rate, unit)
        if _rates_agree(other.measurements):
            return other
    units = " or ".join([guess.column_map.time.unit, *others])
    return replace(guess, missing=(f"the time may be in {units} (time.unit)", *guess.missing))


def _guess(
    raw: RawLog,
    spacecraft: Spacecraft,
    base: str,
    frame_rate: float | None,
    unit: TimeUnit | None = None,
) -> tuple[GuessedMap, tuple[TimeUnit, ...]]:
    """Return a guess, and other units of the time that are possible."""
    draft = MapDraft(raw, spacecraft, base)
    draft.map.time, draft.reasons["time"], others = guess_time(raw.values, frame_rate, unit)
    choose_columns(draft, find_joints(raw, spacecraft, {draft.map.time.column}))
    _choose_joint_units(draft)
    is_decided = _choose_by_gyro(draft)
    _choose_by_momentum(draft, is_decided=is_decided)
    _choose_velocity(draft)
    unused = read_columns(draft.map, Table(dict(raw.values)), "the log").ignored
    if unused:
        more = f" and {len(unused) - _SHOWN} more" if len(unused) > _SHOWN else ""
        draft.say("ignore_columns", f"not used: {', '.join(unused[:_SHOWN])}{more}")
    missing = draft.open
    if not draft.map.attitude.columns:
        missing = ["no columns are an attitude (attitude.columns)", *missing]
    return GuessedMap(draft.map, draft.reasons, draft.measurements(), tuple(missing)), others


def _rates_agree(log: Log) -> bool:
    given = instants_of(log)
    found = [] if given is None else compare_rates(given, log.joint_names)
    return any(each.residual < AGREES for each in found)


def _choose_joint_units(draft: MapDraft) -> None:
    """Choose the units of joint positions by names and limits, and of rates by positions."""
    given, craft = draft.map.joint_positions, draft.spacecraft
    names, low, high = craft.joint_names, craft.limits.lowest, craft.limits.highest
    values = {joint: draft.raw.values[column] for joint, column in given.columns.items()}
    slides = {names[b.joint] for b in craft.tree.bodies if b.joint >= 0 and b.prismatic}
    turning = [joint for joint in values if joint not in slides]
    for joint in slides & values.keys():
        k = names.index(joint)
        far = np.nanmax(np.abs(values[joint])) > 2 * max(abs(low[k]), abs(high[k]))
        length = stated_unit([given.columns[joint]]) or cast(Any, "mm" if far else "m")
        given.units[joint] = length
        if joint in draft.map.joint_rates.columns:
            draft.map.joint_rates.units[joint] = cast(Any, f"{length}/s")
    # A wheel's angle grows without limit, and has no effect on the momentum.
    arms = [joint for joint in turning if not craft.tree.is_rotor(names.index(joint))]
    stated = stated_unit(given.columns[joint] for joint in turning)
    rate_columns = draft.map.joint_rates.columns
    rate_stated = stated_unit(rate_columns[j] for j in turning if j in rate_columns)

    def is_within(scale: float) -> bool:
        places = [(names.index(joint), scale * values[joint]) for joint in arms]
        return all(
            low[k] - 0.1 <= np.nanmin(q) and np.nanmax(q) <= high[k] + 0.1 for k, q in places
        )

    draft.joint_unit_is_open = False
    if stated in ("deg", "rad", "mrad"):
        given.unit, why = stated, "the names say so"
    elif not is_within(1.0) and is_within(np.pi / 180):
        given.unit, why = "deg", "in rad they would exceed the joints' limits"
    else:
        draft.joint_unit_is_open = bool(arms)
        why = "assumed; they are within the joints' limits"
    if rate_columns:
        rates, keys = draft.map.joint_rates, [{"joint_rates.unit"}]
        if rate_stated in ("deg", "rad", "mrad", "rpm"):
            rates.unit = cast(Any, rate_stated if rate_stated == "rpm" else f"{rate_stated}/s")
            draft.say("joint_rates", f"in {rates.unit}: the names say so")
            keys = []
        if draft.joint_unit_is_open:
            keys.append({"joint_positions.unit"})
        error = draft.choose(draft.rates("q:"), *keys)
        rate_unit = draft.map.joint_rates.unit
        if error is not None:
            text = f"in {rate_unit}: differ from the positions' changes by {error:.2%}"
            draft.say("joint_rates", text)
            is_same = rate_unit == f"{draft.map.joint_positions.unit}/s"
            if error < AGREES and (rate_stated is not None or not is_same):
                draft.joint_unit_is_open, why = False, "they then change at their rates"
    size = max((np.nanmax(np.abs(values[joint])) for joint in arms), default=0.0)
    if not draft.joint_unit_is_open:
        unit = draft.map.joint_positions.unit
        draft.say("joint_positions", f"in {unit}, the largest is {size:.4g}: {why}")


def _choose_by_gyro(draft: MapDraft) -> bool:
    """Choose conventions of attitude and angular velocity by comparing them; say if possible."""
    rate = draft.map.angular_velocity
    if not (draft.map.attitude.columns and rate.columns):
        return False
    keys = _GYRO[1:] if unit_of(rate.columns[0]) else _GYRO
    before = draft.map
    error = draft.choose(draft.rates("attitude"), {*draft.attitude_keys(), *keys})
    if error is not None and error > AGREES:
        draft.map, first = before, error
        error = draft.choose(draft.rates("attitude"), {"angular_velocity.R_BS"})
        if error is not None and error > AGREES:
            draft.map, error = before, first
    if error is None:
        return False
    if error > _MOST:  # momentum cannot help: the gyro moves, and contradicts everything
        draft.open.append(
            "the attitude does not turn at the angular velocity in any convention (they differ "
            f"by {error:.0%} at least): order and direction of the attitude, or the axes of "
            "one of the sensors, are not determined"
        )
        return True
    said = f"this agrees best: changes of the attitude differ by {error:.2%} from the gyro"
    given, rate = draft.map.attitude, draft.map.angular_velocity
    draft.say("attitude", f"{given.order}, {given.direction}: {said}")
    draft.say("angular_velocity", f"in {rate.unit}, axes of the {rate.frame}: {said}")
    if not np.array_equal(rate.R_BS, np.eye(3)):
        draft.say("angular_velocity", "the gyro has other axes than the attitude (R_BS)")
    return True


def _choose_by_momentum(draft: MapDraft, *, is_decided: bool) -> None:
    """Choose what is open by the conservation of momentum: attitude, units, and the point.

    Args:
        is_decided: whether the gyro has decided about the attitude.

    """
    place, has_attitude = draft.map.position, bool(draft.map.attitude.columns)
    stated = bool(place.columns) and unit_of(place.columns[0]) is not None
    groups: list[Collection[str]] = []
    if has_attitude and not is_decided:
        groups.append(draft.attitude_keys())
    if draft.joint_unit_is_open:
        both = bool(draft.map.joint_rates.columns)
        groups.append(
            {"joint_positions.unit", "joint_rates.unit"} if both else {"joint_positions.unit"}
        )
    groups.append({"position.point_B"} if stated else {"position.unit", "position.point_B"})
    before = draft.map
    can_compare = has_attitude and bool(place.columns)
    error = draft.choose(draft.momentum, *groups) if can_compare else None
    after, given = draft.map, draft.map.attitude
    if draft.joint_unit_is_open:
        size = np.nanmax(
            [np.nanmax(np.abs(draft.raw.values[c])) for c in after.joint_positions.columns.values()]
        )
        unit = after.joint_positions.unit
        others = [e for e, m in draft.compared if m.joint_positions.unit != unit]
        if error is not None and error < _MOST and min(others, default=0) > CLEAR * error:
            why = "conservation of momentum says so"
        elif size > 4 * np.pi:
            after.joint_positions.unit, why = "deg", "in rad they would be more than two turns"
        else:
            why = "assumed; they are within the joints' limits"
            draft.open.append("the joint positions may be in rad or deg (joint_positions.unit)")
        unit = after.joint_positions.unit
        draft.say("joint_positions", f"in {unit}, the largest is {size:.4g}: {why}")
    if has_attitude and not is_decided:
        if error is None:
            draft.say("attitude", f"{given.order}, {given.direction}: assumed, nothing to compare")
        else:
            if error > _MOST:
                draft.map = before
                draft.open.append(
                    f"order and direction of the attitude are not determined: the best, "
                    f"{given.order} and {given.direction}, explains only "
                    f"{max(1 - error, 0):.0%} of the base's motion (attitude.order, "
                    "attitude.direction)"
                )
            draft.say(
                "attitude",
                f"{given.order}, {given.direction}: with this convention, conservation of "
                f"momentum explains all but {min(error, 1.0):.2%} of the base's motion",
            )
    _say_position(draft, stated)


def _say_position(draft: MapDraft, stated: bool) -> None:
    given = draft.map.position
    if not given.columns:
        return
    log = draft.instants()
    found = None if log is None or not log.is_free else centre_of_mass(log, draft.tree)
    if found is None or not found.is_possible:
        draft.say("position", f"in {given.unit}: {'by name' if stated else 'assumed'}")
    elif not stated:
        draft.say(
            "position",
            f"in {given.unit}: the target then has {found.mass_share:.3g} of the total mass, "
            "by the motion of the centre of mass",
        )


def _choose_velocity(draft: MapDraft) -> None:
    """Choose unit and frame of the velocity by the changes of the position."""
    given = draft.map.velocity
    if not given.columns:
        return
    if draft.map.angular_velocity.columns:
        given.point_B = draft.map.position.point_B
    keys = [{"velocity.frame"}, *([] if unit_of(given.columns[0]) else [{"velocity.unit"}])]
    error = draft.choose(draft.rates("position"), *keys)
    given = draft.map.velocity
    said = "assumed" if error is None else f"differs from the position's changes by {error:.2%}"
    draft.say("velocity", f"in {given.unit}, axes of the {given.frame}: {said}")
