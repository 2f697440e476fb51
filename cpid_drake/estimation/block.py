"""Blocks: the samples of a log, cut into pieces of about a second, as they arrive."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cpid_drake.logs.log import THRUST, Log, concatenated
from cpid_drake.sensors.suite import SensorSuite

SHORTEST_BLOCK = 1.0
"""Length of a block [s]; longer ones if the encoders are slow."""

SAMPLES_PER_BLOCK = 20
"""Smallest number of encoder samples in a block: they show how smooth the joints move."""

PARTS = 3
"""A block beside a change is cut into so many parts, so that a change inside has an end near it."""

LONGEST_DELAY = 1.0
"""Longest delay of a sensor, or of the log of thrust, that can be modelled [s]."""

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

    Attributes:
        length: of a block [s].
        edge: end of the last complete block [s]; NaN before the first sample.
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
        if np.isnan(self.edge) and not len(waiting.encoders):
            # The first block starts at the first encoder sample: earlier samples are not needed.
            return replace(self, waiting=after(waiting, until, np.inf)), []
        length = self._length_for(waiting)
        if length > self.length:
            return replace(self, length=length).added(measurements, until)
        edge = self._first_edge(waiting)
        blocks: list[Block] = []
        while edge + self.length + 2 * _STAMP <= until + 4 * _STAMP:
            # The first block contains both its first and its last sample.
            is_first = np.isnan(self.edge) and not blocks
            end = edge + self.length + (2 * _STAMP if is_first else 0.0)
            end += self._gap(waiting, end, until)
            blocks.append(Block(edge, end, after(waiting, edge, end)))
            edge = end
        if not blocks:
            return replace(self, waiting=waiting), []
        return BlockQueue(self.length, edge, after(waiting, edge, np.inf)), blocks

    def _gap(self, waiting: Log, end: float, until: float) -> float:
        """Return the time [s] by which a block without encoder samples is longer than others.

        A gap in the samples is one block, however long it is.
        """
        times = waiting.encoders.time
        following = int(np.searchsorted(times, end, side="right"))
        if following and times[following - 1] > end - self.length:
            return 0.0
        gap_end = min(until, times[following]) if following < len(times) else until
        return self.length * max(np.floor((gap_end - end) / self.length), 0.0)

    def _length_for(self, waiting: Log) -> float:
        """Return the length of blocks [s], longer if a log's encoders are slower than the suite's.

        It is determined by the first samples only.
        """
        times = waiting.encoders.time
        if not np.isnan(self.edge) or len(times) < 3:
            return self.length
        needed = SAMPLES_PER_BLOCK * float(np.median(np.diff(times[:SAMPLES_PER_BLOCK])))
        return needed if needed > self.length + SAMPLES_PER_BLOCK * _STAMP else self.length

    def _first_edge(self, waiting: Log) -> float:
        if not np.isnan(self.edge):
            return self.edge
        return float(waiting.encoders.time[0]) - _STAMP

    def finished(self) -> list[Block]:
        """Return the last, incomplete blocks, if there are any encoder samples."""
        if self.waiting is None or not len(self.waiting.encoders):
            return []
        start = self._first_edge(self.waiting)
        end = float(self.waiting.encoders.time[-1]) + _STAMP
        if end - start < 1e-3 * self.length:
            return []
        return [Block(start, end, after(self.waiting, start, end))]


def blocks_of(queue: BlockQueue, stream: Iterable[Log]) -> Iterator[Block]:
    """Yield the blocks of a stream."""
    for chunk in stream:
        queue, blocks = queue.added(chunk, chunk.last_time)
        yield from blocks
    yield from queue.finished()
