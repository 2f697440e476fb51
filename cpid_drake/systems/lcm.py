"""An identifier on LCM: its sensors' samples from channels, what it knows onto channels."""

from functools import partial

import numpy as np
from drake import lcmt_scope
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.lcm import LcmInterfaceSystem, LcmScopeSystem, LcmSubscriberSystem

from cpid_drake.files.errors import InputError
from cpid_drake.systems.identifier import Identifier
from cpid_drake.systems.sensor_identifier import SensorIdentifier

PUBLISHED = ("parameters", "covariance", "diagnostics", "checks_passed")
"""The outputs of an identifier that are published."""


def add_lcm(
    builder: DiagramBuilder,
    identifier: Identifier,
    *,
    lcm: DrakeLcmInterface | None = None,
    prefix: str = "CPID_",
    period: float = 1.0,
) -> LcmInterfaceSystem:
    """Add an identifier to a diagram, with LCM channels for its inputs and its outputs.

    All messages are Drake's `lcmt_scope`: `utime` [µs] and `value`. Each channel is the prefix and
    the name of a port.

    - In, for each input of a `SensorIdentifier`: `utime` is the stamp of the sample, on one clock
      for all sensors, and `value` (width) the sample in SI units and radians, as the value in
      `SensorIdentifier`: "CPID_attitude" (4), "CPID_gyro" (3), "CPID_position" (3),
      "CPID_velocity" (3), "CPID_encoders" (J), "CPID_joint_rates" (J), "CPID_thrust" (6).
    - Out, in every period of the diagram's time, with its time as `utime`: "CPID_parameters" (10),
      "CPID_covariance" (100), "CPID_diagnostics" (4) and "CPID_checks_passed" (1), as the
      outputs of `MomentumIdentifier`; NaN while unknown.

    A subscriber holds the latest message, so one that another replaces before the identifier
    reads it is lost. A `period` of the identifier of half the sensors' shortest interval avoids
    this; run the diagram at `Simulator.set_target_realtime_rate(1)`. A message of a stamp that was
    read is not used again: a sender that stops adds nothing.

    Args:
        builder: the diagram's builder.
        identifier: an identifier that is not in a diagram; or one that is, with connected inputs:
            its outputs are published.
        lcm: what to send and receive with; default: a `DrakeLcm` of the default URL.
        prefix: what the names of all channels begin with.
        period: time between published messages [s].

    Returns:
        The system that receives messages while the diagram runs.

    Raises:
        InputError: no identifier, a period that is not positive; a `MomentumIdentifier` without a
            state, whose samples have no stamps: it would count a state again if the sender stopped;
            and, while it runs, a message of another size.

    """
    if not isinstance(identifier, Identifier):
        raise InputError(
            f"add_lcm: the identifier must be a SensorIdentifier, not {type(identifier).__name__}"
        )
    if not 0 < period < np.inf:
        raise InputError(f"add_lcm: the period of messages must be > 0 s, not {period}")
    is_there = identifier in builder.GetSystems()
    if not is_there and not isinstance(identifier, SensorIdentifier):
        raise InputError(
            f"add_lcm: a {type(identifier).__name__} does not see when a sender stops, and would "
            "count its last state again; use a SensorIdentifier, or connect the state in the "
            "diagram first"
        )
    bus = DrakeLcm() if lcm is None else lcm
    interface = builder.AddSystem(LcmInterfaceSystem(bus))
    if not is_there:
        ports = {}
        for index in range(identifier.num_input_ports()):
            port = identifier.get_input_port(index)
            channel = prefix + port.get_name()
            receiver = builder.AddSystem(LcmSubscriberSystem.Make(channel, lcmt_scope, bus))
            sample = builder.AddSystem(_Sample(channel, port.size() - 1))
            builder.Connect(receiver.get_output_port(), sample.get_input_port())
            ports[port.get_name()] = sample.get_output_port()
        identifier.connected(builder, **ports)
    for name in PUBLISHED:
        LcmScopeSystem.AddToBuilder(
            builder, bus, identifier.GetOutputPort(name), prefix + name, period
        )
    return interface


class _Sample(LeafSystem):
    """The latest message of a channel as stamp [s] and value (1 + width); NaN before the first."""

    def __init__(self, channel: str, width: int) -> None:
        super().__init__()
        self.set_name(channel)
        self.DeclareAbstractInputPort("message", AbstractValue.Make(lcmt_scope()))
        self.DeclareVectorOutputPort("sample", 1 + width, partial(self._calc, width))

    def _calc(self, width: int, context: Context, output: BasicVector) -> None:
        message = self.get_input_port().Eval(context)
        if not message.utime and not message.size:
            output.SetFromVector(np.full(1 + width, np.nan))
            return
        if message.size != width:
            raise InputError(
                f"LCM channel {self.get_name()}: a sample has {width} entries, not {message.size}"
            )
        output.SetFromVector([1e-6 * message.utime, *message.value])
