"""One clock for a log of several files: the delays of their stamps with which they agree.

Positions agree with rates, and the motion of the base with the conservation of momentum (`score`),
only if the stamps of all sensors have one zero. So the delay of a file against the encoders is the
one with the least residual; it is looked for on a grid, and then to its minimum.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from cpid_drake.array import Array
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.instants import SmoothedLog
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.noise_estimation import RESOLUTION
from cpid_drake.logs.score import WORSE, compare_momentum, compare_rates
from cpid_drake.logs.screening import LONGEST_DELAY

LONGEST = 5.0
"""Clocks of files of one log differ by at most this [s]."""

STEP = 0.04
"""Step of the grid [s]: a tenth of this is seen in the momentum of a moving arm."""

ACCURACY = 5e-3
"""σ of delays that are found [s]: noise and splines leave errors of up to 2 ms."""


def with_delays(log: Log, delays: Mapping[str, float]) -> Log:
    """Return a log in which times [s] by file are added to the stamps: all have one clock then."""
    later = {name: delays.get(file, 0.0) for name, file in log.clocks.items()}
    samples = {
        name: Samples(each.time + later[name], each.value) if later.get(name) else each
        for name, each in log.samples.items()
    }
    return replace(log, samples=samples, clocks={})


def delay_notes(log: Log, delays: Mapping[str, float]) -> tuple[str, ...]:
    """Return what `with_delays` changes, in words."""
    return tuple(
        f"the clock of {file} is {abs(delay):.3f} s {'behind' if delay > 0 else 'ahead of'} that "
        f"of {log.clocks['encoders']}, as the momentum shows: its stamps are shifted"
        for file, delay in delays.items()
        if delay
    )


def file_delays(log: Log, tree: KinematicTree | None) -> dict[str, float]:
    """Return by file of a log what is to be added to its stamps [s].

    It is 0 where another delay is not clearly better.

    Args:
        log: screened samples, joints in the spacecraft's order.
        tree: the spacecraft model; None to compare positions with rates only.

    """
    reference = log.clocks.get("encoders")
    files = [f for f in dict.fromkeys(log.clocks.values()) if f != reference]
    smoothed = SmoothedLog.of(log) if files and reference else None
    if smoothed is None:
        return {}
    delays: dict[str, float] = {}
    reachable = {name for name in smoothed.splines if log.clocks.get(name, reference) == reference}
    for file in sorted(files, key=lambda each: each != log.clocks.get("attitude")):
        own = {name for name in smoothed.splines if log.clocks.get(name) == file}
        reachable |= own
        later = {name: delays[each] for name, each in log.clocks.items() if each in delays}
        misfit = partial(_misfit, log, tree, smoothed.of_sensors(reachable), later, own)
        delays[file] = _best_delay(misfit, LONGEST)
    return delays


def gyro_delay(log: Log, smoothed: SmoothedLog) -> float:
    """Return what is to be added to the gyro's stamps [s] so that it turns as the attitude does.

    Units, axes and orders do not matter; it is 0 where another delay is not clearly better.
    """
    both = smoothed.of_sensors({"attitude", "gyro"})
    return _best_delay(partial(_misfit, log, None, both, {}, {"gyro"}), LONGEST_DELAY)


def _best_delay(misfit: Callable[[float], float], longest: float) -> float:
    """Return the delay with the least misfit; 0 if that is not clearly better."""
    count = round(longest / STEP)
    grid = STEP * np.arange(-count, count + 1)
    best = grid[int(np.argmin([misfit(delay) for delay in grid]))]
    bounds, accuracy = (best - STEP, best + STEP), {"xatol": 1e-5}
    least = minimize_scalar(misfit, bounds=bounds, method="bounded", options=accuracy)
    is_better = float(least.fun) + np.log(WORSE) < misfit(0.0)
    return float(least.x) if is_better else 0.0


def _misfit(
    log: Log,
    tree: KinematicTree | None,
    smoothed: SmoothedLog,
    later: Mapping[str, float],
    sensors: Collection[str],
    delay: float,
) -> float:
    """Return the mean logarithm of residuals with later stamps; infinite if there are none."""
    given = smoothed.instants({**later, **dict.fromkeys(sensors, delay)})
    if given is None:
        return np.inf
    apart = [_apart(*each.values) for each in compare_rates(given, log.joint_names)]
    apart += [each.residual for each in compare_momentum(given, tree)]
    return float(np.mean(np.log(apart))) if apart else np.inf


def _apart(moved: Array, measured: Array) -> float:
    """Return √(1 − ρ²) of the sizes of two motions (N, k): units, signs and axes do not matter."""
    sizes = np.linalg.norm(moved, axis=1), np.linalg.norm(measured, axis=1)
    a, b = (size - size.mean() for size in sizes)
    rho = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    return float(np.sqrt(max(1 - max(rho, 0.0) ** 2, RESOLUTION**2)))
