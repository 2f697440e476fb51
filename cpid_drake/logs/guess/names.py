"""Guesses at the meaning of columns from their names alone."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from cpid_drake.logs.column_map import UNIT_OF

_SUFFIXES = UNIT_OF.keys() - {"m", "s", "in", "N"}  # units that end a name without brackets
WORDS = {
    meaning: frozenset(words.split())
    for meaning, words in {
        "nanoseconds": "nanosec nsec nsecs nanosecs nanoseconds",
        "other clock": "sub recv receive log record",
        "attitude": "attitude att orientation quat quaternion q rotation rot r qn qbn sigma mrp",
        "rotation": "r rot rotation rotvec euler rpy sigma mrp",
        "mrp": "sigma mrp",
        "heading": "yaw heading theta psi",
        "angular_velocity": "angular gyro gyr gyroscope imu omega w bw wb wn wbn wz bwz rates rate "
        "angvel",
        "velocity": "velocity vel v linear speed",
        "position": "position pos p t translation trans location xyz mocap",
        "base": "base bus body chaser servicer spacecraft",
        "thrust": "thrust thruster thrusters rcs propulsion",
        "force": "force forces f",
        "torque": "torque torques moment tau t m",
        "command": "command cmd commanded desired ref reference setpoint target goal",
        "other vector": "acceleration accel acc covariance cov force torque magnetic mag",
        "joint": "position positions pos angle angles q theta th joint joints encoder encoders enc "
        "j qj",
        "joint rate": "velocity velocities vel rate rates speed qd dq qdot dot thetadot w omega",
        "of the base": "euler rpy sigma mrp rotvec angular gyro gyr gyroscope imu bn",
        "other of joint": "effort efforts torque torques tau current temperature temp qdd ddq "
        "voltage error err acc accel acceleration",
    }.items()
}
"""Words in names of columns, by what they mean; a command is what is wanted, not measured."""

NO_VECTOR = WORDS["other vector"] | WORDS["command"] | WORDS["thrust"]
"""Words of what is neither the attitude nor a motion of the base."""

_BRACKET = re.compile(r"\s*[\[(]\s*([^\[\]():,\d]*?)\s*(?:/\s*s(?:ec)?)?\s*[\])]\s*$")
_FRAME_RATE = re.compile(r"[\[(]\s*(\d+(?:\.\d+)?)\s*Hz\s*[\])]")
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°|µ")


@dataclass(frozen=True)
class Group:
    """Columns that differ only in an axis, an angle or a number.

    Attributes:
        stem: their common name, with * for the part that differs.
        members: columns by axis ("w", "x", "y", "z"), angle or number, in the file's order.

    """

    stem: str
    members: Mapping[str, str]

    @property
    def words(self) -> set[str]:
        """The words of the stem, in lower case."""
        return words_of(self.stem)


def words_of(name: str) -> set[str]:
    """Return the words of a name, in lower case: "field.jointPos_x" has field, joint, pos, x."""
    return {word.lower() for word in _WORDS.findall(name)}


def letters_of(name: str) -> str:
    """Return letters and digits of a name in lower case, to compare names."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _without_unit(name: str) -> str:
    """Return a name without its unit, in brackets or behind a separator."""
    bare = _FRAME_RATE.sub("", _BRACKET.sub("", name)).strip()
    start, separator, last = bare.rpartition("_")
    return start if separator and start and last.lower() in _SUFFIXES else bare


def unit_of(*names: str) -> str | None:
    """Return the unit that names state, without "per second", such as "mm" for "TX [mm]".

    None if they state none, or several.
    """
    units = set()
    for name in names:
        match = _BRACKET.search(name)
        last = re.split(r"[^a-zA-Z°µ]+", name.strip())[-1].lower()
        if match and match.group(1).lower() in UNIT_OF:
            units.add(UNIT_OF[match.group(1).lower()])
        elif last in _SUFFIXES:
            units.add(UNIT_OF[last])
    return units.pop() if len(units) == 1 else None


def frame_rate_of(name: str) -> float | None:
    """Return the frames per second that a name states, such as 100 for "Frame [100 Hz]"."""
    match = _FRAME_RATE.search(name)
    return float(match.group(1)) if match else None


def groups_by_axis(names: Iterable[str], needed: Collection[str] = "xyz") -> list[Group]:
    """Return the groups of columns that differ in x, y, z and perhaps w, at the end of a word.

    Those that have all needed axes.
    """
    key = "(?P<key>[wxyzWXYZ])"
    patterns = f"^(?P<a>.*?){key}(?P<b>)$", f"^(?P<a>.*){key}(?P<b>[_. ].*)$"
    return _groups(names, patterns, {*needed})


def groups_by_angle(names: Iterable[str]) -> list[Group]:
    """Return the groups of columns that differ in roll, pitch, yaw, or in phi, theta, psi."""
    names, groups = [*names], list[Group]()
    for keys in (("roll", "pitch", "yaw"), ("phi", "theta", "psi")):
        pattern = rf"^(?P<a>.*?)(?P<key>(?i:{'|'.join(keys)}))(?P<b>.*)$"
        groups += _groups(names, (pattern,), {*keys})
    return groups


def groups_by_number(names: Iterable[str]) -> list[Group]:
    """Return the groups of columns that differ in their last number, in the numbers' order."""
    groups = _groups(names, (r"^(?P<a>.*?)(?P<key>\d+)(?P<b>\D*)$",), set())
    return [
        Group(group.stem, dict(sorted(group.members.items(), key=lambda item: int(item[0]))))
        for group in groups
        if len(group.members) > 1
    ]


def _groups(names: Iterable[str], patterns: tuple[str, ...], needed: set[str]) -> list[Group]:
    """Return groups by the first pattern that matches a name; `needed` are keys that all have."""
    by_key: dict[str, dict[str, str]] = {}
    for name in names:
        for pattern in patterns:
            if match := re.match(pattern, _without_unit(name)):
                stem = f"{match['a']}*{match['b']}"
                by_key.setdefault(stem, {}).setdefault(match["key"].lower(), name)
    return [Group(stem, members) for stem, members in by_key.items() if needed <= members.keys()]
