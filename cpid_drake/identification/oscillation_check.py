"""The check that nothing oscillates which the fit does not have.

A part of the base on a spring, a liquid, a flexible joint or a wheel moves at a frequency of its
own. Noise that is white, or a Gauss-Markov process, has none: where it is made white, all
frequencies f have the same power. With n samples z of d channels it is

    P(f) = 2/n |Σ z_k exp(−2πi f t_k)|²,

χ² of 2d entries, if the noise is as it is said. The power is compared with that of the neighbours,
because the fit explains a part of what is slow, and of a white torque a part that falls with f.
What oscillates much faster than the base moves does not follow it, and is in no estimate.

Source: Priestley 1981, Spectral Analysis and Time Series, ch. 6.1 (tests for periodicities).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri, fdtri

from cpid_drake.array import Array
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.least_squares import IMPROBABLE
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled
from cpid_drake.files.digits import significant
from cpid_drake.identification.checks import Check
from cpid_drake.identification.words import label_of

NEIGHBOURS = 21
"""Number of frequencies whose median is the power without a line."""

_OF_MEDIAN = 2 / np.pi  # efficiency of a median: it is as certain as a mean of such a share

FASTEST = 10.0
"""Frequency of a part that does not follow the base, as a multiple of that of the base's motion."""


@dataclass(frozen=True)
class Line:
    """The frequency of a log's samples with the most power.

    Attributes:
        log: name of the log.
        sensor: name of the sensor, or of the white force.
        frequency: [Hz].
        power: as a multiple of that of its neighbours.
        limit: above which the power is improbable, as the largest of so many.

    """

    log: str
    sensor: str
    frequency: float
    power: float
    limit: float


def lines_of(fit: Fit) -> Iterator[Line]:
    """Yield the line of each sensor and white force of all logs that has enough samples."""
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        fastest = FASTEST * _frequency(rolled)
        for name in sorted({name for rest in rolled.residuals for name in rest}):
            times, white = _white(log, rolled, name)
            n, d = white.shape
            if n <= 4 * NEIGHBOURS:
                continue
            f = np.arange(1, (n - 1) // 2) * (n - 1) / n / (times[-1] - times[0])
            power = 2 / n * np.abs(np.fft.rfft(white, axis=0)[1 : len(f) + 1]) ** 2
            total = np.sum(power, axis=1)
            near = median_filter(total, NEIGHBOURS, mode="reflect")
            usual = np.maximum(near, np.median(total)) / chdtri(2 * d, 0.5)
            ratio = total / (2 * d) / usual
            count = int(np.sum(f < fastest))
            if not count:
                continue
            k = int(np.argmax(ratio[:count]))
            freedom = 2 * d * NEIGHBOURS * _OF_MEDIAN
            limit = float(fdtri(2 * d, freedom, 1 - IMPROBABLE / count))
            yield Line(log.name, name, float(f[k]), float(ratio[k]), limit)


def oscillation_check(fit: Fit) -> tuple[Check, ...]:
    """Return the check that no line has improbable power; none of too few samples."""
    lines = list(lines_of(fit))
    if not lines:
        return ()
    worst = max(lines, key=lambda each: each.power / each.limit)
    of_log = f" of {worst.log}" if len(fit.logs) > 1 else ""
    what = label_of(worst.sensor).replace("_", " ")
    sentence = (
        f"the residuals of the {what}{of_log} oscillate at {significant(worst.frequency)} Hz: "
        "so moves a part that swings, a liquid, a wheel or something flexible; hold it fast, or "
        "log it"
    )
    return (Check.of("oscillation", sentence, worst.power, worst.limit),)


def _white(log: LogState, rolled: Rolled, name: str) -> tuple[Array, Array]:
    """Return times (n,) and white residuals (n, d) of a sensor's samples that are not far off."""
    times, white = list[Array](), list[Array]()
    for k, rest in enumerate(rolled.residuals):
        if name in rest:
            count = len(rest[name])
            is_near = log.states[k].weights.get(name, np.ones(count)) == 1.0
            times.append(log.whitening(k, name, count).times[is_near])
            white.append(log.whitened(k, name, rest[name])[is_near])
    return np.concatenate(times), np.concatenate(white)


def _frequency(rolled: Rolled) -> float:
    """Return the frequency of the base's rotation [Hz]: of a sine it is that of the sine."""
    nodes = [(each.motion.nodes, each.w[: len(each.motion.nodes)]) for each in rolled.trajectories]
    w = np.concatenate([each for _, each in nodes])
    rate = np.concatenate([np.gradient(each, times, axis=0) for times, each in nodes])
    # ⟨|ẇ|²⟩ = (2πf)² ⟨|w|²⟩
    square = float(np.sum((w - w.mean(axis=0)) ** 2))
    return float(np.sqrt(np.sum(rate**2) / square)) / (2 * np.pi) if square else np.inf
