"""What all systems of a spacecraft share: their connection in a diagram, their scratch contexts."""

import threading
from inspect import signature
from typing import Any, Self

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import MatrixGain

from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft


class PlantScratch(threading.local):
    """A context of a plant that a system overwrites at every call; it holds no state.

    Every thread has its own, so that one Diagram can run in many Contexts at a time.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        self.context = plant.CreateDefaultContext()


class SpacecraftSystem(LeafSystem):
    """Base class of the systems that belong to a spacecraft: it has their `AddToBuilder`."""

    @classmethod
    def AddToBuilder(cls, builder: DiagramBuilder, spacecraft: Spacecraft, **given: Any) -> Self:
        """Add a system to a diagram and connect its ports.

        Args:
            builder: the diagram's builder.
            spacecraft: the first argument of the constructor.
            **given: ports by the names in the class's documentation: an `OutputPort` for each
                input, and an `InputPort` for an output that is to drive it. All others are options
                of the constructor, by name.

        Raises:
            InputError: an option is unknown, an input gets no port, or a port has another size or
                no counterpart; also the errors of the constructor.

        """
        ports = {n: p for n, p in given.items() if isinstance(p, (InputPort, OutputPort))}
        options = {n: value for n, value in given.items() if n not in ports}
        known = signature(cls).parameters
        for unknown in (n for n in options if n not in known):
            raise InputError(
                f"{cls.__name__} has no option '{unknown}', and {unknown} is no port; options are "
                f"{', '.join([*known][1:]) or 'none'}"
            )
        system = cls(spacecraft, **options)
        name = system.get_name()
        pairs = []
        for own, port in ports.items():
            is_input = isinstance(port, OutputPort)
            if not (system.HasInputPort(own) if is_input else system.HasOutputPort(own)):
                raise InputError(f"{name} has no {'input' if is_input else 'output'} '{own}'")
            mine = system.GetInputPort(own) if is_input else system.GetOutputPort(own)
            if port.size() != mine.size():
                raise InputError(
                    f"port '{port.get_name()}' has {port.size()} entries, but '{own}' of {name} "
                    f"has {mine.size()}: connect a port of the same spacecraft"
                )
            pairs.append((port, mine) if is_input else (mine, port))
        for index in range(system.num_input_ports()):
            if (wanted := system.get_input_port(index).get_name()) not in ports:
                raise InputError(f"{name}: no output port is given for its input '{wanted}'")
        builder.AddSystem(system)
        for output, into in pairs:
            builder.Connect(output, into)
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
