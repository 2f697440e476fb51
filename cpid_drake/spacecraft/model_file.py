"""A model's file, parsed by Drake."""

import logging
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.files.errors import InputError, listed
from cpid_drake.files.resources import resolve_model
from cpid_drake.spacecraft.floating_base import free_base
from cpid_drake.spacecraft.model_content import read_content
from cpid_drake.spacecraft.model_copies import ModelCopies
from cpid_drake.spacecraft.parsing import message_of, parse, summarize_ignored
from cpid_drake.spacecraft.plant_names import find_element

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")


class ModelFile:
    """A model's file and the packages that its URIs refer to.

    Args:
        model: a path or a `package://NAME/...` URI.
        folders: folders, by name, of the packages that its URIs refer to.

    Attributes:
        model: the file as the user named it; error messages begin with it.
        path: the absolute path of the file.
        content: what Drake does not report of its files.

    Raises:
        InputError: no such file, an unknown format, or content that Drake must not read (see
            `read_content`), such as an inertia that no body has.

    """

    def __init__(self, model: str | Path, folders: Mapping[str, Path]) -> None:
        self.model, self.folders = str(model), folders
        self.path = resolve_model(model, folders)
        if not self.path.name.endswith(_MODEL_ENDINGS):
            raise self.error(f"not a model file: its name must end in {', '.join(_MODEL_ENDINGS)}")
        self.content = read_content(self.path, self.model, folders)
        self._copies, self._is_parsed = ModelCopies(self.content, self.path), False
        links = chain.from_iterable(self.content.links.values())
        impossible = [f"{link.where}{finding}" for link in links for finding in link.findings()]
        if impossible:
            raise InputError(listed(impossible))

    def error(self, problem: str) -> InputError:
        """Return an InputError whose message begins with this model."""
        return InputError(f"{self.model}: {problem}")

    def parse_into(self, plant: MultibodyPlant, base: str | None = None) -> None:
        """Add the model to a plant that is not finalized, and set the plant's gravity to zero.

        What is not read or changed is logged the first time; see `parsing.parse`, which also says
        what is refused.

        Args:
            plant: the plant.
            base: the body that shall float freely; see `free_base`.

        """
        copies = self._copies
        ignored = parse(plant, copies.path, self.model, self.folders, copies.original_names)
        ignored |= self.content.unread
        if ignored and not self._is_parsed:
            logging.getLogger(__name__).warning("%s: %s", self.model, summarize_ignored(ignored))
        if base is not None:
            body = find_element(plant, "Body", base, self.model)
            note = free_base(plant, body, self.model)
            if note and not self._is_parsed:
                logging.getLogger(__name__).warning("%s: %s", self.model, note)
        self._is_parsed = True
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))

    def finalize(self, plant: MultibodyPlant) -> None:
        """Finalize a plant that holds the model.

        Raises:
            InputError: the model has constraints, a closed loop, or geometry that cannot be read.

        """
        if plant.num_constraints() > 0:
            raise self.error(
                f"{plant.num_constraints()} constraint(s) couple its joints (closed loop or "
                "equality); only trees of joints can be identified with: in a copy of the file, "
                "make joints fixed that hold still"
            )
        try:
            plant.Finalize()
        except (RuntimeError, SystemExit) as error:
            text = message_of(self._copies.original_names(str(error)), self.path)
            if "loop" in text:
                text = "its joints form a closed loop; only trees are supported"
            raise self.error(text) from error
