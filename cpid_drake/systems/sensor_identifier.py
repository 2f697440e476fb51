"""Identification as a Drake system: from sensors, each at its own rate, by the online fit."""

from dataclasses import dataclass, replace
from typing import Self
from weakref import WeakKeyDictionary

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, OutputPort, State

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.online import MOST_LINEARIZATIONS, WINDOW, OnlineState
from cpid_drake.files.errors import InputError
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.arguments import PathLike, resolve_sensors
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import THRUST
from cpid_drake.online.stream import Stream, StreamState
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.identifier import Identifier, is_number


class SensorIdentifier(Identifier):
    """Identifies the target's ten inertial parameters online, from sensors at their own rates.

    It runs `estimation.online.step`: it fits the last blocks of samples, each about a second long,
    and keeps a Gaussian of what is behind them. It contains the *known* spacecraft only.

    .. pydrake_system::

        name: SensorIdentifier
        input_ports:
        - attitude
        - gyro
        - position
        - velocity
        - encoders
        - joint_rates
        - thrust
        output_ports:
        - parameters
        - covariance
        - spatial_inertia
        - diagnostics
        - checks_passed

    - one input (1 + width) for each sensor of the suite, as from `SpacecraftSensors`: the time [s]
      of the latest sample, then its value; NaN before the first.
    - `thrust` (7), if `reads_thrust`: the log of thrust in the same form, as from `ExternalForces`.
    - `parameters`, `covariance`, `spatial_inertia`, `diagnostics`: as the outputs of
      `MomentumIdentifier`, but the covariance follows from the sensors' noise, and the residual is
      NaN.
    - `checks_passed` (1): 1 if no check of `identification(context)` fails: convergence,
      residuals as small and as little correlated as the declared noise, errors no larger than
      declared, samples that were rejected, momentum, and a rigid body that has the estimate.

    `identification(context)` also has the number of rejected samples of every sensor and the times
    of changes of the momentum. A rejected sample is unusable, late, or so far off that it weighs
    less.

    In every period it collects the new samples; one of time t, one period after t, because Drake's
    systems read each other's state before the update. A block is solved when every sensor has
    delivered its samples, or `online.stream.LATENESS` later; samples after that are rejected. Only
    stamps determine the blocks; their zero is arbitrary. `Finish` also solves the incomplete block;
    samples that are due at this instant need `Simulator.AdvancePendingEvents` before.

    The state is one abstract value, which is replaced and never changed. Its size does not grow.
    Nearly all of the time is that of updates that solve a block: docs/explanation/speed.md has it
    for 12 joints. Where the momentum changed, such an update takes several times as long.

    Args:
        spacecraft: the spacecraft model.
        suite: its sensors.
        momentum: the total momentum, zero (default) or unknown.
        period: time between updates [s]; default: that of the fastest sensor.
        prior: what is known about the target before the first sample; default: nothing.
        reads_thrust: whether there is a log of thrust.
        known_bodies: uncertainty of the spacecraft's bodies, of the arm's geometry and of the
            grasp, whose errors are estimated too; default: none.
        window: number of blocks that are solved anew with every new one: the longer, the nearer
            to the fit of all samples, and the more work.
        most_linearizations: see `online.stream.Stream`.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`), no encoders, a period that is
            not positive or is longer than the fastest sensor's.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        suite: SensorSuite | PathLike,
        *,
        momentum: TotalMomentum | str | None = None,
        period: float | None = None,
        prior: TargetPrior | PathLike | None = None,
        reads_thrust: bool = False,
        known_bodies: BodyUncertainty | PathLike | None = None,
        window: float = WINDOW,
        most_linearizations: float = MOST_LINEARIZATIONS,
    ) -> None:
        super().__init__()
        self.set_name("sensor_identifier")
        suite = resolve_sensors(suite) or SensorSuite()
        self._stream = Stream(
            spacecraft,
            suite,
            momentum=momentum,
            prior=prior,
            reads_thrust=reads_thrust,
            known_bodies=known_bodies,
            window=window,
            most_linearizations=most_linearizations,
            in_order=True,
        )
        shortest = 1 / max(errors.rate for errors in suite.present().values())
        period = shortest if period is None else period
        if not (is_number(period) and 0 < period <= shortest):
            raise InputError(
                f"identification period must be > 0 s and at most {shortest:g} s, the period of "
                f"the fastest sensor, not {period}"
            )
        self._tree, self._period = spacecraft.tree, period
        self._sample_ports = {
            name: self.DeclareVectorInputPort(name, 1 + width)
            for name, width in self._stream.widths.items()
        }
        nothing = _Memory(self._stream.start(), dict.fromkeys(self._sample_ports, np.nan))
        self._memory_index = self.DeclareAbstractState(Value(nothing))
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._collect
        )
        self.DeclareForcedUnrestrictedUpdateEvent(self._finish)
        self.DeclareInitializationUnrestrictedUpdateEvent(self._begin_run)
        self._answers = WeakKeyDictionary[OnlineState, Identification]()
        self._declare_outputs(self.xa_ticket())

    @classmethod
    def AddToBuilder(
        cls,
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        suite: SensorSuite | PathLike,
        momentum: TotalMomentum | str | None = None,
        period: float | None = None,
        prior: TargetPrior | PathLike | None = None,
        known_bodies: BodyUncertainty | PathLike | None = None,
        window: float = WINDOW,
        most_linearizations: float = MOST_LINEARIZATIONS,
        **samples: OutputPort,
    ) -> Self:
        """Add an identifier to a diagram and connect its inputs; for the options see the class.

        Args:
            **samples: the port of each sensor of the suite, by its name, as from
                `SpacecraftSensors.sample_ports`, and `thrust` if there is a log of thrust.

        Raises:
            InputError: a sensor gets no port, or a port has no sensor or another size.

        """
        identifier = cls(
            spacecraft,
            suite,
            momentum=momentum,
            period=period,
            prior=prior,
            reads_thrust=THRUST in samples,
            known_bodies=known_bodies,
            window=window,
            most_linearizations=most_linearizations,
        )
        return identifier.connected(builder, **samples)

    def online_state(self, context: Context) -> OnlineState:
        """Return the estimator's state in this system's context."""
        return self._memory(context).stream.online

    def _memory(self, context: Context) -> "_Memory":
        memory: _Memory = context.get_abstract_state(self._memory_index).get_value()
        return memory

    def _begin_run(self, context: Context, state: State) -> EventStatus:
        """Refuse a run before the samples of an earlier one: all of it would be late."""
        now, latest = context.get_time(), self._memory(context).latest
        if now < latest:
            raise InputError(
                f"{self.GetSystemPathname()}: time was set back from {latest:g} s to {now:g} s, "
                "and samples of earlier times cannot be used: begin a run with a new Context, or "
                "with SetDefaultContext"
            )
        return EventStatus.DidNothing()

    @one_thread
    def _collect(self, context: Context, state: State) -> EventStatus:
        """Collect new samples, and process all if a block may be complete."""
        now = context.get_time()
        memory = replace(self._with_new_samples(context), latest=now)
        if now >= memory.due - self._period / 2:
            stream = self._stream.processed(memory.stream)
            memory = replace(memory, stream=stream, due=self._stream.due(stream, now))
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)
        return EventStatus.Succeeded()

    @one_thread
    def _finish(self, context: Context, state: State) -> EventStatus:
        """Process all samples, those of the incomplete block included."""
        memory = self._with_new_samples(context)
        memory = replace(memory, stream=self._stream.finished(memory.stream))
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)
        return EventStatus.Succeeded()

    def _with_new_samples(self, context: Context) -> "_Memory":
        memory = self._memory(context)
        times, new = memory.times, {}
        for name, port in self._sample_ports.items():
            sample = port.Eval(context)
            if sample[0] != times[name] and not np.isnan(sample[0]):
                new[name] = sample
        if not new:
            return memory
        due = memory.due
        if np.isnan(due):
            due = context.get_time() + memory.stream.queue.length
        times = times | {name: sample[0] for name, sample in new.items()}
        waiting = (*memory.stream.waiting, *new.items())
        return replace(memory, times=times, stream=replace(memory.stream, waiting=waiting), due=due)

    @one_thread
    def _identify(self, context: Context) -> Identification:
        stream = self._memory(context).stream
        answer = self._answers.get(stream.online)  # most samples leave the fit as it is
        if answer is None:
            answer = self._answers[stream.online] = self._stream.identification(stream)
        return self._stream.counted(answer, stream)


@dataclass(frozen=True, eq=False)
class _Memory:
    """The abstract state. A value in a Context is replaced, never changed."""

    stream: StreamState
    times: dict[str, float]
    """Time of the latest sample of every sensor [s]."""
    latest: float = -np.inf
    """Time of the Context at the latest update [s]."""
    due: float = np.nan
    """Time of the Context at which the next block may be complete [s]; NaN before the first."""

    def __deepcopy__(self, memo: dict[int, object]) -> "_Memory":
        """Return the value itself, which never changes."""
        return self
