"""Finds samples with wrong stamps: out of order, frozen, or from a clock that was wrong."""

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

LONGEST_GAP = 3600.0
"""Longest time between two samples of one log [s]; with a longer one, a clock was wrong."""

LONGEST_SILENCE = 1.0
"""A stamp later than all others by more than this time [s] must be confirmed by other stamps; it is
longer than the delay between sensors of one spacecraft."""

SILENT_INTERVALS = 5.0
"""Lower limit of the silence in sample intervals of the sensor: a slow sensor misses a few samples
without an error of its clock."""

CONFIRMING = 3
"""Number of different stamps that confirm each other: a damaged one, or two, cannot end a log."""

ONE_MESSAGE = 1e-4
"""Stamps that differ by less than this time [s] may come from one message with one damaged stamp,
and do not confirm each other: the sample interval at 1000 Hz is ten times as long."""

_MOST_UNCONFIRMED = 8


def usable_stamps(
    stamps: Mapping[str, NDArray[np.float64]],
    recent: Mapping[str, NDArray[np.float64]],
    waiting: NDArray[np.float64],
) -> tuple[dict[str, NDArray[np.intp]], NDArray[np.float64]]:
    """Return the indices of samples whose stamps are usable, by sensor.

    - A stamp that is later than those of all sensors by more than a silence must be confirmed: with
      it, at least `CONFIRMING` different stamps of any sensors lie within a silence of each
      other. Without memory, this holds for all stamps but the largest group. A single stamp in the
      far future therefore does not make later samples unusable.
    - Stamps more than `LONGEST_GAP` from most others of the sensor are unusable.
    - Of the others, as few as possible are removed so that the stamps increase, and are later than
      the latest accepted one. Of samples with the same stamp the first is kept.

    Args:
        stamps: finite stamps of each sensor (N,), in order of arrival [s].
        recent: the latest accepted stamps of each sensor, at least one, if there are any [s].
        waiting: earlier stamps that wait for confirmation [s].

    Returns:
        The indices, ascending, by sensor, and the stamps that wait for confirmation.

    """
    newest = max((float(time[-1]) for time in recent.values()), default=-np.inf)
    indices, unconfirmed = {}, [waiting]
    pool = None
    for name, time in stamps.items():
        last = float(recent[name][-1]) if name in recent else -np.inf
        steps = _steps(time)
        if not time.size or (
            last < time[0] <= newest + LONGEST_SILENCE
            and (steps > 0).all()
            and steps.max(initial=0.0) <= LONGEST_SILENCE
        ):
            indices[name] = np.arange(time.size)
            continue
        if pool is None:
            known = [newest] if np.isfinite(newest) else []
            pool = np.unique(np.concatenate([*stamps.values(), waiting, known]))
        history = np.concatenate([recent[name], time]) if name in recent else time
        silence = _silence(history)
        late = _late(time, pool, newest, silence)
        unconfirmed.append(time[late])
        index = np.flatnonzero(~late & (time > last))
        index = index[_together(time[index], LONGEST_GAP)]
        indices[name] = index[_increasing(time[index])]
    return indices, np.concatenate(unconfirmed)[-_MOST_UNCONFIRMED:]


def _steps(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the steps of the stamps [s]; between absurd stamps a step is infinite."""
    with np.errstate(over="ignore"):
        return np.diff(time)


def _silence(time: NDArray[np.float64]) -> float:
    """Return the longest silence of a sensor that needs no confirmation [s]."""
    steps = _steps(time)
    steps = steps[steps > 0]
    usual = float(np.median(steps)) if steps.size else 0.0
    return max(LONGEST_SILENCE, SILENT_INTERVALS * usual)


def _late(
    time: NDArray[np.float64],
    pool: NDArray[np.float64],
    newest: float,
    silence: float,
) -> NDArray[np.bool_]:
    """Return which stamps are too late and unconfirmed, by the stamps `pool` of all sensors."""
    gaps = _steps(pool)
    group = np.append(0, np.cumsum(gaps > silence))
    count = np.bincount(group, np.append(True, gaps > ONE_MESSAGE))
    confirmed = count >= CONFIRMING
    if np.isfinite(newest):
        confirmed[: group[np.searchsorted(pool, newest)] + 1] = True
    else:
        confirmed[count.argmax()] = True
    return np.asarray(~confirmed[group[np.searchsorted(pool, time)]])


def _together(time: NDArray[np.float64], longest_gap: float) -> NDArray[np.intp]:
    """Return the indices, ascending, of the largest group of stamps without a too long gap."""
    order = np.argsort(time)
    gaps = np.flatnonzero(time[order][1:] > time[order][:-1] + longest_gap)
    ends = np.concatenate([[0], gaps + 1, [time.size]])
    k = int(np.diff(ends).argmax())
    return np.sort(order[ends[k] : ends[k + 1]])


def _increasing(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the longest strictly increasing subsequence of the stamps.

    Of several longest ones, return the first.
    """
    if (time[1:] > time[:-1]).all():
        return np.arange(time.size)
    # The loop goes from the last stamp to the first. For each length of a subsequence, the lists
    # contain minus its largest possible first stamp, and that stamp's index. `following` links each
    # stamp to its successor.
    first: list[float] = []
    start: list[int] = []
    following = np.full(time.size, -1)
    for k in range(time.size - 1, -1, -1):
        length = bisect_left(first, -time[k])
        if length:
            following[k] = start[length - 1]
        first[length : length + 1], start[length : length + 1] = [-time[k]], [k]
    series = [start[-1]]
    while following[series[-1]] >= 0:
        series.append(following[series[-1]])
    return np.array(series)
