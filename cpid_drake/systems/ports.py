"""Connections of ports in a diagram."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import MatrixGain

from cpid_drake.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft

AnySystem = TypeVar("AnySystem", bound=LeafSystem)


def add_connected(
    builder: DiagramBuilder, system: AnySystem, ports: Mapping[str, OutputPort]
) -> AnySystem:
    """Add a system to a builder and connect these output ports to its inputs of the same names.

    Raises:
        InputError: an output port and the input differ in size.

    """
    for name, port in ports.items():
        size = system.GetInputPort(name).size()
        if port.size() != size:
            raise InputError(
                f"port '{port.get_name()}' has {port.size()} entries, but the input '{name}' of "
                f"{system.get_name()} has {size}: connect a port of the same spacecraft"
            )
    builder.AddSystem(system)
    for name, port in ports.items():
        builder.Connect(port, system.GetInputPort(name))
    return system


def spacecraft_state(
    builder: DiagramBuilder, spacecraft: Spacecraft, plant: MultibodyPlant
) -> OutputPort:
    """Return the state of the spacecraft alone, without the coordinates of a compliant wrist.

    Args:
        builder: the builder that has the plant.
        spacecraft: the spacecraft.
        plant: the finalized plant of spacecraft and target.

    """
    state = plant.get_state_output_port()
    if state.size() == spacecraft.plant.num_multibody_states():
        return state
    selection = builder.AddSystem(MatrixGain(np.eye(state.size())[spacecraft.columns_in(plant)]))
    selection.set_name("spacecraft_state")
    builder.Connect(state, selection.get_input_port())
    return selection.get_output_port()
