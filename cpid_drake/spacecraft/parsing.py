"""Parsing of a model file by Drake."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.errors import InputError
from cpid_drake.resources import resolve_model
from cpid_drake.spacecraft.model_checks import check_model, message_of, package_map

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")


class ModelFile:
    """A model's file and the packages that its URIs refer to.

    Args:
        model: a path or a `package://NAME/...` URI.
        folders: the packages' folders by name.

    Attributes:
        model: the file as the user named it; error messages begin with it.
        path: the absolute path of the file.
        folders: the packages' folders as the user named them.
        efforts, hollow: what Drake does not tell of the file, see `check_model`.

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

    def error(self, problem: str) -> InputError:
        """Return an InputError whose message begins with this model."""
        return InputError(f"{self.model}: {problem}")

    def parse_into(self, plant: MultibodyPlant) -> None:
        """Add the model to a plant that is not finalized, and set the plant's gravity to zero.

        Raises:
            InputError: Drake cannot read the file.

        """
        try:
            make_parser(plant, self.folders).AddModels(self.path)
        except (RuntimeError, ValueError, SystemExit) as error:
            raise self.error(message_of(error, self.path)) from error
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


def make_parser(plant: MultibodyPlant, folders: Mapping[str, Path]) -> Parser:
    """Return a parser that knows these packages and does not download any."""
    parser = Parser(plant)
    packages = parser.package_map()
    if packages.Contains("drake_models"):
        packages.Remove("drake_models")
    packages.AddMap(package_map(folders))
    return parser
