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
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.joint_samples import Smoothness
from cpid_drake.estimation.joints import continued, smooth_joints
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.links import Link
from cpid_drake.estimation.log_noise import LogNoise
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.process import Process
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples

RECENT = 3
"""Behind a past, so many of the last blocks show how smooth the joints of one more are."""

CHANGE = "change at "
"""Beginning of the name of an unknown change of momentum; see `LogState.change`."""


@dataclass(frozen=True, eq=False)
class LogState:
    """A log, and the present values of the unknowns of its blocks.

    Attributes:
        name: of the log.
        states: of successive blocks.
        slow_at_end: (s,) slow noise of sensors at the end of the last block; see `BlockState.slow`.
        smoothness: of the joint motion.
        origin: time from which on zeros of joints and clocks drift [s].
        noise: of its sensors and white forces.
        past: what is known before the first block; None if it is the first of all.

    """

    name: str
    states: tuple[BlockState, ...]
    slow_at_end: Array
    smoothness: Smoothness
    origin: float
    noise: LogNoise = field(default_factory=LogNoise)
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
        return fresh.with_processes(self.noise.processes)

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
            noise=replace(self.noise, converged=False),
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

    def interval(self, k: int) -> float:
        """Return the time [s] from the start of block k to that of the next, or to its own end."""
        link = self.states[k].link
        return self.blocks[k].length + (link.gap if link else 0.0)

    def change(self, k: int) -> str:
        """Return the name of the change at the end of block k, if it is an unknown of its own."""
        return f"{CHANGE}{self.blocks[k].end} s|{self.name}"

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
        """Size of the noise of the sensors whose residuals showed it; see `LogNoise.factors`."""
        return self.noise.factors(self.blocks[-1].end - self.blocks[0].start)

    def slow_at(self, k: int) -> Array:
        """Return slow noise (2, s) at start and end of block k."""
        is_last = k + 1 == len(self.states)
        end = self.slow_at_end if is_last else self.states[k + 1].slow
        return np.stack([self.states[k].slow, end])

    def with_processes(self, processes: Mapping[str, Process]) -> "LogState":
        """Return the log with other noise; slow noise that it has already keeps its values."""
        noise, before = replace(self.noise, processes=dict(processes)), self.noise.slow_places

        def renewed(slow: Array) -> Array:
            parts = [
                slow[before[n]] if n in before else np.zeros(place.stop - place.start)
                for n, place in noise.slow_places.items()
            ]
            return np.concatenate([np.empty(0), *parts])

        made = self.with_each(slow=[renewed(each.slow) for each in self.states])
        return replace(made, noise=noise, slow_at_end=renewed(self.slow_at_end))

    def with_noise(self, **values: Any) -> "LogState":
        """Return the log with other values of some attributes of its `LogNoise`."""
        return replace(self, noise=replace(self.noise, **values))

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
