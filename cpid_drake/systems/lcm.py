"""An identifier on an LCM bus: its inputs and its outputs as messages."""

import numpy as np
from drake import lcmt_scope
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
    OutputPort,
    PeriodicEventData,
)
from pydrake.systems.lcm import LcmInterfaceSystem, LcmScopeSystem, LcmSubscriberSystem

from cpid_drake.files.errors import InputError
from cpid_drake.systems.identifier import Identifier

OUTPUTS = ("parameters", "covariance", "diagnostics", "checks_passed")
"""The output ports that are published."""


def add_lcm(
    builder: DiagramBuilder,
    identifier: Identifier,
    *,
    lcm: DrakeLcmInterface | None = None,
    channel: str = "CPID",
    period: float = 0.1,
    wait: float = -1.0,
    **ports: OutputPort,
) -> Identifier:
    """Add an identifier to a diagram; LCM messages drive its inputs and carry its outputs.

    All messages are Drake's `lcmt_scope`, a time in µs and numbers. Input `state` is read from the
    channel CPID_STATE, `gyro` from CPID_GYRO, and so on: the numbers are the entries of the port,
    for a sensor its stamp [s] and its value, in SI units and radians. The outputs `OUTPUTS` are
    published as CPID_PARAMETERS and so on; their times are those of the Context.

    A subscriber holds the latest message of its channel. So run the simulator in real time
    (`Simulator.set_target_realtime_rate`), and give a `SensorIdentifier` a period several times
    shorter than that of its fastest sensor: a message that comes twice in a period is lost. A
    sensor's stamp that was read is not used again, so a sender that stops adds nothing. A state has
    no stamp: between two samples of a `MomentumIdentifier` must come a message of another `utime`.

    In this process, subscribe to `lcm` only while no simulation runs: Drake 1.51 calls a Python
    subscriber of the same bus without the interpreter's lock, which can end the process.

    Args:
        builder: the diagram's builder.
        identifier: a `MomentumIdentifier` or a `SensorIdentifier` that is in no diagram yet.
        lcm: the bus; default: LCM's own default.
        channel: beginning of the channels' names.
        period: time between two messages of an output [s].
        wait: how long `Simulator.Initialize` waits for the first message of each input [s]; by
            default it does not. A `MomentumIdentifier` needs a state before its first sample.
        **ports: output ports of the diagram that drive inputs instead of messages, by name.

    Returns:
        The identifier.

    Raises:
        InputError: a port does not fit, or the period is not positive. While the simulation runs: a
            message has another number of entries than its port, or no state has come since the
            sample before: the same state would count as a new one.

    """
    if not period > 0:
        raise InputError(f"add_lcm: the period must be > 0 s, not {period}")
    lcm = DrakeLcm() if lcm is None else lcm
    builder.AddSystem(LcmInterfaceSystem(lcm))
    given = dict(ports)
    for index in range(identifier.num_input_ports()):
        port = identifier.get_input_port(index)
        if (name := port.get_name()) in given:
            continue
        source = f"{channel}_{name.upper()}"
        subscriber = builder.AddSystem(
            LcmSubscriberSystem.Make(
                channel=source,
                lcm_type=lcmt_scope,
                lcm=lcm,
                wait_for_message_on_initialization_timeout=wait,
            )
        )
        # Samples of sensors have stamps; what has none is read once in each of these events.
        event = identifier.GetUniquePeriodicDiscreteUpdateAttribute()
        receiver = builder.AddSystem(_Receiver(source, port.size(), event))
        builder.Connect(subscriber.get_output_port(), receiver.get_input_port())
        given[name] = receiver.get_output_port()
    identifier.connected(builder, **given)
    for name in OUTPUTS:
        LcmScopeSystem.AddToBuilder(
            builder=builder,
            lcm=lcm,
            signal=identifier.GetOutputPort(name),
            channel=f"{channel}_{name.upper()}",
            publish_period=period,
        )
    return identifier


class _Receiver(LeafSystem):  # type: ignore[misc]  # the base has no usable stub
    """The numbers of the latest message; NaN before the first.

    If it is read in periodic events, it remembers the message of the last one.
    """

    def __init__(self, channel: str, size: int, event: PeriodicEventData | None) -> None:
        super().__init__()
        self.set_name(channel)
        self.DeclareAbstractInputPort("message", Value(lcmt_scope()))
        self.DeclareVectorOutputPort("values", size, self._calc_values)
        self.DeclareDiscreteState([np.nan])  # `utime` of the message that was read
        if event is not None:
            self.DeclarePeriodicDiscreteUpdateEvent(
                event.period_sec(), event.offset_sec(), self._remember
            )

    def _message(self, context: Context) -> lcmt_scope:
        return self.GetInputPort("message").Eval(context)

    def _remember(self, context: Context, discrete_state: DiscreteValues) -> None:
        message = self._message(context)
        if message.size:
            discrete_state.set_value([message.utime])

    def _calc_values(self, context: Context, output: BasicVector) -> None:
        message = self._message(context)
        if message.size == 0:  # none has come
            output.SetFromVector(np.full(output.size(), np.nan))
            return
        if message.size != output.size():
            raise InputError(
                f"LCM channel {self.get_name()}: a message has {message.size} numbers, "
                f"not {output.size()}"
            )
        if message.utime == context.get_discrete_state_vector().value()[0]:
            raise InputError(
                f"LCM channel {self.get_name()}: no message has come since the last sample, and "
                "the same state must not count twice; a SensorIdentifier waits instead"
            )
        output.SetFromVector(message.value)
