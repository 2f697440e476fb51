"""Bodies, frames and joints of a plant by name, bare or scoped as `instance::name`."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, ModelInstanceIndex, RigidBody

from cpid_drake.spacecraft.parsing import ModelFile

_Element = TypeVar("_Element", bound=Any)  # RigidBody or Frame


def find_body(model: ModelFile, plant: MultibodyPlant, name: str) -> RigidBody:
    """Return the body of this name, bare or scoped.

    Raises:
        InputError: there is none, or more than one.

    """
    bodies = _elements(plant, plant.GetBodyIndices, plant.get_body)
    return _find(model, plant, "body", bodies, name)


def find_frame(model: ModelFile, plant: MultibodyPlant, name: str) -> Frame:
    """Return the frame of this name, bare or scoped; a body's name means its body frame.

    Raises:
        InputError: there is none, or more than one.

    """
    frames = _elements(plant, plant.GetFrameIndices, plant.get_frame)
    return _find(model, plant, "frame", [frame for frame in frames if frame.name()], name)


def unique_names(
    plant: MultibodyPlant, elements: Sequence[Joint] | Sequence[RigidBody]
) -> tuple[str, ...]:
    """Return the bare names of joints or bodies where they are unique, else the scoped names."""
    count = Counter(element.name() for element in elements)
    instances = [plant.GetModelInstanceName(element.model_instance()) for element in elements]
    return tuple(
        element.name() if count[element.name()] == 1 else f"{instance}::{element.name()}"
        for element, instance in zip(elements, instances, strict=True)
    )


def listed(names: Iterable[str]) -> str:
    """Return names in alphabetical order for an error message, at most 40 of them."""
    ordered = sorted(names)
    more = f" and {len(ordered) - 40} more" if len(ordered) > 40 else ""
    return ", ".join(ordered[:40]) + more


def _elements(
    plant: MultibodyPlant, indices: Callable, element: Callable[..., _Element]
) -> list[_Element]:
    """Return the elements of all model instances except those of the world."""
    instances = map(ModelInstanceIndex, range(1, plant.num_model_instances()))
    return [element(k) for instance in instances for k in indices(instance)]


def _find(
    model: ModelFile, plant: MultibodyPlant, kind: str, candidates: list[_Element], name: str
) -> _Element:
    scope, _, bare = str(name).rpartition("::")
    matches = [
        candidate
        for candidate in candidates
        if candidate.name() == name
        or (
            candidate.name() == bare
            and scope == plant.GetModelInstanceName(candidate.model_instance())
        )
    ]
    if not matches:
        names = listed(candidate.name() for candidate in candidates)
        raise model.error(f"no {kind} '{name}'; choose from: {names}")
    if len(matches) > 1:
        raise model.error(
            f"{len(matches)} of its {kind} names are '{name}'; give it as instance::name"
        )
    return matches[0]
