"""A model's file, parsed by Drake."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import get_args

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.files.errors import InputError, listed
from cpid_drake.files.resources import resolve_model
from cpid_drake.spacecraft.floating_base import free_base
from cpid_drake.spacecraft.link_inertia import BodyFinding, Repair, change_of, copied, repair
from cpid_drake.spacecraft.model_content import read_content
from cpid_drake.spacecraft.model_copies import ModelCopies, leave_out_undefined
from cpid_drake.spacecraft.parsing import message_of, parse, summarize_ignored
from cpid_drake.spacecraft.plant_names import find_element

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")


class ModelFile:
    """A model's file and the packages that its URIs refer to.

    Args:
        model: a path or a `package://NAME/...` URI.
        folders: folders, by name, of the packages that its URIs refer to.
        repair_bodies: "nearest" to take the nearest body in the place of one that cannot be.

    Attributes:
        model: the file as the user named it; error messages begin with it.
        path: the absolute path of the file.
        content: what Drake does not report of its files.
        impossible: the bodies that cannot be.
        is_repaired: whether nearest bodies are in the place of some.
        notes: what is not read or changed, after it was parsed with a base.

    Raises:
        InputError: no such file, an unknown format, or content that Drake must not read (see
            `read_content`), such as an inertia that no body has.

    """

    def __init__(
        self,
        model: str | Path,
        folders: Mapping[str, Path],
        repair_bodies: Repair | None = None,
    ) -> None:
        self.model, self.folders = str(model), folders
        self.path = resolve_model(model, folders)
        if not self.path.name.endswith(_MODEL_ENDINGS):
            raise self.error(f"not a model file: its name must end in {', '.join(_MODEL_ENDINGS)}")
        self.content = read_content(self.path, self.model, folders)
        self._notes = [*self._check_bodies(repair_bodies)]
        self.is_repaired = bool(self._notes)
        self.notes = tuple[str, ...]()
        self._copies = ModelCopies(self.content, self.path)
        while any(file.ending == ".sdf" for file in self.content.files.values()):
            try:
                self._parse(MultibodyPlant(0.0))
                break
            except InputError as error:
                if not leave_out_undefined(self.content, str(error)):
                    break  # it is raised where the model is read
                self._copies = ModelCopies(self.content, self.path)

    def error(self, problem: str) -> InputError:
        """Return an InputError whose message begins with this model."""
        return InputError(f"{self.model}: {problem}")

    def _check_bodies(self, repair_bodies: Repair | None) -> Iterator[str]:
        """Refuse bodies that cannot be, or repair them and yield what that changes."""
        if repair_bodies not in (None, *get_args(Repair)):
            raise self.error(f"repair_bodies must be 'nearest', not {repair_bodies!r}")
        flawed = [
            (self.content.files[path], link, finding)
            for path, links in self.content.links.items()
            for link in links
            for finding in link.findings()
        ]
        self.impossible = tuple(finding for _, _, finding in flawed)
        if flawed and repair_bodies is None:
            texts = listed([f"{link.where}{finding}" for _, link, finding in flawed], most=2)
            raise InputError(
                f"{texts}; --repair-bodies nearest takes the nearest bodies that can be, and "
                "`cpid spacecraft` lists all"
            )
        for file, link, _ in flawed:
            text, head = repair(link, file.ending)
            if text:
                file.whole[link.element] = text
            else:
                file.heads[link.element] = head
            yield change_of(link)

    def copied(self) -> Iterator[BodyFinding]:
        """Yield the inertias that links of quite different masses have."""
        return copied(link for links in self.content.links.values() for link in links)

    def parse_into(self, plant: MultibodyPlant, base: str | None = None) -> None:
        """Add the model to a plant that is not finalized, and set the plant's gravity to zero.

        See `parsing.parse` for what is refused.

        Args:
            plant: the plant.
            base: the body that shall float freely, see `free_base`; `notes` then say what is not
                read or changed. None leaves the bodies as the model has them.

        """
        ignored = self._parse(plant) | self.content.unread
        if base is not None:
            body = find_element(plant, "Body", base, self.model)
            text = summarize_ignored(ignored) if ignored else ""
            notes = (*self._notes, text, free_base(plant, body, self.model))
            self.notes = tuple(filter(None, notes))
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))

    def _parse(self, plant: MultibodyPlant) -> Counter[str]:
        """Add the model to a plant; return what Drake ignores."""
        copies = self._copies
        return parse(plant, copies.path, self.model, self.folders, copies.original_names)

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
