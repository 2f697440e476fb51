"""Estimates the sensors' noise from a log, if no sensors are given, and what rounding adds.

Differences of high order remove a smooth motion and keep the noise: the p-th differences of white
noise of variance σ² have the variance σ² (2p)!/(p!)².
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.special import comb

from cpid_drake.dynamics.motion import Motion
from cpid_drake.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import ATTITUDE, SENSORS
from cpid_drake.sensors.suite import SensorSuite

_ORDERS = range(2, 9)
_FEWEST = 12
_LEAST = 1e-13

_MOST_DECIMALS = 12
"""Numbers with more decimals are not treated as rounded."""

_SMOOTH = 0.05
"""Largest noise of joint positions, as a share of their spread, in samples of one motion."""

_QUANTITIES = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")
_STATES = ("quaternion_WB", "w_WB", "p_WB", "v_WB", "q", "qdot")


def estimate_suite(measurements: Log) -> SensorSuite:
    """Return sensors with white noise, the same in all axes, as estimated from the samples.

    Raises:
        InputError: there are no encoders, or fewer than 12 samples of a sensor.

    """
    if not len(measurements.encoders):
        raise InputError("there are no joint positions to estimate noise from")
    suite = SensorSuite(description="noise estimated from the samples")
    for name, samples in measurements.items():
        if not len(samples):
            continue
        if len(samples) < _FEWEST:
            raise InputError(
                f"{len(samples)} samples of {name} are too few to estimate their noise; "
                f"give the sensors, or at least {_FEWEST} samples"
            )
        rate = float(np.clip(1 / np.median(np.diff(samples.time)), 1e-3, 1e5))
        sigma = sensor_noise(name, samples)
        setattr(suite, name, SENSORS[name].errors.with_noise(rate, sigma))
    return suite


def sensor_noise(name: str, samples: Samples) -> float:
    """Return σ of one entry of a sensor's samples; see `noise_level`.

    Entries that a table holds are exactly constant. They are not measured, and do not count.

    Raises:
        InputError: for the same reasons as `noise_level`.

    """
    quantity, value = SENSORS[name].quantity, samples.value
    if quantity is ATTITUDE:
        if value[:, 1:3].any():
            return noise_level(samples, quaternions=True)
        yaw = np.unwrap(2 * np.arctan2(value[:, 3], value[:, 0]))
        return noise_level(Samples(samples.time, yaw[:, None]))
    varies = np.ptp(value, axis=0) > 0
    if quantity.width is None or not varies.any():
        return noise_level(samples)
    return noise_level(Samples(samples.time, value[:, varies]))


def noise_level(samples: Samples, *, quaternions: bool = False) -> float:
    """Return σ of one entry of a sample (of attitudes: of the rotation about one axis [rad]).

    The smallest estimate from differences of several orders is returned, because differences of low
    order still contain motion. A motion that is too fast for the sampling rate has the same effect
    as noise.

    Raises:
        InputError: the samples are too few, or too unevenly spaced.

    """
    value = samples.value
    if len(value) <= _ORDERS[0] + 2:
        raise InputError(f"{len(value)} samples are too few to estimate noise; give the sensors")
    if quaternions:
        flips = np.sum(value[1:] * value[:-1], axis=1) < 0
        value = value * np.cumprod(np.where(np.append(False, flips), -1.0, 1.0))[:, None]
    steps = np.diff(samples.time)
    even = np.abs(steps / np.median(steps) - 1) < 0.1
    least = np.inf
    for order in _ORDERS:
        if len(value) <= order + 2:
            break
        # Differences across a gap in the samples are left out.
        whole = np.convolve(even, np.ones(order), "valid") > order - 0.5
        if not whole.any():
            break
        difference = np.diff(value, n=order, axis=0)[whole]
        level = _root_mean_square(difference) / np.sqrt(comb(2 * order, order))
        least = min(least, level)
    if not np.isfinite(least):
        raise InputError("the times of samples are too uneven to estimate noise; give the sensors")
    # A rotation by δ changes the four entries by δ/2 in total, along three directions.
    return max(float(least * (2 * np.sqrt(4 / 3) if quaternions else 1.0)), _LEAST)


def sample_sigmas(samples: Log | Motion) -> NDArray[np.float64]:
    """Return σ (12 + 2J,) of the noise in one sample, in the order of `momentum_rows.changed`.

    Of states, which may belong to unconnected instants, rounding is the only noise that can be
    seen. σ is zero for a sensor without samples.
    """
    parts = []
    is_motion = isinstance(samples, Log) and _is_one_motion(samples.encoders)
    for name, state in zip(_QUANTITIES, _STATES, strict=True):
        own = samples[name] if isinstance(samples, Log) else None
        value = getattr(samples, state) if own is None else own.value
        sigma = rounding(value) / np.sqrt(12) if len(value) else 0.0
        if is_motion and own is not None and len(own):
            with suppress(InputError):  # too few samples
                sigma = max(sigma, sensor_noise(name, own))
        parts.append(np.full(value.shape[1] if state in ("q", "qdot") else 3, sigma))
    return np.concatenate(parts)


def rounding(values: NDArray[np.float64]) -> float:
    """Return the unit of the last decimal of rounded numbers; zero for numbers of all digits."""
    values = values[np.isfinite(values) & (values != 0)]
    for decimals in range(_MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        whole = np.round(scaled)
        if np.all(whole != 0) and np.all(np.abs(scaled - whole) < 1e-3):
            return float(10.0**-decimals) if len(values) else 0.0
    return 0.0


def _is_one_motion(encoders: Samples) -> bool:
    """Return whether joint positions change little from sample to sample."""
    try:
        return noise_level(encoders) < _SMOOTH * float(np.std(encoders.value, axis=0).max())
    except InputError:  # too few samples
        return False


def _root_mean_square(values: NDArray[np.float64]) -> float:
    """Return the root mean square without the largest hundredth, which may be outliers.

    Of eight parts of the values, those with less than half of the largest root mean square do not
    count: a sensor can repeat its value at rest.
    """
    size = np.sum(values**2, axis=1)
    most = np.quantile(size, 0.99, method="higher")
    parts = np.array_split(np.where(size <= most, size, np.nan), max(min(8, len(size) // 12), 1))
    means = np.array([np.nanmean(part) if np.isfinite(part).any() else 0.0 for part in parts])
    counting = np.concatenate([p for p, mean in zip(parts, means) if 4 * mean >= means.max()])
    return float(np.sqrt(np.nanmean(counting) / values.shape[1]))
