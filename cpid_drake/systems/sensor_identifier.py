"""Identification as a Drake system: from sensors, each at its own rate, by the online fit."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    Context,
    EventStatus,
    State,
)

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import BlockQueue, after
from cpid_drake.estimation.online import WINDOW, OnlineState, step
from cpid_drake.estimation.unknowns import Model
from cpid_drake.identification.consistency import with_nearest_body
from cpid_drake.identification.online import identification_of_state, question_of
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import THRUST, Log, Samples
from cpid_drake.logs.screening import last_time, screen
from cpid_drake.processes import one_thread
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite, check_sensors, require_encoders
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.identifier import Identifier, is_number

LONGEST_DELAY = 0.5
"""A block waits at most this time for the samples of a sensor [s].

Delays of star trackers and of relative navigation are shorter. The estimate is later by this time
while a sensor is silent.
"""

_SHARE_OF_INTERVAL = 0.9  # of a sensor's sampling interval in which no further sample can come


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
    - the port of the checks (1): 1 if no check of `identification(context)` fails: convergence,
      residuals as small and as little correlated as the declared noise, errors no larger than
      declared, samples that were rejected, momentum, and a rigid body that has the estimate.

    `identification(context)` also has the number of rejected samples of every sensor and the times
    of changes of the momentum. A rejected sample is unusable, late, or so far off that it weighs
    less.

    In every period it collects the new samples. When a block is complete, it screens the samples
    and solves the block. Drake systems that update at the same instant read each other's state
    before the update, so a sample of time t is collected one period after t. No sample is missed,
    because no sensor is faster than this period.

    A sensor may deliver its samples late, by up to `LONGEST_DELAY`: a block is complete when every
    sensor has delivered its samples, or after that delay. Later samples are rejected. Only the
    stamps determine the blocks; their zero is arbitrary. At the end of a simulation,
    `Finish` processes all samples, those of the incomplete block included. The samples that are due
    at this instant need `Simulator.AdvancePendingEvents` before.

    The state is one abstract value that is never changed, only replaced. Its size does not grow
    with time, and clones of a Context share it. The work of an update is bounded; see
    `estimation.online.step`. Most updates only collect samples. One that completes a block solves
    the blocks of the window once or twice, some 50 ms of processor time for 12 joints; where the
    momentum changed, ten times as much.

    Args:
        spacecraft: the known spacecraft.
        suite: its sensors.
        momentum: the total momentum, zero (default) or unknown.
        period: time between updates [s]; default: that of the fastest sensor.
        prior: what is known about the target before the first sample; default: nothing.
        reads_thrust: whether there is a log of thrust.
        known_bodies: uncertainty of the spacecraft's bodies, of the arm's geometry and of the
            grasp, whose errors are estimated too; default: none.
        window: number of blocks that are solved anew with every new one: the longer, the nearer
            to the fit of all samples, and the more work.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`), no encoders, a period that is
            not positive or is longer than the fastest sensor's.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        suite: SensorSuite,
        *,
        momentum: TotalMomentum | None = None,
        period: float | None = None,
        prior: TargetPrior | None = None,
        reads_thrust: bool = False,
        known_bodies: BodyUncertainty | None = None,
        window: float = WINDOW,
    ) -> None:
        super().__init__()
        self.set_name("sensor_identifier")
        check_sensors(suite, "sensors")
        require_encoders(suite, "sensors")
        self._suite, present = suite, suite.present()
        shortest = 1 / max(errors.rate for errors in present.values())
        period = shortest if period is None else period
        if not (is_number(period) and 0 < period <= shortest):
            raise InputError(
                f"identification period must be > 0 s and at most {shortest:g} s, the period of "
                f"the fastest sensor, not {period}"
            )
        model = Model.of(spacecraft.tree, suite, known_bodies, has_thrust=reads_thrust)
        self._model = replace(model, rows=() if prior is None else (prior.of_psi(model),))
        self._momentum = momentum or TotalMomentum.zero()
        self._joint_names, self._suite, self._period = spacecraft.joint_names, suite, period
        joints = len(spacecraft.joint_names)
        self._sample_ports = {
            name: self.DeclareVectorInputPort(name, 1 + SENSORS[name].width_of(joints))
            for name in present
        }
        if reads_thrust:
            self._sample_ports[THRUST] = self.DeclareVectorInputPort(THRUST, 7)
        self._memory_index = self.DeclareAbstractState(
            Value(
                _Memory(
                    BlockQueue.of(suite),
                    dict.fromkeys(self._sample_ports, np.nan),
                    OnlineState(window, question_of(self._model, self._momentum)),
                )
            )
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._collect
        )
        self.DeclareForcedUnrestrictedUpdateEvent(self._finish)
        self._answers = WeakKeyDictionary[OnlineState, Identification]()
        self._declare_outputs(self.xa_ticket())

    def online_state(self, context: Context) -> OnlineState:
        """Return the estimator's state in this system's context."""
        return self._memory(context).online

    def _memory(self, context: Context) -> "_Memory":
        return context.get_abstract_state(self._memory_index).get_value()

    @one_thread
    def _collect(self, context: Context, state: State) -> EventStatus:
        """Collect new samples, and process all if a block may be complete."""
        memory, now = self._with_new_samples(context), context.get_time()
        if now >= memory.due - self._period / 2:
            memory = self._processed(memory)
            recent = memory.screening or Log(self._joint_names)
            missing = memory.queue.next_edge - self._complete_until(recent)
            memory = replace(memory, due=now + max(missing, 0.0))
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)
        return EventStatus.Succeeded()

    @one_thread
    def _finish(self, context: Context, state: State) -> EventStatus:
        """Process all samples, those of the incomplete block included."""
        memory = self._processed(self._with_new_samples(context))
        for block in memory.queue.finished():
            queue = replace(memory.queue, edge=block.end, waiting=None)
            memory = replace(memory, queue=queue, online=step(self._model, memory.online, block))
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)
        return EventStatus.Succeeded()

    def _with_new_samples(self, context: Context) -> "_Memory":
        memory = self._memory(context)
        seen, new = memory.seen, {}
        for name, port in self._sample_ports.items():
            sample = port.Eval(context)
            if sample[0] != seen[name] and not np.isnan(sample[0]):
                new[name] = sample
        if not new:
            return memory
        due = memory.due
        if np.isnan(due):
            due = context.get_time() + memory.queue.length
        seen = seen | {name: sample[0] for name, sample in new.items()}
        return replace(memory, seen=seen, waiting=(*memory.waiting, new), due=due)

    def _processed(self, memory: "_Memory") -> "_Memory":
        """Give all collected samples to the fit, block after block."""
        rows = defaultdict(list)
        for new in memory.waiting:
            for name, sample in new.items():
                rows[name].append(sample)
        samples = {name: np.array(each) for name, each in rows.items()}
        given = Log(
            self._joint_names, {name: Samples(s[:, 0], s[:, 1:]) for name, s in samples.items()}
        )
        screened = screen(given, self._suite, memory.screening)
        timely, queue, online = screened.log, memory.queue, memory.online
        if not np.isnan(queue.edge):
            timely = after(timely, queue.edge, np.inf)
        late = {name: len(s) - len(timely[name]) for name, s in screened.log.items()}
        queue, blocks = queue.added(timely, self._complete_until(screened.memory))
        for block in blocks:
            online = step(self._model, online, block)
        rejected = Counter(memory.rejected) + Counter(screened.rejected) + Counter(late)
        return replace(
            memory,
            queue=queue,
            online=online,
            waiting=(),
            rejected=rejected,
            screening=screened.memory,
        )

    def _complete_until(self, recent: Log) -> float:
        """Return the time until which the samples of all sensors have arrived [s]."""
        newest, present = recent.interval[1], self._suite.present()
        complete = min(last_time(recent[n]) + _SHARE_OF_INTERVAL / present[n].rate for n in present)
        return min(newest, max(complete, newest - LONGEST_DELAY))

    @one_thread
    def _solve(self, context: Context) -> Identification:
        memory = self._memory(context)
        found = self._answers.get(memory.online)  # most samples leave the fit as it is
        if found is None:
            found = identification_of_state(self._model, memory.online, self._momentum)
            found = self._answers[memory.online] = with_nearest_body(found, self._model.tree)
        rejected = Counter(memory.rejected) + Counter(found.rejected)
        return replace(found, rejected=dict(rejected))


@dataclass(frozen=True, eq=False)
class _Memory:
    """The abstract state. A value in a Context is replaced, never changed.

    Attributes:
        queue: samples of the block that is not complete.
        seen: time of the latest sample of every sensor [s].
        online: the state of the fit.
        waiting: samples to process later, of one update each, [time, value] by sensor.
        rejected: number of unusable samples, by sensor.
        screening: what screening remembers.
        due: time of the Context at which the next block may be complete [s]; NaN before the first
            sample.

    """

    queue: BlockQueue
    seen: dict[str, float]
    online: OnlineState = field(default_factory=OnlineState)
    waiting: tuple[dict[str, NDArray[np.float64]], ...] = ()
    rejected: Mapping[str, int] = field(default_factory=dict)
    screening: Log | None = None
    due: float = np.nan

    def __deepcopy__(self, memo: dict) -> "_Memory":
        """Return the value itself, which never changes."""
        return self
