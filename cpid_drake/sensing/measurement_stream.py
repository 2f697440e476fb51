"""Measurements of any length as a stream of chunks, which can be read again from the beginning."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Protocol

import numpy as np

from cpid_drake.sensing.measurements import THRUST, Measurements, Samples

CHUNK_SECONDS = 60.0
"""Default length of a chunk [s]: long against its overhead, short against the memory."""


class MeasurementStream(Protocol):
    """The samples of a log in order of time, a chunk at a time.

    Every chunk holds the samples of all sensors in one interval of time, and consecutive chunks do
    not overlap. Every iteration starts again at the beginning, so the memory does not grow with the
    length of the log.

    Attributes:
        joint_names: the joints, in the order of columns of joint sensors.

    """

    @property
    def joint_names(self) -> tuple[str, ...]: ...  # noqa: D102

    def __iter__(self) -> Iterator[Measurements]: ...


@dataclass(frozen=True, eq=False)
class Stream:
    """A stream whose chunks a function yields.

    Attributes:
        joint_names: the joints.
        read: returns an iterator over all chunks; it is called for every iteration.

    """

    joint_names: tuple[str, ...]
    read: Callable[[], Iterator[Measurements]]

    def __iter__(self) -> Iterator[Measurements]:
        return self.read()


def stream_of(measurements: Measurements, seconds: float = CHUNK_SECONDS) -> Stream:
    """Return measurements in memory as a stream; see `chunks`."""
    return Stream(measurements.joint_names, lambda: chunks(measurements, seconds))


def in_one_chunk(measurements: Measurements) -> Stream:
    """Return measurements in memory, of any times, as a stream of a single chunk."""
    return Stream(measurements.joint_names, lambda: iter([measurements]))


def chunks(measurements: Measurements, seconds: float = CHUNK_SECONDS) -> Iterator[Measurements]:
    """Yield measurements in chunks of `seconds`, from the first sample on.

    Chunks without samples are left out. The arrays are not copied.

    Args:
        measurements: samples of increasing times.
        seconds: length of a chunk [s].

    """
    return rechunked([measurements], seconds)


def rechunked(
    pieces: Iterable[Measurements], seconds: float = CHUNK_SECONDS
) -> Iterator[Measurements]:
    """Yield consecutive pieces of any length in chunks of `seconds`; see `chunks`."""
    start, pending = None, None
    for piece in pieces:
        pending = piece if pending is None else joined([pending, piece])
        interval = time_interval(pending)
        if interval is None:
            continue
        start = interval[0] if start is None else start
        # The next piece can hold further samples of the last interval, but not of earlier ones.
        complete = start + seconds * np.floor((interval[1] - start) / seconds)
        yield from _cut(pending, start, seconds, complete)
        pending = pending.between(complete, np.inf)
    if pending is not None and start is not None and time_interval(pending) is not None:
        yield pending


def _cut(
    measurements: Measurements, start: float, seconds: float, end: float
) -> Iterator[Measurements]:
    """Yield the samples before `end` in intervals of `seconds` that are counted from `start`."""
    ends = {end}
    for _, samples in measurements.items():
        intervals = np.unique(np.floor((samples.time[samples.time < end] - start) / seconds))
        ends.update((start + seconds * (intervals + 1)).tolist())
    done = dict.fromkeys((name for name, _ in measurements.items()), 0)
    since = -np.inf
    for limit in sorted(ends):
        part = {}
        for name, samples in measurements.items():
            first = done[name]
            done[name] = int(np.searchsorted(samples.time, limit))
            part[name] = samples.where(slice(first, done[name]))
        last = np.nextafter(limit, -np.inf)
        chunk = measurements.updated(part | measurements.thrust_between(since, last))
        since = limit
        if time_interval(chunk) is not None:
            yield chunk


def with_margins(
    chunks: Iterable[Measurements], margin: float
) -> Iterator[tuple[Measurements, float, float]]:
    """Yield every chunk with samples on both sides of it.

    Args:
        chunks: consecutive chunks, none of which is empty.
        margin: time from the chunk up to which samples of its neighbours are added [s].

    Yields:
        The samples, the time of the first sample in the chunk, and that of the first one behind it
        [s], which is infinite for the last chunk.

    """
    before: Measurements | None = None
    current: Measurements | None = None
    for following in chain(chunks, [None]):
        interval = None if current is None else time_interval(current)
        if current is not None and interval is not None:
            start, end = interval
            pieces, behind = [current], np.inf
            if before is not None:
                pieces.insert(0, before.between(start - margin, np.inf))
            if following is not None:
                pieces.append(following.between(-np.inf, end + margin))
                behind = (time_interval(following) or (np.inf, np.inf))[0]
            yield joined(pieces), start, behind
        before, current = current, following


def joined(pieces: Iterable[Measurements]) -> Measurements:
    """Return consecutive pieces, at least one, as one.

    Raises:
        ValueError: there are no pieces.

    """
    parts = list(pieces)
    if not parts:
        raise ValueError("there are no pieces to join")
    if len(parts) == 1:
        return parts[0]
    samples = {}
    for name in (*(name for name, _ in parts[0].items()), THRUST):
        each = [part[name] for part in parts if len(part[name])]
        if len(each) == 1:
            samples[name] = each[0]
        elif each:
            samples[name] = Samples(
                np.concatenate([s.time for s in each]), np.concatenate([s.value for s in each])
            )
    return Measurements(parts[0].joint_names, samples)


def time_interval(measurements: Measurements) -> tuple[float, float] | None:
    """Return the times of the first and the last sample of all sensors [s]; None without samples.

    The times of each sensor must increase.
    """
    times = [samples.time for _, samples in measurements.items() if len(samples)]
    if not times:
        return None
    return float(min(time[0] for time in times)), float(max(time[-1] for time in times))


def head_of(stream: MeasurementStream, most: int) -> tuple[Measurements | None, bool]:
    """Return the first chunks of a stream, and whether these are all of them.

    Args:
        stream: the stream.
        most: chunks are read until a sensor has more samples than this.

    Returns:
        The samples, None if there are none; and whether the stream has no others.

    """
    parts: list[Measurements] = []
    counts: Counter[str] = Counter()
    for chunk in stream:
        parts.append(chunk)
        for name, samples in chunk.items():
            counts[name] += len(samples)
        if max(counts.values()) > most:
            return joined(parts), False
    return joined(parts) if parts else None, True


class FromZero:
    """A stream with a time that starts at zero: seconds since 1970 would lose digits.

    Args:
        stream: the stream.
        zero: time of its first sample [s].

    Attributes:
        interval: times of the first and the last sample that were read, before the change [s].

    """

    def __init__(self, stream: MeasurementStream, zero: float) -> None:
        self._stream, self.joint_names = stream, stream.joint_names
        self.interval = (zero, zero)

    def __iter__(self) -> Iterator[Measurements]:
        zero, last = self.interval
        for chunk in self._stream:
            _, end = time_interval(chunk) or self.interval
            last = max(last, end)
            self.interval = zero, last
            yield moved(chunk, zero)


def moved(measurements: Measurements, zero: float) -> Measurements:
    """Return samples whose time is counted from `zero` [s]."""
    everything = {**dict(measurements.items()), **measurements.samples}
    return measurements.updated(
        {name: Samples(s.time - zero, s.value) for name, s in everything.items()}
    )
