"""Guesses which columns of a log belong to which joint of the spacecraft."""

from collections.abc import Collection
from dataclasses import dataclass

from cpid_drake.errors import InputError
from cpid_drake.logs.guess.names import Group, groups_by_number, letters_of, words_of
from cpid_drake.logs.guess.raw_log import RawLog
from cpid_drake.spacecraft.spacecraft import Spacecraft

_RATES = {"velocity", "velocities", "vel", "rate", "rates", "speed", "qd", "dq", "qdot", "dot"}
_RATES |= {"thetadot", "w", "omega"}
_POSITIONS = {"position", "positions", "pos", "angle", "angles", "q", "theta", "th", "joint"}
_POSITIONS |= {"joints", "encoder", "encoders", "enc", "j", "qj"}
_OTHERS = {"effort", "efforts", "torque", "torques", "tau", "current", "cmd", "command", "desired"}
_OTHERS |= {"ref", "target", "setpoint", "goal", "acc", "accel", "acceleration", "temperature"}
_OTHERS |= {"temp", "qdd", "ddq", "voltage", "error", "err"}


@dataclass(frozen=True, eq=False)
class JointColumnsFound:
    """The columns of joints.

    Attributes:
        positions, rates: columns by joint of the spacecraft.
        others: joints in the package's own columns that the spacecraft does not have.
        reasons: how the columns were found.
        all_columns: all columns that belong to joints, also those that are not used.

    """

    positions: dict[str, str]
    rates: dict[str, str]
    others: list[str]
    reasons: list[str]
    all_columns: set[str]


def find_joints(raw: RawLog, spacecraft: Spacecraft, taken: Collection[str]) -> JointColumnsFound:
    """Find the columns of the spacecraft's joints by their names, else by their numbers.

    Args:
        raw: the log.
        spacecraft: the spacecraft.
        taken: columns that have another meaning.

    Raises:
        InputError: a joint that is not a rotor has no column.

    """
    free = [name for name in raw.values if name not in taken]
    found = JointColumnsFound({}, {}, [], [], set())
    names = spacecraft.joint_names
    for column in free:
        for joint in sorted(names, key=len, reverse=True):
            rest = _rest(column, joint)
            if rest is None:
                continue
            found.all_columns.add(column)
            words = words_of(rest)
            if not words & _OTHERS:
                kind = found.rates if words & _RATES else found.positions
                kind.setdefault(joint, column)
            break
    needed = [name for k, name in enumerate(names) if not spacecraft.tree.is_rotor(k)]
    if any(joint in found.positions for joint in needed):
        found.reasons.append("the columns have the names of the spacecraft's joints")
    else:
        _by_number(raw, free, names, needed, found)
    house = [c for c in free if c.startswith("q:") and c[2:] not in names]
    found.others.extend(column[2:] for column in house)
    missing = [joint for joint in needed if joint not in found.positions]
    if missing:
        shown = ", ".join(free[:20])
        raise InputError(
            f"no column can be the position of joint '{missing[0]}': none has its name, and there "
            f"are no {len(needed)} numbered columns; the columns of numbers are {shown}"
        )
    incomplete = [joint for joint in found.positions if joint not in found.rates]
    if found.rates and incomplete:
        found.reasons.append(f"rates are not used: there is none of {', '.join(incomplete)}")
        found.rates.clear()
    return found


def _rest(column: str, joint: str) -> str | None:
    """Return a column's name without the joint's name; None if it does not contain it."""
    wanted = letters_of(joint.rsplit("::", 1)[-1])
    places = [k for k, letter in enumerate(column) if letter.isascii() and letter.isalnum()]
    start = letters_of(column).find(wanted)
    if start < 0 or not wanted:
        return None
    end = start + len(wanted)
    if end < len(places) and wanted[-1].isdigit() and column[places[end - 1] + 1].isdigit():
        return None  # joint1 is not joint10
    behind = column[places[end - 1] + 1 :]
    return f"{column[: places[start]]} {behind}"


def _by_number(
    raw: RawLog,
    free: list[str],
    names: tuple[str, ...],
    needed: list[str],
    found: JointColumnsFound,
) -> None:
    """Add the columns of numbered groups, by names in columns of text or in the joints' order."""
    groups = [
        group
        for group in groups_by_number(free)
        if not group.words & _OTHERS and not _is_quaternion(raw, group)
    ]
    for kind, words in ((found.rates, _RATES), (found.positions, _POSITIONS)):
        for group in groups:
            is_rate = bool(group.words & _RATES)
            if kind or not group.words & words or is_rate != (kind is found.rates):
                continue
            texts = _texts_of(raw, group, names)
            order = names if len(group.members) == len(names) else needed
            if texts:
                kind.update(texts)
                reason = "columns of text name the joints of the numbered columns"
            elif len(group.members) == len(order):
                kind.update(zip(order, group.members.values()))
                reason = f"{len(order)} numbered columns {group.stem}, in the model's joint order"
            else:
                continue
            found.all_columns.update(group.members.values())
            found.reasons.append(reason)
    unnamed = [g for g in groups if len(g.members) == len(needed) and not g.words & _RATES]
    if not found.positions and len(unnamed) == 1:
        columns = unnamed[0].members.values()
        found.positions.update(zip(needed, columns))
        found.all_columns.update(columns)
        found.reasons.append(
            f"{unnamed[0].stem} are the only numbered columns that are as many as the joints, in "
            "the model's joint order"
        )


def _is_quaternion(raw: RawLog, group: Group) -> bool:
    """Return whether four columns have the norm 1 in nearly all rows."""
    return len(group.members) == 4 and raw.has_unit_norm(group.members.values())


def _texts_of(raw: RawLog, group: Group, names: tuple[str, ...]) -> dict[str, str]:
    """Return columns of a group by the joints that columns of text with equal numbers name."""
    for texts in groups_by_number(raw.texts):
        if not texts.words & {"name", "names"}:
            continue
        by_text = {letters_of(raw.texts[c]): number for number, c in texts.members.items()}
        result = {}
        for joint in names:
            number = by_text.get(letters_of(joint.rsplit("::", 1)[-1]))
            if number is not None and number in group.members:
                result[joint] = group.members[number]
        if result:
            return result
    return {}
