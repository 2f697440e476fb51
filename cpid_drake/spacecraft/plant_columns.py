"""The columns of another plant's state that are the state of the spacecraft."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody

from cpid_drake.files.errors import InputError, listed
from cpid_drake.spacecraft.floating_base import floating_joint

_Element = TypeVar("_Element", RigidBody, Joint)


def counterpart_columns(
    own_plant: MultibodyPlant,
    base: RigidBody,
    joints: Sequence[Joint],
    plant: MultibodyPlant,
    instance: ModelInstanceIndex | None = None,
) -> NDArray[np.intp]:
    """Return the columns of a plant's x = [q; v] in the order of the state of another plant.

    Args:
        own_plant: the other plant, finalized.
        base, joints: all that moves in it.
        plant: the plant, finalized.
        instance: the model instance that has the whole spacecraft; default: any.

    Raises:
        InputError: see `Spacecraft.columns_in`.

    """
    columns = np.empty(own_plant.num_multibody_states(), dtype=np.intp)
    nq, own_nq = plant.num_positions(), own_plant.num_positions()
    B = find_counterpart(plant, base, plant.HasBodyNamed, plant.GetBodyByName, instance)
    own, theirs = floating_joint(own_plant, base), floating_joint(plant, B)
    columns[own.position_start() + np.arange(7)] = theirs.position_start() + np.arange(7)
    own_v, v = own_nq + own.velocity_start(), nq + theirs.velocity_start()
    columns[own_v + np.arange(6)] = v + np.arange(6)
    for joint in joints:
        J = find_counterpart(plant, joint, plant.HasJointNamed, plant.GetJointByName, instance)
        if J.type_name() != joint.type_name():
            raise InputError(
                f"joint '{joint.name()}' must be {joint.type_name()} in the plant, as in the "
                f"spacecraft model, not {J.type_name()}"
            )
        columns[joint.position_start()] = J.position_start()
        columns[own_nq + joint.velocity_start()] = nq + J.velocity_start()
    return columns


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
