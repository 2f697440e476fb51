"""The check that nothing oscillates which the fit does not have.

A part of the base on a spring, a liquid, a flexible joint or a wheel moves at a frequency of its
own. Noise that is white, or a Gauss-Markov process, has none: where it is made white, all
frequencies f have the same power. With n samples z of d channels it is

    P(f) = 2/n |Σ z_k exp(−2πi f t_k)|²,

χ² of 2d entries, if the noise is as it is said. The power is compared with that of the neighbours,
because the fit explains a part of what is slow, and of a white torque a part that rises with f.
What oscillates much faster than the base moves does not follow it, and is in no estimate.

Source: Priestley 1981, Spectral Analysis and Time Series, ch. 6.1 (tests for periodicities).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri

from cpid_drake.array import Array
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.least_squares import IMPROBABLE
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.process import EXACT
from cpid_drake.estimation.roll import Rolled
from cpid_drake.estimation.whitening import whitened, whitener
from cpid_drake.files.digits import significant
from cpid_drake.identification.checks import Check
from cpid_drake.identification.words import label_of
from cpid_drake.sensors.sensors import SENSORS

BESIDE = 10
"""Number of frequencies on each side whose medians are the power without a line."""

FEWEST = 3
"""Number of periods in a log from which a motion is an oscillation."""

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
            if n < 6 * BESIDE:
                continue
            power = line_power(white, 1.0 if name in SENSORS else EXACT**2)
            # of samples in their order: gaps change the phase of a line, and not its frequency
            f = np.arange(1, len(power) + 1) / (n * np.median(np.diff(times)))
            count = int(np.sum(f < fastest))
            if count < FEWEST:
                continue
            k = FEWEST - 1 + int(np.argmax(power[FEWEST - 1 : count]))
            freedom = 2 * d * 2 * BESIDE * _OF_MEDIAN
            limit = float(fdtri(2 * d, freedom, 1 - IMPROBABLE / count))
            yield Line(log.name, name, float(f[k]), float(power[k]), limit)


def oscillation_check(fit: Fit) -> tuple[Check, ...]:
    """Return the check that no line has improbable power; none of too few samples."""
    lines = list(lines_of(fit))
    if not lines:
        return ()
    worst = max(lines, key=lambda each: each.power / each.limit)
    of_log = f" of {worst.log}" if len(fit.logs) > 1 else ""
    is_force = worst.sensor not in SENSORS
    what = label_of(worst.sensor) if is_force else f"residuals of the {label_of(worst.sensor)}"
    sentence = (
        f"the {what}{of_log} oscillate{'s' * is_force} at {significant(worst.frequency)} Hz: so "
        "moves a part that swings, a liquid, a wheel or something flexible, or so err gyro or "
        "encoders; hold it fast, or log it"
    )
    return (Check.of("oscillation", sentence, worst.power, worst.limit),)


def line_power(white: Array, least: float) -> Array:
    """Return P(f) of white values (n, d) as a multiple of that of the neighbours on both sides.

    A slope, as of what the fit explains of slow motion, has no line: the power is compared with the
    larger of both sides. It is compared with no less than `least`: a line below the noise of a
    sensor is an error of splines or integration, and one below that share of a force tells nothing.
    """
    n, d = white.shape
    spectrum = np.fft.rfft(white, axis=0)[1 : (n - 1) // 2]
    total = 2 / n * np.sum(np.abs(spectrum) ** 2, axis=1)
    padded = np.pad(total, (BESIDE, 0), mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, BESIDE), axis=1)
    before, after = medians[: -BESIDE - 1], medians[BESIDE + 1 :]
    usual = np.maximum(before, after)[: len(after)] / chdtri(2 * d, 0.5)
    return np.asarray(total[: len(after)] / (2 * d) / np.maximum(usual, least))


def _white(log: LogState, rolled: Rolled, name: str) -> tuple[Array, Array]:
    """Return times (n,) and white residuals (n, d) of a sensor's samples that are not far off."""
    times, white = list[Array](), list[Array]()
    for k, rest in enumerate(rolled.residuals):
        if name in rest:
            count = len(rest[name])
            is_near = log.states[k].weights.get(name, np.ones(count)) == 1.0
            times.append(whitener(log, k, name, count).times[is_near])
            white.append(whitened(log, k, name, rest[name])[is_near])
    return np.concatenate(times), np.concatenate(white)


def _frequency(rolled: Rolled) -> float:
    """Return the frequency of the base's rotation [Hz]: of a sine it is that of the sine."""
    nodes = [(each.motion.nodes, each.w[: len(each.motion.nodes)]) for each in rolled.trajectories]
    w = np.concatenate([each for _, each in nodes])
    rate = np.concatenate([np.gradient(each, times, axis=0) for times, each in nodes])
    # ⟨|ẇ|²⟩ = (2πf)² ⟨|w|²⟩
    square = float(np.sum((w - w.mean(axis=0)) ** 2))
    return float(np.sqrt(np.sum(rate**2) / square)) / (2 * np.pi) if square else np.inf
