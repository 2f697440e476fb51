"""Guesses which column of a log is its time, and in which unit."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.column_map import TimeColumn, TimeUnit, scale_of
from cpid_drake.logs.guess.names import frame_rate_of, unit_of, words_of

_WORDS = ("stamp", "timestamp", "time", "t", "clock", "secs", "sec", "seconds", "frame")
_NANOSECONDS = {"nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds"}
_OTHER = {"sub", "recv", "receive", "log", "record"}
_YEARS = (5e8, 4e9)
"""Seconds since 1970 in the years 1985 to 2096."""


_UNITS: tuple[TimeUnit, ...] = ("s", "ms", "us", "ns")
_SHORTEST_STEP, _LONGEST_STEP = 1e-4, 5.0  # of a log [s]
_USUAL_STEP = 0.5
"""Step above which the time may be in a smaller unit, if that leaves a possible step [s]."""


def guess_time(
    values: Mapping[str, NDArray[np.float64]],
    frame_rate: float | None,
    unit: TimeUnit | None = None,
) -> tuple[TimeColumn, list[str], tuple[TimeUnit, ...]]:
    """Return the time column of a log, the reasons, and other units that the steps allow.

    Args:
        values: the log's columns of numbers (N,).
        frame_rate: frames per second, if the log counts frames and does not say it [Hz].
        unit: the unit, if names and steps leave it open; None to choose the largest one.

    Raises:
        InputError: no column can be the time, or it counts frames of an unknown rate.

    """
    candidates = []
    for name, column in values.items():
        words = words_of(name)
        named = [k for k, word in enumerate(_WORDS) if word in words]
        if not named or words & _NANOSECONDS:
            continue
        there = column[np.isfinite(column)]
        steps = np.diff(there)
        if there.size > 1 and np.mean(steps >= 0) > 0.98 and there[-1] > there[0]:
            candidates.append((bool(words & _OTHER), named[0], name))
    if not candidates:
        shown = ", ".join(list(values)[:12])
        raise InputError(
            f"no column can be the time: it has a name such as 'time' or 'stamp' and increases; "
            f"the columns of numbers are {shown}"
        )
    name = min(candidates)[2]
    ticks = values[name][np.isfinite(values[name])]
    steps = np.diff(ticks)
    step = float(np.median(steps[steps > 0]))
    reasons = [f"'{name}' increases, from {ticks[0]:.12g} in steps of {step:.6g}"]
    time = TimeColumn(name)
    if "frame" in words_of(name):
        time.unit, time.rate = "frame", frame_rate_of(name) or frame_rate
        if time.rate is None:
            raise InputError(
                f"the column '{name}' counts frames, and the log does not say how many there are "
                "in a second: give --frame-rate"
            )
        time.epoch = float(ticks[0])
        reasons.append(f"{time.rate:g} frames per second")
        return time, reasons, ()
    others: tuple[TimeUnit, ...] = ()
    time.nanoseconds = _nanoseconds_beside(name, values)
    if time.nanoseconds is not None:
        reasons.append(f"'{time.nanoseconds}' holds the nanoseconds")
    else:
        time.unit, why, others = _unit(unit_of(name), float(ticks[0]), step)
        if unit in others:
            time.unit, why = unit, "positions and rates then agree"
        reasons.append(f"in {time.unit}: {why}")
    if abs(ticks[0]) * scale_of(time.unit) > 1e5:
        time.epoch = float(ticks[0])
        reasons.append("the time starts at zero at the first row")
    return time, reasons, others


def _unit(
    stated: str | None, first: float, step: float
) -> tuple[TimeUnit, str, tuple[TimeUnit, ...]]:
    """Return the unit of a clock, the reason, and other units that are possible."""
    for unit in _UNITS:
        if unit == stated:
            return unit, "the name says so", ()
    for unit in _UNITS:
        if _YEARS[0] < first * scale_of(unit) < _YEARS[1]:
            return unit, "it counts from 1970", ()
    steps = {unit: step * scale_of(unit) for unit in _UNITS}
    possible = [u for u in _UNITS if _SHORTEST_STEP <= steps[u] <= _LONGEST_STEP]
    if not possible:
        return "s", "assumed", ()
    unit, *others = possible
    is_open = steps[unit] >= _USUAL_STEP
    why = f"the steps are then {steps[unit]:.4g} s"
    return unit, why, tuple(others) if is_open else ()


def _nanoseconds_beside(column: str, values: Mapping[str, NDArray[np.float64]]) -> str | None:
    """Return the column of nanoseconds that belongs to a column of seconds."""
    if not words_of(column) & {"sec", "secs", "seconds"}:
        return None
    for name in values:
        if words_of(name) & _NANOSECONDS and words_of(name) - _NANOSECONDS == words_of(column) - {
            "sec",
            "secs",
            "seconds",
        }:
            return name
    return None
