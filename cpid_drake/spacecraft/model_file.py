"""A model's file: parsed by Drake, and checked for what Drake reads as something else.

Drake's readers read "1,5" as 1, "500mm" as 500 and a misspelt attribute as zero, replace an inertia
that no body has, and leave out what they do not support. They do not return from a file that
includes itself.
"""

import logging
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.parsing import LoadModelDirectives, PackageMap
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RotationalInertia

from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import resolve_model
from cpid_drake.spacecraft.parsing import make_parser, message_of, parse, summarize_ignored

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")

MOST_FILES = 1000
"""Most included files: models have tens, and files that include each other twice have billions."""

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_LIMITS = ("lower", "upper", "velocity", "effort")
# What contains numbers: elements (SDF), or attributes of any element (URDF, MJCF).
_NUMBERS = frozenset(
    (
        *("mass", *_MOMENTS, *_LIMITS, "xyz", "rpy", "pose", "pos", "quat", "euler", "axisangle"),
        *("xyaxes", "zaxis", "axis", "fromto", "size", "density", "diaginertia", "fullinertia"),
    )
)

_CHILDREN = {
    (".urdf", "link"): frozenset(
        (
            *("inertial", "visual", "collision", "contact", "sensor", "self_collision_checking"),
            *("collision_checking", "self_filter", "surface", "gravity", "kinematic", "gazebo"),
        )
    ),
    (".urdf", "joint"): frozenset(
        (
            *("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "calibration"),
            *("safety_controller", "hardwareInterface", "gazebo"),
        )
    ),
    (".urdf", "inertial"): frozenset(("origin", "mass", "inertia")),
    (".xml", "body"): frozenset(
        ("body", "joint", "freejoint", "inertial", "geom", "site", "camera", "light", "include")
    ),
}
_CHILDREN[".xml", "worldbody"] = _CHILDREN[".xml", "body"]
"""What is read of an element: Drake ignores other children of these without a word."""

_ATTRIBUTES = {
    "origin": {"xyz", "rpy"},
    "mass": {"value"},
    "inertia": set(_MOMENTS),
    "axis": {"xyz"},
}
"""What is read of elements of URDF: Drake ignores other attributes of these without a word."""

_ONCE = frozenset(("inertial", "inertia", "mass", "origin", "pose", "axis"))
"""Elements of which Drake reads one, if a parent has several."""

_POSES = frozenset(("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis"))


class ModelFile:
    """A model's file and the packages that its URIs refer to.

    Args:
        model: a path or a `package://NAME/...` URI.
        folders: folders, by name, of the packages that its URIs refer to.

    Attributes:
        model: the file as the user named it; error messages begin with it.
        path: the absolute path of the file.
        efforts, hollow: what Drake does not report of the file, see `check_model`.

    Raises:
        InputError: no such file, an unknown format, or content that Drake must not read (see
            `check_model`).

    """

    def __init__(self, model: str | Path, folders: Mapping[str, Path]) -> None:
        self.model, self.folders = str(model), folders
        self.path = resolve_model(model, folders)
        if not self.path.name.endswith(_MODEL_ENDINGS):
            raise self.error(f"not a model file: its name must end in {', '.join(_MODEL_ENDINGS)}")
        self.efforts, self.hollow = check_model(self.path, self.model, folders)
        self._is_parsed = False

    def error(self, problem: str) -> InputError:
        """Return an InputError whose message begins with this model."""
        return InputError(f"{self.model}: {problem}")

    def parse_into(self, plant: MultibodyPlant) -> None:
        """Add the model to a plant that is not finalized, and set the plant's gravity to zero.

        What Drake ignores is logged the first time; see `parsing.parse`, which also says what is
        refused.
        """
        ignored = parse(plant, self.path, self.model, self.folders)
        if ignored and not self._is_parsed:
            logging.getLogger(__name__).warning("%s: %s", self.model, summarize_ignored(ignored))
        self._is_parsed = True
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))

    def finalize(self, plant: MultibodyPlant) -> None:
        """Finalize a plant that holds the model.

        Raises:
            InputError: the model has constraints, a closed loop, or geometry that cannot be read.

        """
        if plant.num_constraints() > 0:
            raise self.error(
                f"{plant.num_constraints()} constraint(s) couple its joints (closed loop, mimic or "
                "equality); only trees of independent joints can be identified with: in a copy of "
                "the file, make joints fixed that hold still, such as a hand's fingers"
            )
        try:
            plant.Finalize()
        except (RuntimeError, SystemExit) as error:
            text = message_of(error, self.path)
            if "loop" in text:
                text = "its joints form a closed loop; only trees are supported"
            raise self.error(text) from error


def check_model(
    path: Path, where: str, folders: Mapping[str, Path]
) -> tuple[dict[str, float], set[str]]:
    """Check a model that Drake might never finish reading, or might read as another one.

    Returns:
        What Drake does not report: the effort limits in URDF files [N·m or N] by joint, of which
        Drake reads only those with a transmission; and the links of URDF and SDF files that have a
        geometry and no inertia, whose mass Drake takes for zero (URDF) or for 1 kg (SDF).

    Raises:
        InputError: the file, or one that it includes, is not XML or YAML, includes itself, or
            contains entities, text in place of a number, an inertia that no body has, or what Drake
            would ignore. The message names the file and the line.

    """
    efforts, hollow = dict[str, float](), set[str]()
    packages, count = make_parser(MultibodyPlant(0.0), folders).package_map(), 0

    def visit(file: Path, around: tuple[Path, ...]) -> None:
        nonlocal count
        count += 1
        place = where if not around else f"{where}: {file}"
        if file in around:
            raise InputError(f"{place}: the file includes itself")
        if count > MOST_FILES:
            raise InputError(f"{place}: more than {MOST_FILES} includes")
        ending, included = file.suffix.lower(), list[Path]()
        if file.is_dir():
            included = sorted(file.glob("*.sdf"))
        elif ending not in (".urdf", ".sdf", ".xml", ".yaml", ".yml") or not file.exists():
            return  # of a missing one, Drake's own error names the file that includes it
        elif not file.is_file():
            raise InputError(f"{place}: not a file")
        elif ending in (".yaml", ".yml"):
            for each in LoadModelDirectives(str(file)).directives:
                added = filter(None, (each.add_model, each.add_directives))
                included += [path for one in added for path in _behind(one.file, packages)]
        else:
            # MJCF paths start at the folder of the first MJCF file.
            main = next((each for each in around if each.suffix.lower() == ".xml"), file)
            elements = _read_xml(file, place)
            for element, line in elements.items():
                _check_numbers(element, ending, f"{place}: line {line}: ")
            for element, line in elements.items():
                _check_meaning(element, ending, f"{place}: line {line}: ")
                parts, name = {part.tag for part in element}, element.get("name", "")
                if element.tag == "link" and "inertial" not in parts:
                    hollow.update([name] if parts & {"visual", "collision"} else [])
                elif element.tag == "joint" and ending == ".urdf":
                    for limit in element.iter("limit"):
                        efforts[name] = float(limit.get("effort", 0))
                elif element.tag == "include" and ending == ".xml":
                    included.append(main.parent / element.get("file", ""))
                elif element.tag == "include":
                    included += _behind((element.findtext("uri") or "").strip(), packages)
        for other in included:
            visit(other.resolve(), (*around, file))

    try:
        visit(path.resolve(), ())
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{where}: {message_of(error, path):.500}") from error
    return efforts, hollow


def _behind(uri: str, packages: PackageMap) -> Iterator[Path]:
    """Yield the path of a URI's file; nothing if Drake will refuse the URI."""
    scheme, separator, rest = uri.partition("://")
    if separator and (scheme == "file" or packages.Contains(rest.partition("/")[0])):
        yield Path(rest) if scheme == "file" else Path(packages.ResolveUrl(f"package://{rest}"))


def _read_xml(file: Path, place: str) -> dict[ElementTree.Element, int]:
    """Return the elements of an XML file, with the line in which the first tag of each ends."""
    # Drake's reader accepts "--" and any bytes in comments, and a declaration that follows blanks
    # or names another encoding; they are left out here.
    data = re.sub(
        rb"\A(\xef\xbb\xbf)?\s*<\?xml.*?\?>|<!--.*?-->",
        lambda match: b"\n" * match[0].count(b"\n"),
        file.read_bytes(),
        flags=re.S,
    )
    if not data.strip():
        raise InputError(f"{place}: the file is empty")
    if template := re.search(rb"<xacro:|\$\{", data):
        number = data.count(b"\n", 0, template.start()) + 1
        raise InputError(f"{place}: line {number}: this file is a xacro template: run xacro first")
    if entity := re.search(rb"<!ENTITY\s+(\S+)", data):
        name = entity[1].decode(errors="replace")
        raise InputError(f"{place}: the entity &{name}; would not be read; write its text")
    lines = dict[ElementTree.Element, int]()
    parser: Any = ElementTree.XMLPullParser(["start"])
    try:
        for number, line in enumerate(data.splitlines(keepends=True), start=1):
            parser.feed(line)
            lines |= {element: number for _, element in parser.read_events()}
        parser.close()
    except ElementTree.ParseError as error:
        line_number, column = error.position
        text = str(error).partition(":")[0]
        raise InputError(
            f"{place}: line {line_number}, column {column + 1}: not XML: {text}"
        ) from error
    return lines


def _check_numbers(element: ElementTree.Element, ending: str, where: str) -> None:
    """Refuse a text in place of a number, of which Drake would read the beginning."""
    tag = element.tag
    texts = {"": element.text or ""} if ending == ".sdf" and tag in _NUMBERS else {}
    if ending != ".sdf":
        texts = {key: text for key, text in element.items() if key in _NUMBERS}
        texts |= {"value": element.get("value", "")} if tag == "mass" else {}
    for key, text in texts.items():
        for word in text.split():
            if not _is_number(word, may_be_infinite=(key or tag) in _LIMITS):
                raise InputError(
                    f"{where}<{tag}{key and ' '}{key}>: {word:.40} is not a finite number; write "
                    "numbers with a decimal point and no unit"
                )


def _check_meaning(element: ElementTree.Element, ending: str, where: str) -> None:
    """Refuse what Drake would ignore or read as something else, without a word."""
    tag, parts = element.tag, Counter(part.tag for part in element)
    known = _CHILDREN.get((ending, tag), parts)
    if tag == "joint" and "child" not in parts:  # of a transmission, or of ros2_control
        known = parts
    for part in parts:
        name = part.rpartition("}")[2]
        if part not in known and "}" not in part and not name.startswith("drake:"):
            raise InputError(
                f"{where}<{name}> in <{tag}> is not read; a mass, a joint or a pose may be lost: "
                "write what it makes in another way in a copy of the file, or take it out; what is "
                f"read is {', '.join(sorted(known))}"
            )
        if name in _ONCE and parts[part] > 1 and ending != ".xml":
            raise InputError(f"{where}<{tag}> has {parts[part]} <{name}>: only one is read")
    if ending == ".urdf" and (
        unknown := set(element.attrib) - _ATTRIBUTES.get(tag, {*element.attrib})
    ):
        raise InputError(f"{where}'{min(unknown)}' of <{tag}> is not read: correct its name")
    if ending == ".urdf" and tag == "robot":
        for inner in element:
            names = {each.tag for each in inner}
            is_alike = "inertial" in names or {"parent", "child"} <= names
            if is_alike and inner.tag not in ("link", "joint"):
                raise InputError(
                    f"{where}<{inner.tag}> in <robot> is not read, and looks like a link or a "
                    "joint: correct its name"
                )
    if tag in ("link", "body"):
        named = f"{where}{tag} '{element.get('name', '')}'"
        for inertial in element.findall("inertial"):
            _check_inertia(inertial, ending, f"{named}: ")
        if tag == "body" and parts["joint"] > 1 and _POSES & set(element.attrib):
            raise InputError(
                f"{named} has {parts['joint']} joints and a pose, which Drake applies at the wrong "
                "one: put each joint in a body of its own"
            )
    elif tag == "mimic" and ending == ".sdf":
        raise InputError(f"{where}a mimic joint couples joints; Drake would ignore it")
    elif tag == "fluid_added_mass":
        raise InputError(f"{where}<fluid_added_mass> is not read: there is no fluid in orbit")
    elif tag == "equality" and ending == ".xml" and len(element):
        raise InputError(f"{where}an equality constraint closes a loop or couples joints")


def _is_number(word: str, *, may_be_infinite: bool) -> bool:
    try:
        value = float(word) if "_" not in word else np.nan
    except ValueError:
        return False
    return bool(np.isfinite(value) or (may_be_infinite and np.isinf(value)))


def _check_inertia(inertial: ElementTree.Element, ending: str, where: str) -> None:
    """Refuse an inertia that Drake would replace by another one."""
    if ending == ".xml":
        words = inertial.get("fullinertia") or inertial.get("diaginertia") or "0 0 0"
        mass, moments = inertial.get("mass", "0"), [*words.split(), "0", "0", "0"][:6]
    elif ending == ".sdf":
        mass = inertial.findtext("mass") or "1"
        given = [inertial.findtext(f"inertia/{key}") for key in _MOMENTS]
        moments = [text or default for text, default in zip(given, "111000", strict=True)]
    else:
        parts = {part.tag: part.attrib for part in inertial}
        mass, tensor = parts.get("mass", {}).get("value", "0"), parts.get("inertia", {})
        missing = [key for key in _MOMENTS if key not in tensor and "inertia" in parts]
        if missing:
            raise InputError(f"{where}<inertia> has no attribute '{missing[0]}'")
        moments = [tensor.get(key, "0") for key in _MOMENTS]
    size, values = float(mass), [float(moment) for moment in moments]
    is_valid = RotationalInertia(*values).CouldBePhysicallyValid()
    if size < 0 or (size == 0 and any(values)) or not is_valid:
        remedy = (
            "principal moments are positive, and none exceeds the sum of the other two; of a dummy "
            "link, write the mass 0 and the inertia 0, or merge it with its neighbour"
        )
        if values[2] > 0 and not any(values[:2]):
            remedy = "on a table ixx and iyy do not matter: write the value of izz for both"
        raise InputError(
            f"{where}no rigid body has the mass {mass} and the inertia {values}: {remedy}"
        )
