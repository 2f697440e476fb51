"""Blocks: the samples of a log, cut into pieces of about a second, as they arrive."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cpid_drake.array import Array
from cpid_drake.logs.log import THRUST, Log, concatenated
from cpid_drake.logs.screening import LONGEST_DELAY
from cpid_drake.sensors.suite import SensorSuite

SHORTEST_BLOCK = 1.0
"""Length of a block [s]; longer ones if the encoders are slow."""

SAMPLES_PER_BLOCK = 20
"""Smallest number of encoder samples in a block: they show how smooth the joints move."""

PARTS = 3
"""A block beside a change is cut into so many parts, so that a change inside has an end near it."""

FEWEST_SAMPLES = 4
"""Encoder samples between two gaps that show positions, rates and accelerations of the joints."""

LATE = 2
"""A block whose encoders have been silent for so many usual steps at its end may precede a gap."""

_STAMP = 1e-7  # rounding error of a stamp [s]


@dataclass(frozen=True, eq=False)
class Block:
    """The samples of one block, with start < time ≤ end [s].

    Attributes:
        start, end: [s].
        samples: the samples, and the thrust.

    """

    start: float
    end: float
    samples: Log

    @property
    def length(self) -> float:
        """Length of the block [s]."""
        return self.end - self.start

    def part(self, start: float, end: float) -> "Block":
        """Return a part of the block."""
        return Block(start, end, after(self.samples, start, end))

    def cut(self) -> list["Block"]:
        """Return `PARTS` equal parts."""
        edges = [*np.linspace(self.start, self.end, PARTS, endpoint=False).tolist(), self.end]
        return [self.part(a, b) for a, b in pairwise(edges)]


def after(measurements: Log, start: float, end: float) -> Log:
    """Return the samples with start < time ≤ end [s], and the thrust that may act then.

    The stamps must increase.
    """
    parts = measurements.thrust_between(start - LONGEST_DELAY, end + LONGEST_DELAY)
    for name, samples in measurements.samples.items():
        if name == THRUST:
            continue
        first, last = np.searchsorted(samples.time, [start, end], side="right")
        parts[name] = samples.where(slice(first, last))
    return Log(measurements.joint_names, parts)


@dataclass(frozen=True, eq=False)
class BlockQueue:
    """Cuts samples into blocks.

    Where the encoders have no sample for longer than a block, nothing is known of the joints, and
    so of the base: there are no blocks in such a gap, and they begin anew behind it.

    Attributes:
        length: of a block [s].
        edge: end of the last complete block [s]; NaN before the first sample, and in a gap.
        waiting: samples after the edge.

    """

    length: float
    edge: float = np.nan
    waiting: Log | None = None

    @classmethod
    def of(cls, suite: SensorSuite) -> "BlockQueue":
        """Return the queue for a suite's rates."""
        encoders = suite.encoders  # a platform without joints has none
        return cls(max(SHORTEST_BLOCK, SAMPLES_PER_BLOCK / encoders.rate if encoders else 0.0))

    @property
    def next_edge(self) -> float:
        """End of the block that is not complete [s]; NaN before the first encoder sample."""
        return self.edge + self.length

    def added(self, measurements: Log, until: float) -> tuple["BlockQueue", list[Block]]:
        """Return the queue after adding samples, and the blocks that are complete.

        Args:
            measurements: later samples than those before.
            until: time up to which all samples have been added [s].

        """
        waiting = measurements
        if self.waiting is not None:
            waiting = concatenated([self.waiting, measurements])
        length = self._length_for(waiting)
        if length > self.length:
            return replace(self, length=length).added(measurements, until)
        times, blocks = waiting.encoders.time, list[Block]()
        edge, is_first = self.edge, np.isnan(self.edge)
        while True:
            if is_first:  # at the next encoder sample: earlier samples are not needed
                following = np.searchsorted(times, -np.inf if np.isnan(edge) else edge, "right")
                if following == len(times):
                    return BlockQueue(self.length, waiting=after(waiting, until, np.inf)), blocks
                edge = float(times[following]) - _STAMP
            # The first block contains both its first and its last sample.
            end = edge + self.length + (2 * _STAMP if is_first else 0.0)
            last, is_gap = self._encoders_about(times, edge, end, until)
            if edge + self.length > until + 2 * _STAMP or is_gap is None:
                break
            if is_gap:
                end = last + _STAMP if last > edge else edge
            block = Block(edge, end, after(waiting, edge, end))
            if len(block.samples.encoders) >= (FEWEST_SAMPLES if is_first and is_gap else 1):
                blocks.append(block)
            edge, is_first = end, is_gap
        begun = np.nan if is_first else edge
        return BlockQueue(self.length, begun, after(waiting, edge, np.inf)), blocks

    def _encoders_about(
        self, times: Array, edge: float, end: float, until: float
    ) -> tuple[float, bool | None]:
        """Return the time of the last encoder sample in a block [s], and whether a gap follows.

        That is None as long as the samples until now do not show it.
        """
        following = int(np.searchsorted(times, end, side="right"))
        last = max(float(times[following - 1]), edge) if following else edge
        if end - last <= LATE * self.length / SAMPLES_PER_BLOCK:
            return last, False
        if following < len(times):
            return last, bool(times[following] - last > self.length)
        return last, True if until - last > self.length else None

    def _length_for(self, waiting: Log) -> float:
        """Return the length of blocks [s], longer if a log's encoders are slower than the suite's.

        It is determined by the first samples only.
        """
        times = waiting.encoders.time
        if not np.isnan(self.edge) or len(times) < 3:
            return self.length
        needed = SAMPLES_PER_BLOCK * float(np.median(np.diff(times[:SAMPLES_PER_BLOCK])))
        return needed if needed > self.length + SAMPLES_PER_BLOCK * _STAMP else self.length

    def finished(self) -> list[Block]:
        """Return the last, incomplete blocks, if there are any encoder samples."""
        if self.waiting is None or not len(self.waiting.encoders):
            return []
        times, is_first = self.waiting.encoders.time, np.isnan(self.edge)
        start, end = float(times[0]) - _STAMP if is_first else self.edge, float(times[-1]) + _STAMP
        is_short = is_first and len(times) < FEWEST_SAMPLES
        if is_short or end - start < 1e-3 * self.length:
            return []
        return [Block(start, end, after(self.waiting, start, end))]


def blocks_of(queue: BlockQueue, stream: Iterable[Log]) -> Iterator[Block]:
    """Yield the blocks of a stream."""
    for chunk in stream:
        queue, blocks = queue.added(chunk, chunk.last_time)
        yield from blocks
    yield from queue.finished()
