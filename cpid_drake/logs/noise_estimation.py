"""Estimates the sensors' noise from a log, if no sensors are given, and what rounding adds.

Differences of high order remove a smooth motion and keep the noise: the p-th differences of white
noise of variance σ² have the variance σ² (2p)!/(p!)².
"""

from contextlib import suppress
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import comb

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples, without_flips
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite

FEWEST = 12
"""Samples of a sensor from which its noise is estimated: differences of order 8 leave four, and a
spline of degree 5 has at least seven numbers."""

RESOLUTION = 1e-6
"""Least noise of a sensor, as a share of the spread of its samples: 20 bits.

Samples of a simulation have no noise, but errors of integration and of interpolation: a smaller
share of the motion is none.
"""

FALLING = 0.9
"""Ratio of the noise by differences of an order and of two orders less that shows motion."""

_SMOOTH = 0.05
"""Largest noise of joint positions, as a share of their spread, in samples of one motion."""


def estimate_suite(log: Log) -> SensorSuite:
    """Return sensors with white noise, the same in all axes, as estimated from the samples.

    Raises:
        InputError: there are joints without encoders, or fewer than 12 samples of a sensor.

    """
    if log.joint_names and not len(log.encoders):
        raise InputError("there are no joint positions to estimate noise from")
    suite = SensorSuite(description="noise estimated from the samples")
    for name, samples in log.items():
        if not samples.value.size:  # of no joints, too
            continue
        if len(samples) < FEWEST:
            raise InputError(
                f"{len(samples)} samples of {name} are too few to estimate their noise; "
                f"give the sensors, or at least {FEWEST} samples"
            )
        rate = float(np.clip(1 / np.median(np.diff(samples.time)), 1e-3, 1e5))
        sigma = max(sensor_noise(name, samples), _resolution(samples))
        setattr(suite, name, SENSORS[name].errors.with_noise(rate, sigma))
    return suite


def has_noise(log: Log) -> bool:
    """Return whether some sensor's noise is above `RESOLUTION`, or may be: samples can be few."""
    for name, samples in log.items():
        try:
            if samples.value.size and sensor_noise(name, samples) > _resolution(samples):
                return True
        except InputError:
            return True
    return False


def _resolution(samples: Samples) -> float:
    return RESOLUTION * float(np.sqrt(np.var(samples.value, axis=0).sum()))


def sensor_noise(name: str, samples: Samples) -> float:
    """Return σ of one entry of a sensor's samples (of attitudes: rotations about one axis [rad]).

    Entries that a table holds are exactly constant. They are not measured, and do not count.

    Raises:
        InputError: the samples are too few, or too unevenly spaced.

    """
    size, entries = _entries(name, samples)
    return size * noise_level(entries)


def noise_order(name: str, samples: Samples) -> tuple[int, bool]:
    """Return the order of the differences that `sensor_noise` takes.

    And whether they may contain motion, since a higher order would show less.

    Raises:
        InputError: as for `sensor_noise`.

    """
    levels = _levels(_entries(name, samples)[1])
    order = min(levels, key=lambda each: levels[each])
    return order, order == max(levels) and levels[order] < FALLING * levels[max(order - 2, 2)]


def _entries(name: str, samples: Samples) -> tuple[float, Samples]:
    """Return the entries of a sensor's samples that show noise, and its σ in units of theirs."""
    value = samples.value
    if name == "attitude" and len(value) and value[:, 1:3].any():
        # A rotation by δ changes the four entries by δ/2 in total, along three directions.
        return 2 * sqrt(4 / 3), Samples(samples.time, without_flips(value))
    if name == "attitude":
        value = np.unwrap(2 * np.arctan2(value[:, 3], value[:, 0]))[:, None]
    elif SENSORS[name].width is not None and len(value) and np.ptp(value, axis=0).any():
        value = value[:, np.ptp(value, axis=0) > 0]
    return 1.0, Samples(samples.time, value)


def noise_level(samples: Samples) -> float:
    """Return σ of one entry of a sample.

    The smallest estimate from differences of several orders is returned, because differences of low
    order still contain motion. A motion that is too fast for the sampling rate has the same effect
    as noise.

    Raises:
        InputError: the samples are too few, or too unevenly spaced.

    """
    return max(min(_levels(samples).values()), 1e-13)  # a σ of zero could not be divided by


def _levels(samples: Samples) -> dict[int, float]:
    """Return σ of one entry by the order of the differences that show it; see `noise_level`."""
    value, steps, levels = samples.value, np.diff(samples.time), dict[int, float]()
    if len(value) < 5:
        raise InputError(f"{len(value)} samples are too few to estimate noise; give the sensors")
    even = np.abs(steps / np.median(steps) - 1) < 0.1
    for order in range(2, min(9, len(value) - 2)):
        # Differences across a gap in the samples are left out.
        whole = np.convolve(even, np.ones(order), "valid") > order - 0.5
        if whole.any():
            difference = np.diff(value, n=order, axis=0)[whole]
            levels[order] = _root_mean_square(difference) / sqrt(comb(2 * order, order))
    if not levels:
        raise InputError("the times of samples are too uneven to estimate noise; give the sensors")
    return levels


def sample_sigmas(samples: Log | Motion) -> Array:
    """Return σ (12 + 2J,) of the noise in one sample, ordered as in `changed_motion`.

    Of states, which may belong to unconnected instants, rounding is the only noise that can be
    seen. σ is zero for a sensor without samples.
    """
    if isinstance(samples, Motion):
        states = ("quaternion_WB", "w_WB", "p_WB", "v_WB", "q", "qdot")
        values = {name: getattr(samples, state) for name, state in zip(SENSORS, states)}
    else:
        values = {name: each.value for name, each in samples.items()}
    parts, joints = [], len(samples.joint_names)
    is_motion = isinstance(samples, Log) and _is_one_motion(samples.encoders)
    for name, value in values.items():
        sigma = rounding(value) / np.sqrt(12) if len(value) else 0.0
        if isinstance(samples, Log) and is_motion and len(value):
            with suppress(InputError):  # too few samples
                sigma = max(sigma, sensor_noise(name, samples[name]))
        parts.append(np.full(joints if SENSORS[name].width is None else 3, sigma))
    return np.concatenate(parts)


def rounding(values: Array) -> float:
    """Return the unit of the last decimal of rounded numbers; zero for numbers of all digits."""
    values = values[np.isfinite(values) & (values != 0)]
    decimals = np.arange(13)  # numbers with more have all digits
    for count in decimals[_are_whole(values[:20], decimals)]:  # a few numbers exclude most
        if _are_whole(values, np.array([count])).all():
            return 10.0 ** -int(count) if len(values) else 0.0
    return 0.0


def _are_whole(values: Array, decimals: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether values (N,) have so many decimals (D,), and none is rounded to zero."""
    scaled = values * 10.0 ** decimals[:, None]
    whole = np.round(scaled)
    return np.asarray(((whole != 0) & (np.abs(scaled - whole) < 1e-3)).all(axis=1))


def _is_one_motion(encoders: Samples) -> bool:
    """Return whether joint positions change little from sample to sample."""
    try:
        return noise_level(encoders) < _SMOOTH * float(np.std(encoders.value, axis=0).max())
    except InputError:  # too few samples
        return False


def _root_mean_square(values: Array) -> float:
    """Return the root mean square without the largest hundredth, which may be outliers.

    Of eight parts of the values, those with less than half of the largest root mean square do not
    count: a sensor can repeat its value at rest.
    """
    size = np.sum(values**2, axis=1)
    kept = size <= np.quantile(size, 0.99, method="higher")
    parts = np.array_split(np.where(kept, size, np.nan), max(min(8, len(size) // 12), 1))
    means = [np.nanmean(part) if np.isfinite(part).any() else 0.0 for part in parts]
    counting = np.concatenate([p for p, mean in zip(parts, means) if 4 * mean >= max(means)])
    return float(np.sqrt(np.nanmean(counting) / values.shape[1]))
