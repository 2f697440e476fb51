"""Adds a system to a diagram with its input ports connected, by name."""

from collections.abc import Mapping
from typing import TypeVar

from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from cpid_drake.errors import InputError

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
