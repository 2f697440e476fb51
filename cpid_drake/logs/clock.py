"""The time that a log's positions and rates agree on: clocks that count steps, or run wrongly.

The change of a position from row to row is its mean rate times the true interval, for every joint,
the attitude and the base's position alike. A single sensor with an error of its scale contradicts
the others; a wrong clock does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Samples, turns
from cpid_drake.logs.score import MOMENTUM, Comparison
from cpid_drake.logs.screening import LONGEST_DELAY
from cpid_drake.sensors.sensors import POSITIONS

LEAST_ERROR = 0.005
"""Smallest relative error of a clock that is named: crystals are a hundred times better."""

LEAST_RESIDUAL = 0.01
"""Smallest residual that a delay may explain: errors of smoothing leave less."""


def clock_factor(comparisons: Sequence[Comparison]) -> float | None:
    """Return true time divided by logged time if it is not one; None if nothing shows it.

    Joints, attitude and position must agree on it, at least two of them.
    """
    sums: dict[str, list[float]] = {}
    for each in comparisons:
        if each.name == MOMENTUM:
            continue
        moved, measured = each.values
        own = sums.setdefault(each.name.partition(":")[0], [0.0, 0.0])
        size = float(np.sum(measured**2))
        own[0] += float(np.sum(moved * measured)) / max(size, 1e-300)
        own[1] += 1.0
    factors = np.array([total / count for total, count in sums.values()])
    if len(factors) < 2:
        return None
    factor = float(np.mean(factors))
    is_same = np.ptp(factors) < abs(factor - 1) / 5
    return factor if abs(factor - 1) > LEAST_ERROR and is_same and factor > 0 else None


def with_delay(comparison: Comparison, time: Array) -> Comparison:
    """Return a comparison with the delay that explains it, if one does; (N,) are its times [s]."""
    moved, measured = comparison.values
    if comparison.name == MOMENTUM or comparison.residual < LEAST_RESIDUAL or len(time) < 20:
        return comparison
    most = min(LONGEST_DELAY, (time[-1] - time[0]) / 5)
    inner = (time >= time[0] + most) & (time <= time[-1] - most)
    spline, values = CubicSpline(time, moved), measured[inner]

    def residual(delay: float) -> float:
        change = spline(time[inner] + delay)
        size = max(np.sum(change**2), np.sum(values**2), 1e-300)
        return float(np.sqrt(np.sum((change - values) ** 2) / size))

    delays = np.linspace(-most, most, 201)
    k = int(np.argmin([residual(delay) for delay in delays]))
    low, high = delays[max(k - 1, 0)], delays[min(k + 1, 200)]
    best = minimize_scalar(residual, bounds=(low, high), method="bounded")
    explains = 3 * best.fun < min(residual(0.0), comparison.residual)
    if not (explains and 0 < k < 200):
        return comparison
    return replace(comparison, delay=float(best.x), residual_without=float(best.fun))


def time_from_rates(samples: Mapping[str, Samples]) -> dict[str, Samples]:
    """Return samples at the times on which positions and rates of the same rows agree.

    Rows in which little moves keep their logged share of the time.

    Raises:
        InputError: no rows have positions and their rates.

    """
    time, changes, rates = None, [], []
    for rate, position in POSITIONS.items():
        both = [samples.get(position), samples.get(rate)]
        if both[0] is None or both[1] is None or len(both[0]) < 3:
            continue
        common, first, second = np.intersect1d(both[0].time, both[1].time, return_indices=True)
        if len(common) < 3 or (time is not None and not np.array_equal(common, time)):
            continue
        time, value, speed = common, both[0].value[first], both[1].value[second]
        change = turns(value) if position == "attitude" else np.diff(value, axis=0)
        mean = (speed[1:] + speed[:-1]) / 2
        unit = np.sqrt(np.mean(mean**2, axis=0))
        moves = unit > 0
        changes.append(change[:, moves] / unit[moves])
        rates.append(mean[:, moves] / unit[moves])
    if time is None or not changes:
        raise InputError(
            "time.from_rates needs rows with joint positions and their rates, or with the attitude "
            "and the angular velocity"
        )
    change, mean = np.hstack(changes), np.hstack(rates)
    steps, square = np.diff(time), np.sum(mean**2, axis=1)
    product = np.sum(change * mean, axis=1)
    usual = float(product.sum() / np.sum(square * steps))  # true time in logged time
    little = float(square.mean()) / 100  # a row with less motion keeps its interval
    true = (product + little * usual * steps) / (square + little)
    if not (true > 0).all():
        k = int(np.argmin(true))
        raise InputError(
            f"time.from_rates: positions and rates contradict each other at {time[k]:.6g} s: the "
            "interval between two rows would be negative"
        )
    new = time[0] + np.append(0.0, np.cumsum(true))

    def moved(t: Array) -> Array:
        outside = usual * (np.minimum(t - time[0], 0) + np.maximum(t - time[-1], 0))
        return np.asarray(np.interp(t, time, new) + outside)

    return {name: Samples(moved(s.time), s.value) for name, s in samples.items()}


def refuse_single_precision(time: Array, column: str) -> None:
    """Refuse stamps that were rounded to single precision.

    Raises:
        InputError: all are numbers of single precision, which are too far apart there.

    """
    time = time[np.isfinite(time)]
    with np.errstate(over="ignore"):
        single = time.astype(np.float32)
    steps = np.diff(time)
    if len(time) < 3 or not (single == time).all():
        return
    unit = float(np.spacing(np.abs(single).max()))
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.02
    is_even = np.mean(np.abs(steps / step - 1) > 1e-3) < 0.1
    is_rounded = (time != np.round(time)).any() or (steps == 0).mean() > 0.5
    if not is_even and is_rounded and unit > 0.02 * step:
        raise InputError(
            f"the stamps in column '{column}' are rounded to single precision (float32), whose "
            f"numbers at {time.max():.6g} are {unit:.3g} apart: write them as float64, or count "
            "from the start of the log"
        )
