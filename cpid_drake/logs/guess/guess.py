"""Guesses the map of a log's columns from names, values and the spacecraft, with its reasons."""

from dataclasses import dataclass, replace

from cpid_drake.logs.column_map import ColumnMap, TimeUnit
from cpid_drake.logs.consistency import AGREES, attitude_mismatch, rate_mismatch
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.guess.clock import guess_time
from cpid_drake.logs.guess.columns import choose_columns
from cpid_drake.logs.guess.conventions import (
    choose_attitude_conventions,
    choose_joint_units,
    choose_position_unit_and_point,
    choose_velocity_conventions,
)
from cpid_drake.logs.guess.draft import MapDraft
from cpid_drake.logs.guess.joints import find_joints
from cpid_drake.logs.guess.raw_log import RawLog
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft

_SHOWN = 20  # unused columns that are named


@dataclass(frozen=True, eq=False)
class GuessedMap:
    """A guess at the map of a log's columns.

    Attributes:
        column_map: the map.
        reasons: by key of the map, the reasons for its entries.
        measurements: the first samples as read with the map, joints in the spacecraft's order.
        missing: what the map lacks or nothing in the log confirms, in words.

    """

    column_map: ColumnMap
    reasons: dict[str, list[str]]
    measurements: Measurements
    missing: tuple[str, ...] = ()


def guess_map(
    raw: RawLog, spacecraft: Spacecraft, base: str = "", frame_rate: float | None = None
) -> GuessedMap:
    """Guess the meaning of a log's columns.

    Args:
        raw: the log's first rows.
        spacecraft: the known spacecraft, whose joints the log has.
        base: name of the base body, which tells the base's columns from those of other bodies.
        frame_rate: frames per second, if the log counts frames and does not say it [Hz].

    Raises:
        InputError: no column can be the time, or none the position of a joint; the message lists
            the columns.

    """
    guess, others = _guess(raw, spacecraft, base, frame_rate)
    if not others or _agree(guess.measurements):
        return guess
    for unit in others:
        other, _ = _guess(raw, spacecraft, base, frame_rate, unit)
        if _agree(other.measurements):
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
    choose_joint_units(draft)
    choose_attitude_conventions(draft)
    choose_position_unit_and_point(draft)
    choose_velocity_conventions(draft)
    unused = read_columns(draft.map, Table(dict(raw.values)), "the log").ignored
    if unused:
        more = f" and {len(unused) - _SHOWN} more" if len(unused) > _SHOWN else ""
        draft.say("ignore_columns", f"not used: {', '.join(unused[:_SHOWN])}{more}")
    missing = (
        [] if draft.map.attitude.columns else ["no columns are an attitude (attitude.columns)"]
    )
    guess = GuessedMap(draft.map, draft.reasons, draft.measurements(), (*missing, *draft.open))
    return guess, others


def _agree(measurements: Measurements) -> bool:
    """Return whether positions and rates agree, of the joints or of the attitude."""
    found = [
        rate_mismatch(measurements.encoders, measurements.joint_rates),
        attitude_mismatch(measurements.attitude, measurements.gyro),
    ]
    return any(mismatch is not None and mismatch < AGREES for mismatch in found)
