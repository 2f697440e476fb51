"""A log cut into blocks, and the present values of what belongs to this log alone."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, zip_longest
from operator import attrgetter
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.block_state import BlockState, Link
from cpid_drake.estimation.gaussian import places_of
from cpid_drake.estimation.joint_samples import Smoothness
from cpid_drake.estimation.joints import continued, smooth_joints
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.process import DECLARED, Innovations, Process
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import SENSORS

CLOSED = 1e-8
"""σ of a change at a closed end, as a share of 1 rad, 1 m, 1 m/s and a fast tumble's momentum."""

JUDGED = 1e-5
"""The same for the χ² by which a step is judged; see `LogState.link_cost`."""

RECENT = 3
"""Behind a past, so many of the last blocks show how smooth the joints of one more are."""

CHANGE = "change at "
"""Beginning of the name of an unknown change of momentum; see `LogState.change`."""

FARTHEST = 0.5, 1.0, 1.0
"""σ of a change at an open end: of attitude [rad], centre of mass [m] and its velocity [m/s]."""


@dataclass(frozen=True, eq=False)
class LogState:
    """A log, and the present values of the unknowns of its blocks.

    Attributes:
        name: of the log.
        states: of successive blocks.
        slow_at_end: (s,) slow noise of sensors at the end of the last block; see `BlockState.slow`.
        smoothness: of the joint motion.
        origin: time from which on zeros of joints and clocks drift [s].
        processes: of each sensor and white force whose noise is not as declared.
        is_known: whether the processes have been sought at a fit with noise of their own, or where
            there are none.
        freedom: degrees of freedom of one residual that is not far off, by sensor; none before the
            noise is known.
        past: what is known before the first block; None if it is the first of all.

    """

    name: str
    states: tuple[BlockState, ...]
    slow_at_end: Array
    smoothness: Smoothness
    origin: float
    processes: dict[str, Process] = field(default_factory=dict)
    is_known: bool = False
    freedom: dict[str, float] = field(default_factory=dict)
    past: Past | None = None

    @classmethod
    def of_blocks(
        cls,
        model: Model,
        blocks: Iterable[Block],
        name: str = "log",
        starts: Sequence[TrajectoryState] = (),
        past: Past | None = None,
    ) -> "LogState":
        """Return a log of successive blocks, with smoothed joints.

        Without starts and a past it begins with the first block that has attitude samples.

        Raises:
            InputError: no block has attitude samples.

        """
        blocks, model = tuple(blocks), model.of_log(name)
        usable = (k for k, b in enumerate(blocks) if starts or past or len(b.samples.attitude))
        first = next(usable, None)
        if first is None:
            raise InputError("no attitude samples while the joints are known: none to start from")
        blocks = blocks[first:]
        smoothness, joints = smooth_joints(blocks, model.suite)
        gaps = [later.start - block.end for block, later in pairwise(blocks)]
        links = [*(Link.closed(model, gap) for gap in gaps), None]
        states = tuple(
            BlockState(
                block,
                motion,
                forces=model.no_forces(block.start, block.end),
                slow=np.zeros(0),
                start=start,
                link=link,
            )
            for block, motion, start, link in zip(
                blocks, joints, starts or len(blocks) * [None], links, strict=True
            )
        )
        return cls(name, states, np.zeros(0), smoothness, blocks[0].start, past=past)

    @classmethod
    def of(cls, model: Model, samples: Log | Iterable[Log], name: str = "log") -> "LogState":
        """Return a log of screened samples (or of chunks of them), cut into blocks.

        Raises:
            InputError: no block has attitude samples.

        """
        stream = [samples] if isinstance(samples, Log) else samples
        queue = BlockQueue.of(model.of_log(name).suite)
        return cls.of_blocks(model, blocks_of(queue, stream), name)

    def of_others(
        self, model: Model, blocks: Iterable[Block], starts: Sequence[TrajectoryState] = ()
    ) -> "LogState":
        """Return a log of other blocks with the same past; see `of_blocks`."""
        fresh = LogState.of_blocks(model, blocks, self.name, starts, past=self.past)
        fresh = replace(fresh, origin=self.origin)
        if not self.past:
            return fresh
        return fresh.with_processes(self.processes)

    def extended(self, model: Model, block: Block, start: TrajectoryState) -> "LogState":
        """Return the log with one more block; with a past, joints of the others stay as they are.

        The joints' motion is as smooth as that of all its blocks, or with a past of the last ones.
        """
        last, gap = self.states[-1], block.start - self.blocks[-1].end
        recent = (*self.blocks, block)[-RECENT if self.past else 0 :]
        smoothness, joints = smooth_joints(recent, model.suite, self.smoothness)
        motion, states = joints[-1], self.states
        if self.past is None:
            parts = zip(states, joints)
            states = tuple(replace(state, joints=each) for state, each in parts)
        elif not gap:
            motion = continued(motion, last.joints.coefficients[-ORDER:])
        forces = model.no_forces(block.start, block.end)
        return replace(
            self,
            states=(
                *states[:-1],
                replace(states[-1], link=Link.closed(model, gap)),
                BlockState(block, motion, forces, self.slow_at_end, start),
            ),
            smoothness=smoothness,
            is_known=False,
        )

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The samples of all blocks."""
        return tuple(map(attrgetter("block"), self.states))

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """Of each block behind which the log goes on."""
        return tuple([state.link for state in self.states if state.link is not None])

    @cached_property
    def starts(self) -> tuple[TrajectoryState, ...]:
        """Of each block: attitude, centre of mass and momentum at its start; none before a fit."""
        return tuple([state.start for state in self.states if state.start is not None])

    @cached_property
    def open(self) -> frozenset[int]:
        """Blocks at whose ends attitude, centre of mass, L and v may change by any amount."""
        return frozenset(k for k, link in enumerate(self.links) if link.is_open)

    def with_each(self, **values: Iterable[Any]) -> "LogState":
        """Return the log with other values of some attributes of each block's `BlockState`."""
        rows = zip(self.states, *values.values(), strict=True)
        states = (replace(state, **dict(zip(values, row))) for state, *row in rows)
        return replace(self, states=tuple(states))

    def with_links(self, links: Iterable[Link]) -> "LogState":
        """Return the log with other links behind its blocks."""
        return self.with_each(link=(link for _, link in zip_longest(self.states, links)))

    def opened(self, ends: Collection[int], spans: Mapping[int, float] | None = None) -> "LogState":
        """Return the log open at the ends of some blocks, and closed at all others.

        What begins anew behind a gap does not change there.

        Args:
            ends: numbers of the blocks.
            spans: of some of them; see `Link.span`.

        """
        spans = spans or {}
        return self.with_links(
            replace(each, is_open=k in ends and not each.gap, span=spans.get(k, 1.0))
            for k, each in enumerate(self.links)
        )

    def step(self, k: int) -> float:
        """Return the time [s] from the start of block k to that of the next, or to its own end."""
        link = self.states[k].link
        return self.blocks[k].length + (link.gap if link else 0.0)

    def change(self, k: int) -> str:
        """Return the name of the change at the end of block k, if it is an unknown of its own."""
        return f"{CHANGE}{self.blocks[k].end} s|{self.name}"

    def link_sigma(self, model: Model, k: int) -> Array:
        """Return σ (12,) of a change of attitude, centre of mass, L and v at the end of block k."""
        return _sigma(model, self.links[k], CLOSED)

    def link_cost(self, model: Model, k: int, change: Array) -> float:
        """Return χ² of a change (12,) at the end of block k.

        A closed end would have a χ² that hides that of all samples where a step leaves a change of
        second order: here it costs 2 λᵀu + |u/σ|² with the pull λ of the end and a larger σ
        (augmented Lagrangian; Nocedal and Wright 2006, ch. 17.3).
        """
        link = self.links[k]
        judged = _sigma(model, link, JUDGED)
        if link.is_open:
            return float(np.sum((change / judged) ** 2))
        # |(u − a)/σ|² + λᵀ(2u − a), with a = λ σ² of a closed end, where the pull holds it
        aim = link.pull * self.link_sigma(model, k) ** 2
        square = float(np.sum(((change - aim) / judged) ** 2))
        return square + float(link.pull @ (2 * change - aim))

    @property
    def changes(self) -> list[float]:
        """Times of changes [s]: of an open end, or the middle of a block of which both are open."""
        times, ends = list[float](), sorted(self.open, reverse=True)
        while ends:
            first = last = ends.pop()
            if ends and ends[-1] == first + 1:
                last = ends.pop()
            times.append(float(self.blocks[first].end + self.blocks[last].end) / 2)
        return times

    @property
    def thrust(self) -> Samples:
        """The log of thrust of all blocks."""
        parts = [block.samples.thrust for block in self.blocks]
        time, first = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
        return Samples(time, np.concatenate([part.value for part in parts])[first])

    @property
    def has_thrust(self) -> bool:
        """Whether thrusters fire."""
        return any(block.samples.has_thrust for block in self.blocks)

    @property
    def noise_factors(self) -> dict[str, float]:
        """Size of the noise inside of a block, as factors of the sensors' declared σ."""
        factors = dict.fromkeys(self.freedom, 1.0)
        length = self.blocks[-1].end - self.blocks[0].start
        return factors | {n: float(np.sqrt(p.within(length))) for n, p in self.processes.items()}

    @cached_property
    def slow_places(self) -> dict[str, slice]:
        """Places of sensors with slow noise in `BlockState.slow`."""
        return places_of({n: p.size for n, p in self.processes.items() if p.slow})

    @cached_property
    def slow_size(self) -> int:
        """Number of entries of slow noise."""
        return sum(process.size for process in self.processes.values())

    @property
    def slow_sigma(self) -> Array:
        """(s,) their σ."""
        return np.array([p.slow**0.5 for p in self.processes.values() for _ in range(p.size)])

    def slow_at(self, k: int) -> Array:
        """Return slow noise (2, s) at start and end of block k."""
        is_last = k + 1 == len(self.states)
        end = self.slow_at_end if is_last else self.states[k + 1].slow
        return np.stack([self.states[k].slow, end])

    def with_processes(self, processes: Mapping[str, Process]) -> "LogState":
        """Return the log with other noise; slow noise that it has already keeps its values."""
        made, before = replace(self, processes=dict(processes)), self.slow_places

        def renewed(slow: Array) -> Array:
            parts = [
                slow[before[n]] if n in before else np.zeros(place.stop - place.start)
                for n, place in made.slow_places.items()
            ]
            return np.concatenate([np.empty(0), *parts])

        made = made.with_each(slow=[renewed(each.slow) for each in self.states])
        return replace(made, slow_at_end=renewed(self.slow_at_end))

    def part(self, first: int, end: int) -> "LogState":
        """Return the blocks from `first` up to `end`, with the link behind the last of them."""
        slow = self.states[end].slow if end < len(self.states) else self.slow_at_end
        states, past = self.states[first:end], None if first else self.past
        return replace(self, states=states, slow_at_end=slow, past=past)

    def followed(self, model: Model, other: "LogState") -> "LogState":
        """Return the blocks and then those of a log that goes on at their end."""
        *states, last = self.states
        last = replace(last, link=last.link or Link.closed(model))
        states = [*states, last, *other.states]
        return replace(other, states=tuple(states), past=self.past, origin=self.origin)

    def whitened(self, k: int, sensor: str, rest: Array) -> Array:
        """Return white residuals (M, d) of those (M, d) of a sensor in block k."""
        return self.rows_of(k, {sensor: rest})[sensor][: len(rest)]

    def rows_of(self, k: int, rest: Mapping[str, Array]) -> dict[str, Array]:
        """Return white residuals of those (M, d) in block k, and of the links of slow noise."""
        slow, places, rows = self.slow_at(k), self.slow_places, {}
        for name, white in self.whitenings(k, rest).items():
            own = rest.get(name, np.zeros((0, white.process.channels)))
            rows[name] = white.of(own, *slow[:, places.get(name, slice(0))])
        return rows

    def whitenings(self, k: int, rest: Mapping[str, Array]) -> dict[str, Innovations]:
        """Return what makes the residuals of block k white, and links slow noise."""
        whitenings = {name: self.whitening(k, name, len(each)) for name, each in rest.items()}
        for name in self.slow_places:
            if name not in rest:
                whitenings[name] = self.whitening(k, name, 0)
        return whitenings

    def whitening(self, k: int, sensor: str, count: int) -> Innovations:
        """Return what makes the residuals of a sensor, or of a white force, in block k white."""
        state = self.states[k]
        block = state.block
        if sensor in SENSORS:
            times = block.samples[sensor].time if count else np.zeros(0)
        else:  # of a force: the middles of its pieces
            times = block.start + (np.arange(count) + 0.5) * block.length / max(count, 1)
        weights = state.weights.get(sensor, np.ones(count))[:count]
        until_next = block.end - block.start + (state.link.gap if state.link else 0.0)
        end = block.start + until_next
        process = self.processes.get(sensor, DECLARED)
        return Innovations(times, block.start, end, weights, process)


def farthest(model: Model) -> Array:
    """Return σ (12,) of a change of attitude, centre of mass, L and v at an open end."""
    return _sizes(model, *FARTHEST)


def _sigma(model: Model, link: Link, closed: float) -> Array:
    """Return σ (12,) of a change at a link; a closed one has a share of its sizes, and its push."""
    if link.is_open or link.gap:
        return link.span * farthest(model)
    return np.hypot(_sizes(model, closed, closed, closed), link.push)


def _sizes(model: Model, turn: float, place: float, speed: float) -> Array:
    return np.repeat([turn, place, speed * model.L_sigma, speed], 3)
