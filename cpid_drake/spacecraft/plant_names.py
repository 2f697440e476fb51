"""Bodies, joints and frames of a plant by their names."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody

from cpid_drake.files.errors import InputError, listed

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


def find_counterpart(
    plant: MultibodyPlant,
    element: _Element,
    has: Callable[[str, ModelInstanceIndex], bool],
    get: Callable[[str, ModelInstanceIndex], _Element],
    instance: ModelInstanceIndex | None = None,
) -> _Element:
    """Return the body or joint of another plant that has this one's name.

    Its model instance is the given one, or that of the same name, or the only one that has it.

    Args:
        plant: the other plant.
        element: the body or joint.
        has, get: the other plant's methods that find such an element by name and instance.
        instance: the model instance; default: any.

    Raises:
        InputError: there is none, or more than one.

    """
    name = element.name()
    scope = element.GetParentPlant().GetModelInstanceName(element.model_instance())
    instances = [ModelInstanceIndex(k) for k in range(plant.num_model_instances())]
    among = [k for k in instances if instance in (None, k) and has(name, k)]
    scopes = [plant.GetModelInstanceName(k) for k in among]
    if not among:
        raise InputError(
            f"the plant has no '{name}' of the spacecraft model: connect the state of a plant of "
            "the same spacecraft"
        )
    if len(among) > 1 and scope not in scopes:
        raise InputError(
            f"the plant has '{name}' in {listed(scopes)}: connect its "
            "get_state_output_port(model_instance) of one of them"
        )
    return get(name, among[scopes.index(scope) if scope in scopes else 0])


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
