"""The noise of fast sensors from their samples: its size, and its correlation in time.

Noise that is correlated in time has more power at low frequencies, where the motion is, than white
noise of the same σ. Its power at high frequencies, where there is no motion, shows both numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import ATTITUDE, SENSORS
from cpid_drake.sensing.suite import SensorSuite

SLOWEST = 40.0
"""Rate of samples below which the motion may reach all frequencies that the samples show [Hz]."""

FASTEST_MOTION = 8.0
"""Frequency above which the samples contain noise only [Hz]."""

FEWEST = 200
"""Number of samples that determine the noise."""

SMALLEST = 1.15
"""Ratio of noise to the given noise below which the given one is kept."""

_SIGNIFICANT = 40.0  # twice the logarithm of the ratio of likelihoods
_ORDER = 4  # of the differences that remove the motion
_MOST_SAMPLES = 8192
_CORRELATIONS = np.concatenate([np.linspace(-0.6, 0.8, 71), 1 - np.geomspace(0.19, 0.05, 30)])
_ON_GRID = 0.02
_SPIKE = 12.0
_MOST_MISSING = 0.05
_LOWER = (6.0, 4.0, 3.0, 2.0, 1.5, 1.0)  # [Hz]
_FEWEST_LOW = 8  # number of the frequency below which windows spread the motion
_MORE = 2.0  # ratio of power that noise explains
_MOST_PIECES, _FEWEST_PIECES = 16, 5
_SHORTEST_PIECE = 60  # samples
_LOUD = 2.5  # power of a piece relative to the median one, from which it contains more than noise
_TAPER_LOSS = 2.0  # neighbouring frequencies of tapered samples are correlated


@dataclass(frozen=True)
class Noise:
    """Noise n with n_k = ρ n_(k-1) + white noise.

    Attributes:
        sigma: σ of a sample.
        correlation: ρ.
        gain: 2 log of the likelihood of this noise, relative to that of the given white noise.

    """

    sigma: float
    correlation: float
    gain: float

    @property
    def slow_sigma(self) -> float:
        """σ of white noise with the same power at low frequencies."""
        rho = self.correlation
        return float(self.sigma * np.sqrt((1 + rho) / (1 - rho)))


def noise_factors(measurements: Measurements, suite: SensorSuite) -> dict[str, float]:
    """Return by how much σ of sensors must be larger for the noise that their samples show.

    Sensors whose noise is not larger than given, or cannot be seen, are left out.
    """
    factors = {}
    for name in suite.present():
        if name not in SENSORS or len(measurements[name]) < FEWEST:
            continue
        given = float(np.sqrt(np.mean(suite.sigmas(name) ** 2)))
        is_attitude = SENSORS[name].quantity is ATTITUDE
        if _is_on_grid(measurements[name], suite[name].step):
            continue
        found = noise_of(measurements[name], given, is_attitude=is_attitude)
        if found is not None and found.gain > _SIGNIFICANT:
            factor = found.slow_sigma / given
            if factor > SMALLEST:
                factors[name] = factor
    return factors


def noise_of(samples: Samples, given: float, *, is_attitude: bool = False) -> Noise | None:
    """Return the noise of samples by Whittle's likelihood; None if they do not show it.

    Args:
        samples: of one sensor.
        given: σ of the noise that is expected; of attitudes, about one axis [rad].
        is_attitude: whether the samples are quaternions.

    """
    time, value = samples.time[:_MOST_SAMPLES], samples.value[:_MOST_SAMPLES]
    step = float(np.median(np.diff(time))) if len(time) >= FEWEST else np.inf
    place = np.round((time - time[:1]) / step)
    if 1 / step < SLOWEST or np.abs(time - time[0] - place * step).max() > 0.1 * step:
        return None
    if place[-1] + 1 > (1 + _MOST_MISSING) * len(time):
        return None
    if is_attitude:
        flips = np.sum(value[1:] * value[:-1], axis=1) < 0
        signs = np.cumprod(np.where(np.append(False, flips), -1.0, 1.0))
        value = value * signs[:, None] * 2 * np.sqrt(4 / 3)
    if place[-1] + 1 > len(time):  # some samples are missing
        value = CubicSpline(place, value)(np.arange(place[-1] + 1))
    least = 2 * np.pi * FASTEST_MOTION * step
    power, angle = _quiet_spectrum(_without_spikes(value / given), least)
    first = _first_without_motion(power, angle, step)
    size, rho, gain = _fit(power[:, first:], angle[first:])
    return Noise(given * float(np.sqrt(size / (1 - rho**2))), rho, gain)


def _fit(power: NDArray[np.float64], angle: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the variance of the white noise, ρ, and the gain; see `Noise`."""
    shape = 1 + _CORRELATIONS[:, None] ** 2 - 2 * _CORRELATIONS[:, None] * np.cos(angle)
    size = np.mean(power, axis=0) @ shape.T / len(angle)
    cost = np.log(size) - np.mean(np.log(shape), axis=1) + 1
    best = int(np.argmin(cost))
    gain = 2 * power.size / _TAPER_LOSS * (float(power.mean()) - float(cost[best]))
    return float(size[best]), float(_CORRELATIONS[best]), gain


def _first_without_motion(
    power: NDArray[np.float64], angle: NDArray[np.float64], step: float
) -> int:
    """Return the index of the lowest frequency that the noise at higher ones explains."""
    first = int(np.searchsorted(angle, 2 * np.pi * FASTEST_MOTION * step))
    for hertz in _LOWER:
        lower = int(np.searchsorted(angle, 2 * np.pi * hertz * step))
        size, rho, _ = _fit(power[:, first:], angle[first:])
        expected = size / (1 + rho**2 - 2 * rho * np.cos(angle[lower:first]))
        if lower < _FEWEST_LOW or np.mean(power[:, lower:first] / expected) > _MORE:
            break
        first = lower
    return first


def _without_spikes(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (N, channels) whose isolated outliers are interpolated."""
    value = value.copy()
    for _ in range(3):
        change = np.abs(np.diff(value, n=_ORDER, axis=0))
        size = np.median(change, axis=0)
        far = change > _SPIKE * size
        far[1:-1] &= (change[1:-1] >= change[:-2]) & (change[1:-1] >= change[2:])
        row, channel = np.nonzero(far & (size > 0))
        if not len(row):
            break
        k = row + _ORDER // 2
        near = value[k - 1, channel] + value[k + 1, channel]
        value[k, channel] = (4 * near - value[k - 2, channel] - value[k + 2, channel]) / 6
    return value


def _quiet_spectrum(
    value: NDArray[np.float64], least: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the spectrum of values (N, channels) without the pieces that contain jumps.

    A thruster that fires is a jump of the velocity, or of the acceleration. Its power reaches all
    frequencies, and is in few pieces. See `_spectrum`.

    Args:
        value: in units of the given σ.
        least: angle per sample above which there is noise only.

    """
    count = min(_MOST_PIECES, len(value) // _SHORTEST_PIECE)
    if count < _FEWEST_PIECES:
        return _spectrum(value)
    size = len(value) // count
    starts = range(0, len(value) - size + 1, size // 2)  # the window hides what is at the ends
    pieces = [_spectrum(value[start : start + size]) for start in starts]
    angle = pieces[0][1]
    power = np.stack([power for power, _ in pieces])
    fast = power[:, :, angle > least].mean(axis=1)
    quiet = np.mean(fast / np.median(fast, axis=0), axis=1) <= _LOUD
    return _spectrum(value) if quiet.all() else (power[quiet].mean(axis=0), angle)


def _spectrum(value: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the power (channels, K), 1 for white noise of σ = 1, and angles per sample (K,)."""
    change = np.diff(value, n=_ORDER, axis=0)
    window = np.hanning(len(change) + 1)[:-1]  # as if periodic
    power = np.abs(np.fft.rfft(change * window[:, None], axis=0)) ** 2 / np.sum(window**2)
    angle = 2 * np.pi * np.arange(len(power)) / len(change)
    angle[0] = angle[1]
    gain = (2 * np.sin(angle / 2)) ** (2 * _ORDER)
    moving = np.median(np.abs(change), axis=0) > 0
    return (power[:, moving] / gain[:, None]).T, angle


def _is_on_grid(samples: Samples, step: float) -> bool:
    """Return whether the samples are rounded to the given step."""
    if step == 0:
        return False
    units = np.diff(samples.value[:200], axis=0) / step
    return bool(np.mean(np.abs(units - np.round(units)) < _ON_GRID) > 0.9)
