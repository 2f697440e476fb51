"""The online fit of samples as they arrive: screened, cut into blocks, solved block after block."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block import Block, BlockQueue, after
from cpid_drake.estimation.online import MOST_LINEARIZATIONS, WINDOW, OnlineState, step
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError
from cpid_drake.identification.arguments import Arguments, PathLike
from cpid_drake.identification.checks import Check
from cpid_drake.identification.consistency import with_nearest_body
from cpid_drake.identification.online_answer import identification_of_state, question_of
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import THRUST, Log, Samples
from cpid_drake.logs.screening import screen
from cpid_drake.online.first_samples import FirstSamples
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite, check_sensors, require_encoders
from cpid_drake.spacecraft.spacecraft import Spacecraft

LATENESS = 0.5
"""A block waits at most this time for samples that arrive late [s].

Delays of star trackers and of relative navigation are shorter. The estimate is later by this time
while a sensor is silent.
"""

_SHARE_OF_INTERVAL = 0.9  # of a sensor's sampling interval in which no further sample can come

_RETRY = 0.1  # of a block: a block that waits for the end of a gap is asked for so often

Sample = tuple[str, Array]
"""Name of a sensor and (1 + width,) stamp [s] and value."""


@dataclass(frozen=True, eq=False)
class StreamState:
    """What is known of a stream: a value that is never changed, only replaced.

    Attributes:
        queue: samples of the block that is not complete.
        online: the state of the fit.
        waiting: samples that are not screened yet.
        rejected: number of unusable samples, by sensor.
        screening: what screening remembers.
        first: the first samples, and what they contradict; then no block is solved.
        zero: stamp of the first sample [s]; all times in the queue, the fit and the screening are
            counted from it, because stamps since 1970 would lose digits. NaN before it.

    """

    queue: BlockQueue
    online: OnlineState
    waiting: tuple[Sample, ...] = ()
    rejected: Mapping[str, int] = field(default_factory=dict)
    screening: Log | None = None
    first: FirstSamples = field(default_factory=FirstSamples)
    zero: float = np.nan

    def __deepcopy__(self, memo: dict[int, object]) -> "StreamState":
        """Return the value itself, which never changes."""
        return self


class Stream:
    """How the samples of a spacecraft's sensors are solved as they arrive.

    Args:
        spacecraft: the spacecraft model.
        suite: its sensors, or the name of a preset, or a file; so for all other arguments.
        momentum: the total momentum, zero (default) or unknown.
        prior: what is known about the target before the first sample; default: nothing.
        reads_thrust: whether there is a log of thrust.
        known_bodies: uncertainty of the spacecraft's bodies, of the arm's geometry and of the
            grasp; default: as `identify`.
        window: number of blocks that are solved anew with every new one.
        most_linearizations: of blocks in the window, for every new one. If it needs more, its
            samples are rejected and counted, and the next follows as after a gap.
        lateness: a sample may arrive after others that are later by this time [s].
        in_order: whether the samples of each sensor arrive in the order of their stamps.

    Attributes:
        suite: the sensors.
        joint_names: the joints, in the order of joint sensors' values.
        widths: number of entries of a sample's value, by sensor.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`), no encoders, a lateness, a window
            or a number of linearizations that is not positive.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        suite: SensorSuite | PathLike,
        *,
        momentum: TotalMomentum | str | None = None,
        prior: TargetPrior | Identification | PathLike | None = None,
        reads_thrust: bool = False,
        known_bodies: BodyUncertainty | PathLike | None = None,
        window: float = WINDOW,
        most_linearizations: float = MOST_LINEARIZATIONS,
        lateness: float = LATENESS,
        in_order: bool = False,
    ) -> None:
        given = Arguments.of(spacecraft, None, None, suite, momentum, known_bodies, prior)
        suite = given.sensors or SensorSuite()
        check_sensors(suite, "sensors")
        require_encoders(suite, "sensors")
        positive = {"lateness": lateness, "window": window}
        positive["most_linearizations"] = most_linearizations
        for name, value in positive.items():
            if not value > 0:
                raise InputError(f"{name} must be positive, not {value}")
        model = Model.of(spacecraft.tree, suite, given.known_bodies, has_thrust=reads_thrust)
        self._model = model
        if given.prior is not None:
            self._model = replace(model, rows=(given.prior.of_psi(model),))
        self.suite, self.joint_names = suite, spacecraft.joint_names
        self._question = question_of(model, given.momentum or TotalMomentum.zero())
        self._arguments = replace(given, sensors=suite)
        self._lateness, self._in_order = lateness, in_order
        self._window, self._most = window, most_linearizations
        joints = len(spacecraft.joint_names)
        self.widths = {name: SENSORS[name].width_of(joints) for name in suite.present()}
        if reads_thrust:
            self.widths[THRUST] = 6

    def start(self) -> StreamState:
        """Return the state before the first sample."""
        online = OnlineState(self._window, self._question, self._most)
        return StreamState(BlockQueue.of(self.suite), online)

    def processed(self, state: StreamState, *, is_end: bool = False) -> StreamState:
        """Return the state after all blocks that are complete.

        Args:
            state: with the samples that wait.
            is_end: whether no more samples come, so that nothing waits for them.

        """
        stamps = [sample[0] for _, sample in state.waiting]
        zero = float(min(stamps, default=np.nan)) if np.isnan(state.zero) else state.zero
        newest = max(stamps, default=-np.inf)
        until = newest if is_end or self._in_order else newest - self._lateness
        given, waiting = self._log_of(state.waiting, until, zero)
        until -= zero
        screened = screen(given, self.suite, state.screening)
        timely, queue = screened.log, state.queue
        if not np.isnan(queue.edge):
            timely = after(timely, queue.edge, np.inf)
        late = {name: len(s) - len(timely[name]) for name, s in screened.log.items()}
        if self._in_order:
            until = self._complete_until(screened.memory)
        queue, blocks = queue.added(timely, until)
        rejected = Counter(state.rejected) + Counter(screened.rejected) + Counter(late)
        state = replace(
            state,
            queue=queue,
            waiting=waiting,
            rejected=rejected,
            screening=screened.memory,
            zero=zero,
        )
        for block in blocks:
            state = self._stepped(state, block)
        return state

    def _stepped(self, state: StreamState, block: Block) -> StreamState:
        """Return the state after one more block, with those that waited for it."""
        first, online = state.first, state.online
        if first.is_compared and not first.contradiction:
            return replace(state, online=step(self._model, online, block))
        first, blocks = first.with_block(block, self._arguments)
        for each in blocks:
            online = step(self._model, online, each)
        if not first.contradiction:
            return replace(state, first=first, online=online)
        rejected = Counter(state.rejected)
        for each in (*state.first.waiting, block):
            rejected.update({name: len(samples) for name, samples in each.samples.items()})
        nothing = self.start().online  # whatever was solved before
        return replace(state, first=first, online=nothing, rejected=rejected)

    def finished(self, state: StreamState) -> StreamState:
        """Return the state after all samples, those of the incomplete block included."""
        state = self.processed(state, is_end=True)
        for block in state.queue.finished():
            queue = replace(state.queue, edge=block.end, waiting=None)
            state = self._stepped(replace(state, queue=queue), block)
        online = state.online
        for block in state.first.waiting:  # too few to compare
            online = step(self._model, online, block)
        return replace(
            state, online=online, first=replace(state.first, solved=len(state.first.blocks))
        )

    def due(self, state: StreamState, newest: float) -> float:
        """Return the stamp from which on a block may be complete [s].

        Args:
            state: after processing.
            newest: the latest stamp [s].

        """
        queue = state.queue
        if self._in_order and state.screening:  # as far as all have arrived
            missing = queue.next_edge - self._complete_until(state.screening)
            return newest + (queue.length if np.isnan(missing) else max(missing, 0.0))
        edge = newest + queue.length
        if not np.isnan(queue.edge):
            edge = state.zero + queue.next_edge
        return max(edge + self._lateness, newest + _RETRY * queue.length)

    def identification(self, state: StreamState, *, has_budget: bool = False) -> Identification:
        """Return the identification of a state, with its error budget if wanted; see `counted`."""
        joints = self.joint_names if has_budget else None
        answer = identification_of_state(self._model, state.online, joints)
        if wrong := state.first.contradiction:
            answer = replace(answer, checks=(*answer.checks, Check("log", wrong)))
        if answer.momentum_changes:
            changes = tuple(state.zero + time for time in answer.momentum_changes)
            answer = replace(answer, momentum_changes=changes)
        return with_nearest_body(answer, self._model.tree)

    def counted(self, answer: Identification, state: StreamState) -> Identification:
        """Return an identification with the samples that were rejected before the fit."""
        return replace(answer, rejected=dict(Counter(state.rejected) + Counter(answer.rejected)))

    def _log_of(
        self, samples: Iterable[Sample], until: float, zero: float
    ) -> tuple[Log, tuple[Sample, ...]]:
        """Return the samples up to a stamp in order, with times from `zero` on, and all others."""
        rows, later = defaultdict(list), list[Sample]()
        for name, sample in samples:
            if self._in_order or sample[0] <= until:
                rows[name].append(sample)
            else:
                later.append((name, sample))
        arrays = {name: np.array(each) for name, each in rows.items()}
        if not self._in_order:
            arrays = {n: each[np.argsort(each[:, 0], kind="stable")] for n, each in arrays.items()}
        parts = {name: Samples(each[:, 0] - zero, each[:, 1:]) for name, each in arrays.items()}
        return Log(self.joint_names, parts), tuple(later)

    def _complete_until(self, recent: Log) -> float:
        """Return the time until which the samples of all sensors have arrived in order [s]."""
        newest, present = recent.interval[1], self.suite.present()
        complete = min(recent[n].last_time + _SHARE_OF_INTERVAL / present[n].rate for n in present)
        return min(newest, max(complete, newest - self._lateness))
