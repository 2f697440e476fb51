"""The spacecraft's own state from a port of a plant, and whether that plant conserves momentum."""

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Selector, SelectorParams

from cpid_drake.files.errors import InputError, listed
from cpid_drake.spacecraft.spacecraft import Spacecraft


def spacecraft_state(
    builder: DiagramBuilder, spacecraft: Spacecraft, state: OutputPort
) -> OutputPort:
    """Return the spacecraft's own state x = [q; v], in the order of its plant.

    From the state of a plant that has more bodies, such as a second spacecraft, or another order, a
    `Selector` takes its columns. A port of another system is returned as it is.

    Args:
        builder: the diagram's builder, which has the finalized plant.
        spacecraft: the spacecraft model.
        state: the state of a plant, whole or of a model instance.

    Raises:
        InputError: the plant does not have the spacecraft, or has more than one.

    """
    plant = state.get_system()
    carried = _columns_of(plant, state) if isinstance(plant, MultibodyPlant) else None
    if carried is None:
        return state
    instances = [ModelInstanceIndex(k) for k in range(plant.num_model_instances())]
    whole = len(carried) == plant.num_multibody_states()
    ports = {plant.get_state_output_port(k).get_index(): k for k in instances}
    columns = spacecraft.columns_in(plant, None if whole else ports[state.get_index()])
    _require_no_more_joints(plant, columns)
    places = np.searchsorted(carried, columns)
    if np.array_equal(places, np.arange(len(carried))):
        return state
    params = SelectorParams()
    params.inputs = [SelectorParams.InputPortParams(name="plant_state", size=state.size())]
    choices = [SelectorParams.OutputSelection(input_port_index=0, input_offset=k) for k in places]
    params.outputs = [SelectorParams.OutputPortParams(name="state", selections=choices)]
    selector = builder.AddSystem(Selector(params))
    selector.set_name("spacecraft_state")
    builder.Connect(state, selector.get_input_port())
    return selector.get_output_port()


def _columns_of(plant: MultibodyPlant, port: OutputPort) -> NDArray[np.intp] | None:
    """Return the columns of the plant's x = [q; v] that a state port has; None for other ports."""
    if port.get_index() == plant.get_state_output_port().get_index():
        return np.arange(plant.num_multibody_states())
    q, v = np.arange(plant.num_positions()), np.arange(plant.num_velocities())
    for k in map(ModelInstanceIndex, range(plant.num_model_instances())):
        if port.get_index() == plant.get_state_output_port(k).get_index():
            nq = plant.num_positions()
            return np.append(
                plant.GetPositionsFromArray(k, q), nq + plant.GetVelocitiesFromArray(k, v)
            ).astype(int)
    return None


def _require_no_more_joints(plant: MultibodyPlant, columns: NDArray[np.intp]) -> None:
    """Refuse a plant in which the spacecraft, in these columns, has more joints than its model."""
    own = set(columns.tolist())
    for k in map(ModelInstanceIndex, range(plant.num_model_instances())):
        of_instance = _columns_of(plant, plant.get_state_output_port(k))
        assert of_instance is not None
        others = [c for c in of_instance if c not in own]
        if 0 < len(others) < len(of_instance):
            names = plant.GetStateNames()
            raise InputError(
                f"in the plant, {plant.GetModelInstanceName(k)} has coordinates that the "
                f"spacecraft model has not: {listed([names[c] for c in others])}; it is another "
                "spacecraft"
            )


def require_conservation(spacecraft: Spacecraft, state: OutputPort, user: str) -> None:
    """Refuse the state of a plant that does not conserve the momentum of spacecraft and target.

    Other systems than plants cannot be asked.

    Args:
        spacecraft: the spacecraft model. On a table, gravity may act along the table's normal.
        state: the port.
        user: who needs the conservation, for messages.

    Raises:
        InputError: the plant is discrete, or gravity acts in it.

    """
    plant = state.get_system()
    if not isinstance(plant, MultibodyPlant):
        return
    if plant.time_step() > 0:
        raise InputError(
            f"{user}: the plant is discrete (time_step = {plant.time_step():g} s), and its steps "
            "do not conserve momentum: make it continuous, with MultibodyPlantConfig(time_step=0.0)"
        )
    gravity = plant.gravity_field().gravity_vector()
    across = gravity[:2] if spacecraft.tree.normal_B is not None else gravity
    instances = map(ModelInstanceIndex, range(plant.num_model_instances()))
    heavy = [plant.GetModelInstanceName(k) for k in instances if _has_weight(plant, k)]
    if across.any() and heavy:
        raise InputError(
            f"{user}: gravity of {np.linalg.norm(gravity):.3g} m/s² acts on {listed(heavy)}, and "
            "momentum is not conserved: before Finalize, call "
            "plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])"
        )


def _has_weight(plant: MultibodyPlant, instance: ModelInstanceIndex) -> bool:
    """Return whether gravity acts on a body of a model instance."""
    bodies = [plant.get_body(k) for k in plant.GetBodyIndices(instance)]
    moves = any(not plant.IsAnchored(body) for body in bodies)
    return moves and plant.is_gravity_enabled(instance)
