"""Finds spikes: single samples that deviate from the motion of the samples around them."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.screening_limits import ScreeningLimits

_HIGHEST_ORDER = 4


def rough_orders(
    time: NDArray[np.float64], value: NDArray[np.float64]
) -> Iterator[NDArray[np.float64]]:
    """Yield the roughness of each 2, 3, … successive samples.

    The roughness of n + 1 samples is their divided difference of order n, which is zero if they lie
    on a polynomial of degree n − 1, divided by that of values ±1 with alternating signs. It is a
    weighted mean of the samples' errors: errors up to ε cause a roughness up to ε, for any stamps.

    Args:
        time: (N,) increasing stamps [s].
        value: (N, width) samples.

    Yields:
        An array (N − n, width) for each order n from 1; row k belongs to the samples k to k + n.

    """
    signs = np.ones((time.size, 1))
    signs[1::2] = -1.0
    table = np.concatenate([value, signs], axis=1)
    for order in range(1, time.size):
        table = (table[1:] - table[:-1]) / (time[order:] - time[:-order])[:, None]
        yield np.abs(table[:, :-1] / table[:, -1:])


def roughness(
    time: NDArray[np.float64], value: NDArray[np.float64], sigma: float, enough: float
) -> NDArray[np.float64]:
    """Return how far each sample is from all smooth motions through its neighbours, in σ.

    The roughness of a sample is the smallest roughness of the 2 to 5 successive samples that
    contain it. A spike makes all of these rough. A step, a kink or a jerk of the motion does not:
    each sample continues the motion on one of its sides.

    Args:
        time: (N,) increasing stamps [s].
        value: (N, width) samples.
        sigma: σ of every entry.
        enough: if no sample is rougher than this value, higher orders are left out.

    Returns:
        (N, width) roughness; zero if there are fewer than three samples.

    """
    N = time.size
    if N < 3:
        return np.zeros_like(value)
    least = np.full(value.shape, np.inf)
    for order, rough in enumerate(islice(rough_orders(time, value), _HIGHEST_ORDER), start=1):
        # At the ends of five samples a spike has a small weight, 1/16: only the middle is used.
        for place in (2,) if order == _HIGHEST_ORDER else range(order + 1):
            part = least[place : place + N - order]
            np.minimum(part, rough, out=part)
        if least.max() <= enough * sigma:
            break
    least /= sigma
    return least


def find_spikes(
    time: NDArray[np.float64],
    value: NDArray[np.float64],
    sigma: float,
    limits: ScreeningLimits,
) -> NDArray[np.bool_]:
    """Return which samples (N,) are spikes in at least one entry.

    A sample is a spike if

    - it is rough, and rougher than is usual around it: see `roughness` and `prominence`;
    - only few samples in a row are: see `longest_spike`; and
    - it deviates from the cubic polynomials through four good samples around it, and these samples
      agree with each other: see `bridge`.

    The first two and the last two samples cannot be judged: they are accepted, and serve as good
    samples.

    Args:
        time: (N,) increasing stamps [s].
        value: (N, width) samples; attitudes as quaternions without jumps of sign.
        sigma: σ of every entry.
        limits: limits of screening.

    """
    spikes = np.zeros(time.size, dtype=bool)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        rough = roughness(time, value, sigma, limits.spike)
        rows = np.flatnonzero((rough > limits.spike).any(axis=1))
        if not rows.size:
            return spikes
        usual = _usual(rough, rows, limits.window)
        entries = rough[rows] > np.maximum(limits.spike, limits.prominence * usual)
        doubtful = entries.any(axis=1) & (rows > 1) & (rows < time.size - 2)
        rows, entries = rows[doubtful], entries[doubtful]
        good = np.delete(np.arange(time.size), rows)
        for row, rough_entries in zip(rows.tolist(), entries):
            spikes[row] = _is_spike(time, value, row, good, sigma, rough_entries, limits)
    rows = np.flatnonzero(spikes)
    spikes[rows[_in_long_runs(rows, limits.longest_spike)]] = False
    return spikes


def _usual(rough: NDArray[np.float64], rows: NDArray[np.intp], window: int) -> NDArray[np.float64]:
    """Return the upper quartile of the roughness around each of some rows (n, width)."""
    width = min(window, len(rough) - 1) + 1
    first = np.clip(rows - window // 2, 0, len(rough) - width)
    around = rough[first[:, None] + np.arange(width)]
    rank = width - 1 - width // 4
    return np.asarray(np.partition(around, rank, axis=1)[:, rank])


def _in_long_runs(rows: NDArray[np.intp], longest: int) -> NDArray[np.bool_]:
    """Return which of some rows, ascending, are in runs of more than `longest` successive rows."""
    run = np.append(0, np.cumsum(np.diff(rows) > 1))[: rows.size]
    return np.asarray(np.bincount(run, minlength=1)[run] > longest)


def _is_spike(
    time: NDArray[np.float64],
    value: NDArray[np.float64],
    row: int,
    good: NDArray[np.intp],
    sigma: float,
    entries: NDArray[np.bool_],
    limits: ScreeningLimits,
) -> bool:
    """Return whether a sample deviates from the motion of good samples that agree."""
    k = int(np.searchsorted(good, row))
    centre = good[max(k - 2, 0) : k + 2]
    if not 2 <= k <= good.size - 2 or _has_gap(time[centre]):
        return False
    least, bend = np.full(value.shape[1], np.inf), np.zeros(value.shape[1])
    for four in (centre, good[max(k - 3, 0) : k + 1], good[k - 1 : k + 3]):
        if four.size == 4:
            least = np.minimum(least, _deviation(time, value, row, four))
            *_, cubic = rough_orders(time[four], value[four])
            bend = np.maximum(bend, cubic[0])
    limit = np.maximum(2 * limits.spike * sigma, limits.bridge * bend)
    return bool((entries & (least > limit)).any())


def _has_gap(time: NDArray[np.float64]) -> bool:
    """Return whether too many samples are missing between the second and the third of four."""
    first, middle, last = np.diff(time)
    return bool(middle > 3 * (first + last))


def _deviation(
    time: NDArray[np.float64], value: NDArray[np.float64], row: int, others: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return by how much each entry of a sample deviates from the polynomial through others."""
    deviation = value[row].copy()
    for k in others:
        rest = others[others != k]
        deviation -= value[k] * np.prod((time[row] - time[rest]) / (time[k] - time[rest]))
    return np.abs(deviation)
