"""Guesses the map of a log's columns from names, values and the spacecraft, with its reasons."""

from dataclasses import dataclass

from cpid_drake.sensing.column_guess.clock import guess_time
from cpid_drake.sensing.column_guess.columns import choose_columns
from cpid_drake.sensing.column_guess.conventions import (
    choose_attitude_conventions,
    choose_joint_units,
    choose_position_unit_and_point,
    choose_velocity_conventions,
)
from cpid_drake.sensing.column_guess.draft import MapDraft
from cpid_drake.sensing.column_guess.joints import find_joints
from cpid_drake.sensing.column_guess.raw_log import RawLog
from cpid_drake.sensing.files.column_map import ColumnMap
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class GuessedMap:
    """A guess at the map of a log's columns.

    Attributes:
        column_map: the map.
        reasons: by key of the map, the reasons for its entries.
        measurements: the first samples as read with the map, joints in the spacecraft's order.

    """

    column_map: ColumnMap
    reasons: dict[str, list[str]]
    measurements: Measurements


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
    draft = MapDraft(raw, spacecraft, base)
    draft.map.time, draft.reasons["time"] = guess_time(raw.values, frame_rate)
    choose_columns(draft, find_joints(raw, spacecraft, {draft.map.time.column}))
    choose_joint_units(draft)
    choose_attitude_conventions(draft)
    choose_position_unit_and_point(draft)
    choose_velocity_conventions(draft)
    return GuessedMap(draft.map, draft.reasons, draft.measurements())
