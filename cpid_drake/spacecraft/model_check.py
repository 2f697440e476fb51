"""Refuses what Drake would read as another model, or leave out of it, without a word.

Drake's readers read "1,5" as 1, "500mm" as 500 and a misspelt attribute as zero, and leave out what
they do not know. An element that Drake does not read is refused if it, or what is inside of it, may
be a mass, an inertia, or the pose of a joint or a frame; otherwise it is counted.
"""

import re
from collections import Counter
from collections.abc import Collection
from difflib import get_close_matches
from xml.etree.ElementTree import Element

import numpy as np

from cpid_drake.files.errors import InputError

MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_LIMITS = ("lower", "upper", "velocity", "effort")
# What contains numbers: elements (SDF), or attributes of any element (URDF, MJCF).
_NUMBERS = frozenset(
    (
        *("mass", *MOMENTS, *_LIMITS, "xyz", "rpy", "pose", "pos", "quat", "euler", "axisangle"),
        *("xyaxes", "zaxis", "axis", "fromto", "size", "density", "diaginertia", "fullinertia"),
    )
)

_CHILDREN = {
    (".urdf", "link"): frozenset(("inertial", "visual", "collision")),
    (".urdf", "joint"): frozenset(
        ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")
    ),
    (".urdf", "inertial"): frozenset(("origin", "mass", "inertia")),
    (".xml", "body"): frozenset(
        ("body", "joint", "freejoint", "inertial", "geom", "site", "camera", "light", "include")
    ),
}
_CHILDREN[".xml", "worldbody"] = _CHILDREN[".xml", "body"]
"""What is read of an element: Drake ignores other children of these without a word."""

_ASIDE = frozenset(("collision", "visual", "sensor", "contact", "gazebo"))
"""Words in the names of elements whose poses are not those of bodies, joints or frames."""

_ATTRIBUTES = {
    "origin": {"xyz", "rpy"},
    "mass": {"value"},
    "inertia": set(MOMENTS),
    "axis": {"xyz"},
}
"""What is read of elements of URDF: Drake ignores other attributes of these without a word."""

ONCE = frozenset(("inertial", "inertia", "mass", "origin", "pose", "axis"))
"""Elements of which Drake reads one, if a parent has several."""

_QUANTITIES = frozenset(("inertial", "origin", "mass", "inertia", "axis", "xyz", "rpy", *MOMENTS))
"""Names in URDF of what changes masses, or the poses of joints and frames."""

_POSES = frozenset(("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis"))

ALIKE = 0.8
"""Least similarity, by `difflib`, of a misspelt name and the name that is meant."""

_VECTOR = 3
"""Least count of numbers in one text that may be a pose or an inertia."""


def check_numbers(element: Element, ending: str, where: str) -> None:
    """Refuse a text in place of a number, of which Drake would read the beginning."""
    tag = element.tag
    texts = {"": element.text or ""} if ending == ".sdf" and tag in _NUMBERS else {}
    if ending != ".sdf":
        texts = {key: text for key, text in element.items() if key in _NUMBERS}
        texts |= {"value": element.get("value", "")} if tag == "mass" else {}
    for key, text in texts.items():
        for word in text.split():
            if not is_number(word, may_be_infinite=(key or tag) in _LIMITS):
                raise InputError(
                    f"{where}<{tag}{key and ' '}{key}>: {word:.40} is not a finite number; write "
                    "numbers with a decimal point and no unit"
                )


def check_meaning(element: Element, ending: str, where: str) -> list[str]:
    """Refuse what Drake would ignore or read as something else, without a word.

    Returns:
        The names of the children that it ignores and that change no mass, joint or frame.

    """
    tag, parts = element.tag, Counter(part.tag for part in element)
    unread = list[str]()
    children = _CHILDREN.get((ending, tag), parts)
    if tag == "joint" and "child" not in parts:  # of a transmission, or of ros2_control
        children = parts
    for part in element:
        name = part.tag
        if name in children or ":" in name:
            continue
        if ending == ".xml" or (reason := may_matter(part, children)):
            reason = "" if ending == ".xml" else f" ({reason})"
            raise InputError(
                f"{where}<{name}> in <{tag}> is not read; a mass, a joint or a pose may be lost"
                f"{reason}: write what it makes in another way in a copy of the file, or take it "
                f"out; what is read is {', '.join(sorted(children))}"
            )
        unread.append(name)
    for name in ONCE & set(parts) if ending != ".xml" else ():
        if parts[name] > 1:
            raise InputError(f"{where}<{tag}> has {parts[name]} <{name}>: only one is read")
    if ending == ".urdf":
        _check_urdf(element, where)
    elif ending == ".xml":
        _check_mjcf(element, parts, where)
    if tag == "fluid_added_mass":
        raise InputError(f"{where}<fluid_added_mass> is not read: there is no fluid in orbit")
    return unread


def _check_urdf(element: Element, where: str) -> None:
    tag = element.tag
    if unknown := set(element.attrib) - _ATTRIBUTES.get(tag, {*element.attrib}):
        raise InputError(f"{where}'{min(unknown)}' of <{tag}> is not read: correct its name")
    for inner in element if tag == "robot" else ():
        names = {each.tag for each in inner}
        is_alike = "inertial" in names or {"parent", "child"} <= names
        if is_alike and inner.tag not in ("link", "joint"):
            raise InputError(
                f"{where}<{inner.tag}> in <robot> is not read, and looks like a link or a "
                "joint: correct its name"
            )


def _check_mjcf(element: Element, parts: Counter[str], where: str) -> None:
    tag = element.tag
    if tag == "body" and parts["joint"] > 1 and _POSES & set(element.attrib):
        raise InputError(
            f"{where}body '{element.get('name', '')}' has {parts['joint']} joints and a pose, "
            "which Drake applies at the wrong one: put each joint in a body of its own"
        )
    if tag == "equality" and len(element):
        raise InputError(f"{where}an equality constraint closes a loop or couples joints")


def may_matter(element: Element, names: Collection[str]) -> str:
    """Return why an element that Drake does not read may matter to the motion; else nothing.

    It is named like a `known` one, or it, or an element or attribute inside, is named like a
    quantity of a body or a joint, and has a number; or it has as many numbers as a vector. A shape
    has no mass.
    """
    if _words(element.tag) & _ASIDE or element.find("geometry") is not None:
        return ""
    if (like := _like(element.tag, names)) and _has_number(element):
        return like
    for each in element.iter():
        texts = {each.tag: each.text or "", **{key: text for key, text in each.items()}}
        for name, text in texts.items():
            if sum(is_number(word, may_be_infinite=True) for word in text.split()) >= _VECTOR:
                return f"{name} has several numbers"
        if (like := _like(each.tag, _QUANTITIES)) and _has_number(each):
            return like
        for name, text in each.items():
            if (like := _like(name, _QUANTITIES)) and _is_numeric(text):
                return like
    return ""


def _like(name: str, names: Collection[str]) -> str:
    """Return which of some names a name, or a word of it, is like, in words; else nothing."""
    for word in (name, *_words(name)):
        if near := get_close_matches(word, sorted(names), n=1, cutoff=ALIKE):
            return f"{name} is like {near[0]}" if name != near[0] else name
    return ""


def _words(name: str) -> set[str]:
    """Return the words of a name such as self_collide or hardwareInterface."""
    return set(re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower().split("_"))


def _has_number(element: Element) -> bool:
    """Return whether an element has a number, in its text, its attributes, or inside of it."""
    texts = (text for each in element.iter() for text in (each.text or "", *each.attrib.values()))
    return any(map(_is_numeric, texts))


def _is_numeric(text: str) -> bool:
    return any(is_number(word, may_be_infinite=True) for word in text.split())


def is_number(word: str, *, may_be_infinite: bool = False) -> bool:
    """Return whether a word is a number as XML files write it."""
    try:
        value = float(word) if "_" not in word else np.nan
    except ValueError:
        return False
    return bool(np.isfinite(value) or (may_be_infinite and np.isinf(value)))
