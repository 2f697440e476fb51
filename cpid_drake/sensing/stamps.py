"""Finds samples with wrong stamps: out of order, frozen, or from a clock that was wrong."""

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.screening_limits import ScreeningLimits, ScreeningMemory

_MOST_UNCONFIRMED = 8


def usable_stamps(
    stamps: Mapping[str, NDArray[np.float64]], memory: ScreeningMemory, limits: ScreeningLimits
) -> tuple[dict[str, NDArray[np.intp]], NDArray[np.float64]]:
    """Return the indices of samples whose stamps are usable, by sensor.

    - A stamp that is later than those of all sensors by more than a silence must be confirmed: with
      it, at least `confirming_stamps` different stamps of any sensors lie within a silence of each
      other. Without memory, this holds for all stamps but the largest group. A single stamp in the
      far future therefore does not make later samples unusable.
    - Stamps more than `longest_gap` from most others of the sensor are unusable.
    - Of the others, as few as possible are removed so that the stamps increase, and are later than
      the latest accepted one. Of samples with the same stamp the first is kept.

    Args:
        stamps: finite stamps of each sensor (N,), in order of arrival [s].
        memory: what was accepted before.
        limits: limits of screening.

    Returns:
        The indices, ascending, by sensor, and the stamps that wait for confirmation.

    """
    newest = memory.newest
    indices, unconfirmed = {}, [memory.unconfirmed]
    pool = None
    for name, time in stamps.items():
        seen = memory.sensors.get(name)
        last = seen.last if seen else -np.inf
        steps = _steps(time)
        if not time.size or (
            last < time[0] <= newest + limits.longest_silence
            and (steps > 0).all()
            and steps.max(initial=0.0) <= limits.longest_silence
        ):
            indices[name] = np.arange(time.size)
            continue
        if pool is None:
            known = [newest] if np.isfinite(newest) else []
            pool = np.unique(np.concatenate([*stamps.values(), memory.unconfirmed, known]))
        history = np.concatenate([seen.recent.time, time]) if seen else time
        silence = _silence(history, limits)
        late = _late(time, pool, newest, silence, limits)
        unconfirmed.append(time[late])
        index = np.flatnonzero(~late & (time > last))
        index = index[_together(time[index], limits.longest_gap)]
        indices[name] = index[_increasing(time[index])]
    return indices, np.concatenate(unconfirmed)[-_MOST_UNCONFIRMED:]


def _steps(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the steps of the stamps [s]; between absurd stamps a step is infinite."""
    with np.errstate(over="ignore"):
        return np.diff(time)


def _silence(time: NDArray[np.float64], limits: ScreeningLimits) -> float:
    """Return the longest silence of a sensor that needs no confirmation [s]."""
    steps = _steps(time)
    steps = steps[steps > 0]
    usual = float(np.median(steps)) if steps.size else 0.0
    return max(limits.longest_silence, limits.silent_intervals * usual)


def _late(
    time: NDArray[np.float64],
    pool: NDArray[np.float64],
    newest: float,
    silence: float,
    limits: ScreeningLimits,
) -> NDArray[np.bool_]:
    """Return which stamps are too late and unconfirmed, by the stamps `pool` of all sensors."""
    gaps = _steps(pool)
    group = np.append(0, np.cumsum(gaps > silence))
    count = np.bincount(group, np.append(True, gaps > limits.one_message))
    confirmed = count >= limits.confirming_stamps
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
