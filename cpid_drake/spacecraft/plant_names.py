"""Bodies, joints and frames of a plant by their names."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, TypeVar

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, RigidBody

from cpid_drake.files.errors import InputError

_Element = TypeVar("_Element", RigidBody, Joint)


def find_element(plant: MultibodyPlant, kind: str, name: str, where: str) -> Any:
    """Return the "Body" or "Frame" of this name, bare or scoped as `instance::name`.

    Raises:
        InputError: there is none, or more than one; the message begins with `where`.

    """
    scope, _, bare = name.rpartition("::")
    find = getattr(plant, f"Get{kind}ByName")
    try:
        return find(bare, plant.GetModelInstanceByName(scope)) if scope else find(name)
    except RuntimeError as error:
        text = str(error).partition("(): ")[2]
        remedy = "scope a name as INSTANCE::NAME"
        if where.endswith(".xml"):
            remedy += "; a <site> is not read: write a <body> in its place"
        raise InputError(f"{where}: {text:.400}; {remedy}") from error


def unique_names(
    plant: MultibodyPlant, elements: Sequence[Joint | RigidBody | Frame]
) -> tuple[str, ...]:
    """Return the bare names of elements where they are unique, else the scoped names."""
    count = Counter(element.name() for element in elements)
    instances = [plant.GetModelInstanceName(element.model_instance()) for element in elements]
    return tuple(
        element.name() if count[element.name()] == 1 else f"{instance}::{element.name()}"
        for element, instance in zip(elements, instances, strict=True)
    )
