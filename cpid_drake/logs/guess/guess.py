"""Guesses the map of a log's columns: names first, then the conventions that explain it best.

Names say which columns are which quantity, and perhaps units. What they leave open is chosen among
`alternatives.alternatives` by the comparisons of `logs.score`: joint rates decide about the joints,
the gyro about the attitude, the conservation of momentum about the rest.
"""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import cast

import numpy as np

from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import dump_yaml
from cpid_drake.logs.alternatives import alternatives
from cpid_drake.logs.column_map import ColumnMap, Order, with_entries
from cpid_drake.logs.conventions import AGREES, DIFFERS, WORSE
from cpid_drake.logs.conversion import read_columns
from cpid_drake.logs.guess.columns import find_columns
from cpid_drake.logs.guess.draft import MapDraft
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.score import (
    MOMENTUM,
    Instants,
    compare_momentum,
    compare_rates,
    instants_of,
)
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft

_ATTITUDE = {"attitude.order", "attitude.direction"}
_JOINTS, _GYRO_AXES = {"joint_positions.unit", "joint_rates.unit"}, "angular_velocity.R_BS"

_STAGES = (
    ("q:", ({"joint_rates.unit"}, {"joint_positions.unit"})),
    ("attitude", (_ATTITUDE | {"angular_velocity.unit", "angular_velocity.frame"},)),
    (MOMENTUM, (_ATTITUDE, _JOINTS, {"position.unit", "position.point_B"})),
    ("position", ({"velocity.frame"}, {"velocity.unit"})),
)
"""Comparisons that decide about conventions, one after the other: the beginning of their names, and
groups of keys of which they may change one each."""

Choice = tuple[float, ColumnMap]


@dataclass(frozen=True, eq=False)
class GuessedMap:
    """A guess at the map of a log's columns.

    Attributes:
        column_map: the map.
        reasons: by key of the map, the reasons for its entries.
        log: the samples as read with the map, joints in the spacecraft's order.
        missing: what the map lacks or nothing in the log confirms, in words.

    """

    column_map: ColumnMap
    reasons: Mapping[str, Sequence[str]]
    log: Log
    missing: tuple[str, ...] = ()

    def text(self, heading: str = "") -> str:
        """Return the map as YAML text for `load_column_map`, its reasons as comments."""
        lines = _comment(heading)
        for entry in fields(self.column_map):
            value = _without_defaults(getattr(self.column_map, entry.name))
            said = [line for text in self.reasons.get(entry.name, ()) for line in _comment(text)]
            lines += ["", *said] if value or said else []
            lines += [dump_yaml({entry.name: value}).rstrip()] if value else []
        return "\n".join(lines).lstrip("\n") + "\n"


def guess_map(
    table: Table, spacecraft: Spacecraft, base: str = "", frame_rate: float | None = None
) -> GuessedMap:
    """Guess the meaning of a log's columns.

    Args:
        table: the log's columns.
        spacecraft: the known spacecraft, whose joints the log has.
        base: name of the base body, which tells the base's columns from those of other bodies.
        frame_rate: frames per second, if the log counts frames and does not say it [Hz].

    Raises:
        InputError: there are no rows; no column can be the time, or none the position of a joint;
            the message lists the columns.

    """
    texts = {name: next(iter(cells.values())) for name, cells in table.texts.items()}
    columns = {n: c for n, c in table.columns.items() if n not in texts and np.isfinite(c).any()}
    if not columns:
        raise InputError("the file has no rows of numbers")
    if "1" in columns:
        raise InputError(
            "the file does not name its columns: write a map that names them by their numbers, "
            "such as '1', and check it with `cpid log check --columns`"
        )
    draft = MapDraft(columns, texts, spacecraft, base)
    find_columns(draft, frame_rate)
    missing = _settle_time_unit(draft)
    if not draft.map.attitude.columns:
        missing.append("no columns are an attitude (attitude.columns)")
    missing += _settle_conventions(draft)
    unused = read_columns(draft.map, table, "the log").ignored
    if unused:
        more = f" and {len(unused) - 20} more" if len(unused) > 20 else ""
        draft.say("ignore_columns", f"not used: {', '.join(unused[:20])}{more}")
    return GuessedMap(draft.map, draft.reasons, _read(draft), tuple(missing))


# -- conventions ----------------------------------------------------------------------------------


def _settle_time_unit(draft: MapDraft) -> list[str]:
    """Choose the unit of time in which any positions and rates agree, or say that it is open."""
    before, units = draft.map, [draft.map.time.unit, *draft.time_units]
    for name in ("q:", "attitude", "position") if draft.time_units else ():
        found = _choose(draft, name, {"time.unit"}, draft.free - {"time.unit"})
        unit, draft.map = draft.map.time.unit, before
        if found and found[0][0] < AGREES:
            draft.map = with_entries(before, {"time.unit": unit})
            draft.say("time", f"in {unit}: positions and rates then agree")
            return []
    return [f"the time may be in {' or '.join(units)} (time.unit)"] if draft.time_units else []


def _settle_conventions(draft: MapDraft) -> list[str]:
    """Choose the conventions that names leave open, and return those that stay so.

    A key is settled if every other value of it leaves a clearly larger residual.
    """
    missing, has_attitude = [], bool(draft.map.attitude.columns)
    explained = "nothing moves"
    for name, groups in _STAGES:
        if name == "position" and draft.map.angular_velocity.columns:
            draft.map.velocity.point_B = draft.map.position.point_B
        if name == MOMENTUM and not has_attitude:
            continue
        before, found = draft.map, _choose(draft, name, *groups)
        if name == "attitude" and found and found[0][0] > AGREES:
            draft.map, draft.free = before, draft.free | {_GYRO_AXES}
            turned = _choose(draft, name, {_GYRO_AXES})
            found = turned if turned[0][0] < AGREES else found
        if not found:
            continue
        residual, adopted = found[0]
        if residual > DIFFERS:
            draft.map = before
        if name == "attitude" and residual > DIFFERS:  # the gyro contradicts everything
            missing.append(
                "the attitude does not turn at the angular velocity in any convention (they differ "
                f"by {residual:.0%} at least): order and direction of the attitude, or the axes of "
                "one of the sensors, are not determined"
            )
        if name == MOMENTUM:
            explained = f"momentum leaves {min(residual, 1.0):.0%} of the base's motion unexplained"
        what = "positions and rates"
        if name == MOMENTUM:
            what = "the motion of the base and what conservation of momentum allows"
        keys = {_GYRO_AXES}.union(*groups) & draft.free
        for key in sorted(keys) if residual <= DIFFERS else ():
            value = _entry(adopted, key)
            others = [r for r, each in found if _entry(each, key) != value]
            if min(others, default=np.inf) > WORSE * residual:
                draft.free.discard(key)
                section, _, entry = key.partition(".")
                draft.say(section, f"{entry} {value}: {what} then differ by {residual:.2%}")
        if name == "attitude":  # momentum cannot decide against the gyro
            draft.free -= _ATTITUDE
    at = draft.map.attitude
    if has_attitude and "attitude.direction" in draft.free:
        missing.append(
            f"order and direction of the attitude are not determined: {at.order}, {at.direction} "
            f"are assumed ({explained}) (attitude.order, attitude.direction)"
        )
    if "joint_positions.unit" in draft.free:
        missing += _joint_unit(draft)
    return missing


def _joint_unit(draft: MapDraft) -> list[str]:
    """Decide on the unit of joint positions by their size; return it if it is open."""
    given = draft.map.joint_positions
    size = draft.largest(given.columns.values())
    if size > 4 * np.pi:
        given.unit = "deg"
        draft.say("joint_positions", f"in deg: in rad, {size:.4g} would be more than two turns")
        return []
    draft.say("joint_positions", f"in {given.unit}: assumed")
    return ["the joint positions may be in rad or deg (joint_positions.unit)"]


def _entry(column_map: ColumnMap, key: str) -> str:
    section, _, name = key.partition(".")
    return str(getattr(getattr(column_map, section), name))


def _choose(draft: MapDraft, name: str, *groups: set[str]) -> list[Choice]:
    """Adopt a convention of small residual; return all that were compared, the adopted one first.

    Of conventions that are about as good, the first is chosen: what is usual comes first.

    Args:
        draft: the map, which is changed.
        name: beginning of the comparisons' names; the residual is the mean of theirs.
        groups: keys of the map; of those that are free, one alternative of each group, or none.

    """
    compared: list[Choice] = []
    keys = [group & draft.free for group in groups]
    tree, names = draft.spacecraft.tree.lumped, draft.spacecraft.joint_names
    orders: tuple[Order, ...] = (draft.map.attitude.order,)
    if orders == ("rotation_vector",) and any("attitude.order" in group for group in keys):
        orders = ("rotation_vector", "euler_xyz")  # no change of a quaternion gives the other
    for order in orders:
        column_map = replace(draft.map, attitude=replace(draft.map.attitude, order=order))
        given = instants_of(_read(replace(draft, map=column_map)))
        for other, log in () if given is None else _options(draft, column_map, given, keys):
            found = compare_momentum(log, tree) if name == MOMENTUM else compare_rates(log, names)
            values = [each.residual for each in found if each.name.startswith(name)]
            if values:
                compared.append((float(np.mean(values)), other))
    if compared:
        least = min(value for value, _ in compared)
        best = next(each for each in compared if each[0] <= WORSE * least + 1e-9)
        compared = [best, *(each for each in compared if each is not best)]
        draft.map = best[1]
    return compared


def _options(
    draft: MapDraft, column_map: ColumnMap, given: Instants, groups: Sequence[set[str]]
) -> Iterator[tuple[ColumnMap, Instants]]:
    """Yield maps with changed keys, of each group or of none, and what the log then says."""
    if not groups:
        yield column_map, given
        return
    yield from _options(draft, column_map, given, groups[1:])
    tree, names = draft.spacecraft.tree.lumped, draft.spacecraft.joint_names
    for each in alternatives(given, names, tree, column_map) if groups[0] else ():
        unit = each.entries.get("time.unit", "s")
        is_possible = unit in ("s", *draft.time_units) and set(each.entries) <= groups[0]
        if each.entries and is_possible:
            changed = with_entries(column_map, each.entries)
            yield from _options(draft, changed, each.log, groups[1:])


def _read(draft: MapDraft) -> Log:
    """Return the samples as read with the map, joints that are missing at zero."""
    log = screen(read_columns(draft.map, Table(dict(draft.columns)), "the log").log).log
    joints = draft.spacecraft.joint_names
    order = [log.joint_names.index(j) if j in log.joint_names else -1 for j in joints]
    changed = {}
    for name in ("encoders", "joint_rates"):
        samples = log[name]
        value = np.nan_to_num(np.column_stack([samples.value, np.zeros(len(samples))]))
        changed[name] = Samples(samples.time, value[:, order])
    return Log(joints, {**log.samples, **changed}, log.column_map)


# -- text -----------------------------------------------------------------------------------------


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent="# ", subsequent_indent="#   ")


def _without_defaults(section: object) -> object:
    """Return a section as a tree without its defaults."""
    if not is_dataclass(section) or isinstance(section, type):
        return section
    usual, changed = cast(Callable[[], object], type(section))(), {}
    for entry in fields(section):
        given = getattr(section, entry.name)
        if not np.array_equal(given, getattr(usual, entry.name)):
            is_count = isinstance(given, float) and given.is_integer() and abs(given) > 1e3
            plain = given.tolist() if isinstance(given, np.ndarray) else given
            changed[entry.name] = int(given) if is_count else plain  # ns since 1970 are whole
    return changed
