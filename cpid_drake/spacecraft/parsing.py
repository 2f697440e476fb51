"""Drake's model parser, and what it says of a file that it does not read whole.

Drake warns of elements that it ignores, and of inertias that it replaces. What can carry a mass, a
joint or a frame is an error here; the rest, such as friction, is said once in one line.
"""

import logging
import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.files.errors import InputError

_IGNORED = re.compile(
    r"The (?:tag|attribute) '(?P<name>[^']+)' found (?:as a child of|in a) '(?P<parent>[^']+)'"
    r"(?: tag)?(?: is currently unsupported and will be ignored)?|"
    r"Ignoring unsupported SDFormat element in (?P<of>\w+): (?P<element>\w+)"
)

_WITHOUT_MASS = frozenset(  # parents
    (
        *("transmission", "actuator", "sensor", "visual", "option", "statistic", "size", "contact"),
        *("custom", "keyframe", "tendon", "material", "texture", "light", "camera", "site"),
        *("collision", "dynamics", "safety_controller", "calibration", "surface", "general"),
        *("position", "velocity", "motor", "pair", "exclude", "rgba"),
    )
)

_HARMLESS = frozenset(  # elements and attributes
    (
        *_WITHOUT_MASS,
        *("friction", "frictionloss", "stiffness", "springref", "springdamper", "damping", "range"),
        *(
            "solreflimit",
            "solimplimit",
            "solreffriction",
            "solimpfriction",
            "margin",
            "gap",
            "user",
        ),
        *("group", "condim", "contype", "conaffinity", "priority", "solmix", "solref", "solimp"),
        *("fluidshape", "fluidcoef", "fluidellipsoid", "gravcomp", "mocap", "actuatorfrcrange"),
        *("actuatorfrclimited", "actuatorgravcomp", "type", "skin", "hfield", "texturedir"),
        *("discardvisual", "fusestatic", "usethread", "alignfree", "gravity", "self_collide"),
        *("enable_wind", "kinematic", "velocity_decay", "allow_auto_disable", "plugin", "physics"),
        *("audio_sink", "audio_source", "battery", "projector", "particle_emitter", "provide"),
        *("self_collision_checking", "drawing_enabled", "light", "extension", "noslip_iterations"),
    )
)

_FREE = re.compile(
    r"friction|condim|contype|camera element|texture element|transmission|mechanicalReduction|"
    r"motor '.*' does not use|collision filter|hydroelastic|dissipation|effort|"
    r"mimic(?= element for single-dof joints.* \(with 0 dofs\) is attempting)"  # it is fixed
)


def make_parser(plant: MultibodyPlant, folders: Mapping[str, Path]) -> Parser:
    """Return a parser that has these packages and does not download any."""
    parser = Parser(plant)
    parser.package_map().Remove("drake_models")
    for name, folder in folders.items():
        parser.package_map().Add(name, folder)
    return parser


def parse(
    plant: MultibodyPlant,
    path: Path,
    where: str,
    folders: Mapping[str, Path],
    named: Callable[[str], str] = str,
) -> Counter[str]:
    """Add the models of a file to a plant that is not finalized; messages begin with `where`.

    Args:
        plant: the plant.
        path: the file.
        where: the file's name in messages.
        folders: see `ModelFile`.
        named: returns a message of Drake's with the files' names that the user knows.

    Returns:
        How often Drake ignored an element that has no mass, joint or frame, by its name.

    Raises:
        InputError: Drake cannot read the file, or ignores or replaces what may have one.

    """
    original = Path(named(str(path)))
    messages, logger = _Said(), logging.getLogger("drake")
    before = logger.handlers, logger.propagate, logger.level
    logger.handlers, logger.propagate = [messages], False
    logger.setLevel(logging.WARNING)
    try:
        make_parser(plant, folders).AddModels(path)
    except (RuntimeError, ValueError, SystemExit) as error:
        raise InputError(f"{where}: {message_of(named(str(error)), original)}") from error
    finally:
        logger.handlers, logger.propagate = before[:2]
        logger.setLevel(before[2])
    ignored = Counter[str]()
    for message in messages.messages:
        if name := _harmless(message):
            ignored[name] += 1
            continue
        text = _IGNORED.sub(r"'\g<name>\g<element>' of <\g<parent>\g<of>> is not read", message)
        text = message_of(named(text), original).rstrip(".")
        raise InputError(
            f"{where}: {text:.300}; a mass, a joint or a frame may be "
            "lost: write it in another way in a copy of the file, or take it out"
        )
    return ignored


def summarize_ignored(ignored: Mapping[str, int]) -> str:
    """Return what Drake ignored in one line."""
    named = ", ".join(f"{name} ({count})" for name, count in sorted(ignored.items()))
    return f"not read, and without effect on masses, joints and frames: {named}"


def message_of(error: BaseException | str, path: Path) -> str:
    """Return the message of an error of Drake's in one line, without the file's path."""
    name, text = re.escape(str(path)), " ".join(str(error).split())
    text = re.sub(rf"/?{name}:(\d+): (error|warning): ", r"line \1: ", text)
    text = re.sub(rf"{name}:(\d+):(\d+): ", r"line \1, column \2: ", text)
    text = re.sub(r" (for <root> )?while (accepting|visiting) .*", "", text)
    return re.sub(rf"^(error|warning): |{name}: |Failure at \S+ in \w+\(\): ", "", text)


class _Said(logging.Handler):
    """The messages of a logger."""

    def __init__(self) -> None:
        super().__init__()
        self.messages = list[str]()

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def _harmless(message: str) -> str:
    """Return the name of what Drake ignored if it has no mass, joint or frame; else nothing."""
    if match := _IGNORED.search(message):
        name, parent = match["name"] or match["element"], match["parent"] or match["of"]
        is_harmless = parent in _WITHOUT_MASS or (name in _HARMLESS and parent != "equality")
        return name if is_harmless else ""
    match = _FREE.search(message)
    return match[0].partition(" ")[0] if match else ""
