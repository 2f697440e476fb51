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
from cpid_drake.logs.score import Instants, compare_momentum, compare_rates, instants_of
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import Table
from cpid_drake.spacecraft.spacecraft import Spacecraft

_ATTITUDE = {"attitude.order", "attitude.direction"}

Residual = Callable[[Instants], float | None]
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
    missing = _choose_time_unit(draft)
    if not draft.map.attitude.columns:
        missing.append("no columns are an attitude (attitude.columns)")
    missing += _choose_conventions(draft)
    unused = read_columns(draft.map, table, "the log").ignored
    if unused:
        more = f" and {len(unused) - 20} more" if len(unused) > 20 else ""
        draft.say("ignore_columns", f"not used: {', '.join(unused[:20])}{more}")
    return GuessedMap(draft.map, draft.reasons, _read(draft), tuple(missing))


# -- conventions ----------------------------------------------------------------------------------


def _choose_time_unit(draft: MapDraft) -> list[str]:
    """Choose the unit of time in which any positions and rates agree, or say that it is open."""
    before, units = draft.map, [draft.map.time.unit, *draft.time_units]
    for name in ("q:", "attitude", "position") if draft.time_units else ():
        found = _choose(draft, _rates(draft, name), {"time.unit"}, draft.free - {"time.unit"})
        if found and found[0][0] < AGREES:
            draft.map = with_entries(before, {"time.unit": draft.map.time.unit})
            draft.say("time", f"in {draft.map.time.unit}: positions and rates then agree")
            return []
        draft.map = before
    return [f"the time may be in {' or '.join(units)} (time.unit)"] if draft.time_units else []


def _choose_conventions(draft: MapDraft) -> list[str]:
    """Choose the conventions that names leave open, and return those that stay so."""
    free, missing, has_attitude = draft.free, [], bool(draft.map.attitude.columns)
    found = _choose(draft, _rates(draft, "q:"), {"joint_rates.unit"}, {"joint_positions.unit"})
    if found:
        rate_unit, is_named = draft.map.joint_rates.unit, "joint_rates.unit" not in free
        draft.say("joint_rates", f"in {rate_unit}: {_differ('the positions', found)}")
        if found[0][0] < AGREES and (
            is_named or rate_unit != f"{draft.map.joint_positions.unit}/s"
        ):
            free.discard("joint_positions.unit")
    before = draft.map
    gyro = {"angular_velocity.unit", "angular_velocity.frame"}
    found = _choose(draft, _rates(draft, "attitude"), _ATTITUDE | gyro)
    if found and found[0][0] > AGREES:
        draft.map, free_axes = before, {*free, "angular_velocity.R_BS"}
        turned = _choose(
            replace(draft, free=free_axes), _rates(draft, "attitude"), {"angular_velocity.R_BS"}
        )
        if turned and turned[0][0] < AGREES:
            draft.map, found = turned[0][1], turned
            draft.say("angular_velocity", "the gyro has other axes than the attitude (R_BS)")
    if found and found[0][0] > DIFFERS:  # momentum cannot help: the gyro contradicts everything
        missing.append(
            "the attitude does not turn at the angular velocity in any convention (they differ "
            f"by {found[0][0]:.0%} at least): order and direction of the attitude, or the axes of "
            "one of the sensors, are not determined"
        )
    elif found:
        given, rate = draft.map.attitude, draft.map.angular_velocity
        draft.say("attitude", f"{given.order}, {given.direction}: {_differ('the gyro', found)}")
        draft.say("angular_velocity", f"in {rate.unit}, axes of the {rate.frame}: they then agree")
    if found:
        free -= _ATTITUDE
    joints = {"joint_positions.unit", "joint_rates.unit"} & free
    joints = joints if "joint_positions.unit" in free else set()
    before, groups = draft.map, (_ATTITUDE, joints, {"position.unit", "position.point_B"})
    found = _choose(draft, _momentum(draft), *groups) if has_attitude else []
    if has_attitude and "attitude.direction" in free:
        given = draft.map.attitude
        explained = max(1 - found[0][0], 0.0) if found else 0.0
        draft.say(
            "attitude",
            f"{given.order}, {given.direction}: conservation of momentum then explains "
            f"{explained:.2%} of the base's motion",
        )
        if not found or found[0][0] > DIFFERS:
            missing.append(
                f"order and direction of the attitude are not determined: {given.order} and "
                f"{given.direction} explain only {explained:.0%} of the base's motion "
                "(attitude.order, attitude.direction)"
            )
            draft.map = before
    if joints:
        missing += _joint_unit(draft, found)
    if draft.map.position.columns and found:
        unit, explained = draft.map.position.unit, max(1 - found[0][0], 0.0)
        text = f"conservation of momentum then explains {explained:.2%} of the base's motion"
        draft.say("position", f"in {unit}: {text}")
    if draft.map.velocity.columns:
        if draft.map.angular_velocity.columns:
            draft.map.velocity.point_B = draft.map.position.point_B
        found = _choose(draft, _rates(draft, "position"), {"velocity.frame"}, {"velocity.unit"})
        speed, why = draft.map.velocity, _differ("the position's changes", found)
        draft.say("velocity", f"in {speed.unit}, axes of the {speed.frame}: {why}")
    return missing


def _joint_unit(draft: MapDraft, found: Sequence[Choice]) -> list[str]:
    """Decide on the unit of joint positions by momentum or their size; return it if it is open."""
    given = draft.map.joint_positions
    size = draft.largest(given.columns.values())
    others = [residual for residual, other in found if other.joint_positions.unit != given.unit]
    missing = []
    if found and found[0][0] < DIFFERS and min(others, default=0.0) > WORSE * found[0][0]:
        why = "conservation of momentum says so"
    elif size > 4 * np.pi:
        given.unit, why = "deg", "in rad they would be more than two turns"
    else:
        why = "assumed; they are within the joints' limits"
        missing.append("the joint positions may be in rad or deg (joint_positions.unit)")
    draft.say("joint_positions", f"in {given.unit}, the largest is {size:.4g}: {why}")
    return missing


def _choose(draft: MapDraft, residual: Residual, *groups: set[str]) -> list[Choice]:
    """Adopt a convention of small residual; return all that were compared, the adopted one first.

    Of conventions that are about as good, the first is chosen: what is usual comes first.

    Args:
        draft: the map, which is changed.
        residual: the comparison.
        groups: keys of the map; of those that are free, one alternative of each group, or none.

    """
    compared: list[Choice] = []
    keys = [group & draft.free for group in groups]
    orders: tuple[Order, ...] = (draft.map.attitude.order,)
    if orders == ("rotation_vector",) and any("attitude.order" in group for group in keys):
        orders = ("rotation_vector", "euler_xyz")  # no change of a quaternion gives the other
    for order in orders:
        column_map = replace(draft.map, attitude=replace(draft.map.attitude, order=order))
        given = instants_of(_read(replace(draft, map=column_map)))
        for other, log in () if given is None else _options(draft, column_map, given, keys):
            value = residual(log)
            if value is not None:
                compared.append((value, other))
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


def _rates(draft: MapDraft, name: str) -> Residual:
    """Return the comparison of positions and rates of a name, or of all joints for "q:"."""

    def residual(log: Instants) -> float | None:
        found = compare_rates(log, draft.spacecraft.joint_names)
        values = [c.residual for c in found if c.name.startswith(name)]
        return float(np.mean(values)) if values else None

    return residual


def _momentum(draft: MapDraft) -> Residual:
    def residual(log: Instants) -> float | None:
        found = compare_momentum(log, draft.spacecraft.tree.lumped)
        return found[0].residual if found else None

    return residual


def _differ(what: str, found: Sequence[Choice]) -> str:
    return f"differs from {what} by {found[0][0]:.2%}" if found else "assumed"


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
