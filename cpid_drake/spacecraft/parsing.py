"""Parsing of a model file by Drake; a fault that Drake would repair silently is an error here."""

import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.errors import InputError
from cpid_drake.resources import resolve_model
from cpid_drake.spacecraft.model_checks import check_model

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")

# Texts of warnings from Drake's parser that mean that it has read a spacecraft that differs from
# the file, and the explanations for the user.
_SILENT_REPAIRS = {
    "While parsing inertia matrix": "a body's inertia is not physically consistent",
    "While re-expressing as central inertia": "a body's mass or inertia is not physically "
    "consistent",
    "has invalid inertia": "a body's inertia is not physically consistent",
    "found as a child of 'equality'": "an equality constraint closes a loop or couples joints",
    "The attribute 'settotalmass'": "masses other than the bodies' own",
    "The attribute 'boundmass'": "masses other than the bodies' own",
    "The attribute 'boundinertia'": "inertias other than the bodies' own",
    "The attribute 'balanceinertia'": "inertias other than the bodies' own",
    "The attribute 'inertiagrouprange'": "inertias other than the bodies' own",
}


class ModelFile:
    """A model's file and the packages that its URIs refer to.

    Args:
        model: a path or a `package://NAME/...` URI.
        folders: the packages' folders by name.

    Attributes:
        model: the file as the user named it; error messages begin with it.
        path: the absolute path of the file.
        folders: the packages' folders as the user named them.
        contents: what Drake does not tell of the file.

    Raises:
        InputError: no such file, an unknown format, or content that Drake must not read (see
            `check_model`).

    """

    def __init__(self, model: str | Path, folders: Mapping[str, Path]) -> None:
        self.model, self.folders = str(model), folders
        self.path = resolve_model(model, folders)
        if not self.path.name.endswith(_MODEL_ENDINGS):
            raise self.error(f"not a model file: its name must end in {', '.join(_MODEL_ENDINGS)}")
        self.contents = check_model(self.path, self.model, folders)

    def error(self, problem: str) -> InputError:
        """Return an InputError whose message begins with this model."""
        return InputError(f"{self.model}: {problem}")

    def parse_into(self, plant: MultibodyPlant) -> list[str]:
        """Add the model to a plant that is not finalized, and set the plant's gravity to zero.

        Returns:
            The parser's warnings, one line each.

        Raises:
            InputError: Drake cannot read the file, or would misread it.

        """
        if self.path.suffix == ".sdf" and b"<mimic" in self.path.read_bytes():
            raise self.error("a mimic joint couples joints; Drake's SDF reader would ignore it")
        parser = make_parser(plant, self.folders)
        try:
            with _parser_warnings() as warnings:
                parser.AddModels(self.path)
        except (RuntimeError, ValueError, SystemExit) as error:
            raise self.error(self._without_own_name(error)) from error
        for warning in warnings:
            for phrase, problem in _SILENT_REPAIRS.items():
                if phrase in warning:
                    raise self.error(f"{problem}: {self._without_own_name(warning)}")
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        return warnings

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
            if "loop" in str(error):
                raise self.error(
                    "its joints form a closed loop; only trees are supported"
                ) from None
            raise self.error(self._without_own_name(error)) from error

    def _without_own_name(self, message: object) -> str:
        """Return a message of Drake's without the file's path."""
        path = re.escape(str(self.path))
        text = re.sub(rf"/?{path}:(\d+): (error|warning): ", r"line \1: ", _one_line(message))
        text = re.sub(rf"{path}:(\d+):(\d+): ", r"line \1, column \2: ", text)
        text = re.sub(r" (for <root> )?while (accepting|visiting) .*", "", text)
        return re.sub(rf"^(error|warning): |{path}: |Failure at \S+ in \w+\(\): ", "", text)


def make_parser(plant: MultibodyPlant, folders: Mapping[str, Path]) -> Parser:
    """Return a parser that knows these packages and does not download any."""
    parser = Parser(plant)
    packages = parser.package_map()
    if packages.Contains("drake_models"):
        packages.Remove("drake_models")
    for name, folder in folders.items():
        packages.Add(name, folder)
    return parser


@contextmanager
def _parser_warnings() -> Iterator[list[str]]:
    """Collect the warnings of Drake's parser, which writes them to its logger only."""
    messages: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(_one_line(record.getMessage()))

    # The caller's log settings must not hide a warning here; they are restored afterwards.
    logger, manager = logging.getLogger("drake"), logging.root.manager
    names = ("level", "disabled", "handlers", "filters", "propagate")
    saved, switch = {name: getattr(logger, name) for name in names}, manager.disable
    logger.setLevel(logging.WARNING)
    logger.disabled, manager.disable = False, 0
    logger.handlers, logger.filters, logger.propagate = [Collector()], [], False
    try:
        yield messages
    finally:
        for name, value in saved.items():
            setattr(logger, name, value)
        logger.setLevel(saved["level"])  # unlike the attribute, this clears the logger's cache
        manager.disable = switch


def _one_line(message: object) -> str:
    return " ".join(str(message).split())
