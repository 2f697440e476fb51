"""What all systems of a spacecraft share: their connection in a diagram, their plants' contexts."""

from collections.abc import Callable
from typing import Self

from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    ValueProducer,
)

from cpid_drake.files.errors import InputError


class SpacecraftSystem(LeafSystem):  # type: ignore[misc]  # the base has no usable stub
    """Base class of the systems that belong to a spacecraft: how they are connected."""

    def connected(self, builder: DiagramBuilder, **ports: InputPort | OutputPort | None) -> Self:
        """Add this system to a diagram, connect its ports, and return it.

        Args:
            builder: the diagram's builder.
            **ports: by the names of this system's ports: an `OutputPort` for each input, and an
                `InputPort` for an output that is to drive it; None for an output that drives none.

        Raises:
            InputError: an input gets no port, or a port has another size or no counterpart.

        """
        name, pairs = self.get_name(), []
        for own, port in ports.items():
            if port is None:
                continue
            if not isinstance(port, (InputPort, OutputPort)):
                raise InputError(f"{name}: '{own}' must be a port, not {type(port).__name__}")
            is_input = isinstance(port, OutputPort)
            if not (self.HasInputPort(own) if is_input else self.HasOutputPort(own)):
                raise InputError(f"{name} has no {'input' if is_input else 'output'} '{own}'")
            mine = self.GetInputPort(own) if is_input else self.GetOutputPort(own)
            if port.size() != mine.size():
                raise InputError(
                    f"port '{port.get_name()}' has {port.size()} entries, but '{own}' of {name} "
                    f"has {mine.size()}: connect a port of the same spacecraft"
                )
            pairs.append((port, mine) if is_input else (mine, port))
        for index in range(self.num_input_ports()):
            if ports.get(wanted := self.get_input_port(index).get_name()) is None:
                raise InputError(f"{name}: no output port is given for its input '{wanted}'")
        builder.AddSystem(self)
        for output, into in pairs:
            builder.Connect(output, into)
        return self

    def _declare_plant_context(self, plant: MultibodyPlant) -> Callable[[Context], Context]:
        """Declare a context of a plant that each call may overwrite; return how to get it."""
        evaluate: Callable[[Context], Context] = self.DeclareCacheEntry(
            "plant_context",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(plant.CreateDefaultContext()),
                calc=ValueProducer.NoopCalc,
            ),
            {self.nothing_ticket()},
        ).Eval
        return evaluate
