"""Finds repeated samples: of stuck sensors, and of transports that send the last sample again.

Encoders repeat their values at rest, and slow joints repeat them between two steps of the encoder.
A repeated value is therefore wrong only if noise or motion should have changed it.
"""

from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.screening_limits import ScreeningLimits, SensorMemory
from cpid_drake.sensing.spikes import rough_orders

_MOST_DECIMALS = 9


@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeated samples among those of one sensor.

    Attributes:
        stuck: (N,) which samples only repeat an earlier one, although they should differ.
        count: (width,) how often each entry of the last sample has been repeated.
        varied: (width,) whether each entry has ever changed.

    """

    stuck: NDArray[np.bool_]
    count: NDArray[np.intp]
    varied: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Expected:
    """How much the samples of a sensor should vary.

    Attributes:
        sigma: σ of every entry: noise, quantization and rounding together.
        noise: (width,) σ of the white noise of each entry; of attitudes (3,), about three axes.
        step: quantization step or rounding of the values; 0 for none.
        of_joints: whether the values are joint positions. Joints do not stop abruptly, but
            thrusters may stop the base, and rates may be constant between changes.
        travelled: (N, width) least displacement since the first sample according to a sensor of
            rates; None without such a sensor.
        rate_sigma: σ of the sensor of rates.

    """

    sigma: float
    noise: NDArray[np.float64]
    step: float
    of_joints: bool
    travelled: NDArray[np.float64] | None = None
    rate_sigma: float = 0.0


def find_repeats(
    time: NDArray[np.float64],
    value: NDArray[np.float64],
    known: int,
    memory: SensorMemory | None,
    expected: Expected,
    limits: ScreeningLimits,
) -> Repeats:
    """Return the samples that only repeat an earlier one, although noise or motion should show.

    A repeated sample is stuck

    - by noise: if noise would repeat the sample, or one entry that varied before, as often with a
      probability below `repeat_probability`;
    - if the joints move before it and stop within one sample interval: see `abrupt`. Samples are
      then stuck until the value changes;
    - if the joints' motion goes straight on after it, as when a transport sends a sample twice; or
    - if joint rates show that the joint moved.

    Args:
        time: (N,) increasing stamps; the first `known` were accepted before [s].
        value: (N, width) the samples.
        known: number of samples that were accepted before; they are not judged again.
        memory: what is remembered of the sensor; None before its first sample.
        expected: how much the samples should vary.
        limits: limits of screening.

    """
    N, width = value.shape
    first = max(known, 1)
    same = np.zeros((N, width), dtype=bool)
    same[1:] = value[1:] == value[:-1]
    stuck = np.zeros(N, dtype=bool)
    varied = memory.varied if memory else np.zeros(width, dtype=bool)
    before = memory.repeats if memory else np.zeros(width, dtype=np.intp)
    if first >= N:
        return Repeats(stuck, before, varied)
    if not same[first:].any():
        return Repeats(stuck, np.zeros_like(before), np.ones_like(varied))
    rows = np.arange(first, N)[:, None]
    changed = np.maximum.accumulate(np.where(same[first:], first - 1, rows))
    count = rows - changed + np.where(changed == first - 1, before, 0)
    varied = np.logical_or.accumulate(~same[first:]) | varied
    stuck[first:] |= _by_noise(value, count, varied, expected, limits)
    whole = np.asarray(same.all(axis=1))
    if expected.of_joints and whole.any():
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            stuck |= _stopped(time, value, whole, expected.sigma, limits)
            stuck |= _sent_again(time, value, whole, expected.sigma, limits)
    if expected.travelled is not None:
        start = expected.travelled[changed, np.arange(width)]
        moved = np.abs(expected.travelled[first:] - start)
        error = expected.sigma + expected.rate_sigma * (time[rows] - time[changed])
        shows = moved > _moves(limits) * error
        stuck[first:] |= (same[first:] & shows).any(axis=1)
    stuck[:known] = False
    return Repeats(stuck, count[-1], varied[-1])


def _moves(limits: ScreeningLimits) -> float:
    """Return the displacement in σ that shows motion: three samples then are as rough as a spike.

    The roughness of three samples that should lie on a line is a quarter of the deviation.
    """
    return 4 * limits.spike


def _by_noise(
    value: NDArray[np.float64],
    count: NDArray[np.intp],
    varied: NDArray[np.bool_],
    expected: Expected,
    limits: ScreeningLimits,
) -> NDArray[np.bool_]:
    """Return which samples noise would not repeat, from the count and variation at each."""
    noise = expected.noise
    if not noise.any():
        return np.zeros(len(count), dtype=bool)
    step = max(expected.step, _rounding(value))
    # The density of the difference of two errors at zero is 1/(2√π σ).
    with np.errstate(divide="ignore"):
        chance = np.minimum(step / (2 * np.sqrt(np.pi) * noise), 1.0)
        chance[noise == 0] = 1.0
        rarity = np.log(np.append(chance.prod(), chance))
        most = np.where(rarity < 0, np.log(limits.repeat_probability) / rarity, np.inf)
    stuck = count.min(axis=1) > most[0]
    if noise.size == count.shape[1]:
        stuck |= ((count > most[1:]) & varied).any(axis=1)
    return np.asarray(stuck)


def _rounding(value: NDArray[np.float64]) -> float:
    """Return the unit of the last decimal if all values are decimal numbers of few digits, else 0.

    Files often contain rounded values, which repeat themselves more often than the noise does.
    """
    for decimals in range(_MOST_DECIMALS + 1):
        if (np.round(value, decimals) == value).all():
            return float(10.0**-decimals)
    return 0.0


def _stopped(
    time: NDArray[np.float64],
    value: NDArray[np.float64],
    whole: NDArray[np.bool_],
    sigma: float,
    limits: ScreeningLimits,
) -> NDArray[np.bool_]:
    """Return which samples repeat one at which the motion stopped within a sample interval."""
    rows = np.arange(time.size)
    onset = whole.copy()
    onset[1:] &= ~whole[:-1]
    stops = np.zeros(time.size, dtype=bool)
    starts = np.flatnonzero(onset)
    starts = starts[starts >= 5]
    if starts.size:
        bends = next(islice(rough_orders(time, value), 1, None))
        usual = np.max([bends[starts - back] for back in (3, 4, 5)], axis=0)
        bend = bends[starts - 2]
        abrupt = (bend > limits.spike * sigma) & (bend > limits.abrupt * usual)
        stops[starts] |= abrupt.any(axis=1)
    source = np.maximum.accumulate(np.where(whole, 0, rows))
    return np.asarray(whole & stops[np.minimum(source + 1, time.size - 1)])


def _sent_again(
    time: NDArray[np.float64],
    value: NDArray[np.float64],
    whole: NDArray[np.bool_],
    sigma: float,
    limits: ScreeningLimits,
) -> NDArray[np.bool_]:
    """Return which samples repeat one although the motion goes straight on afterwards."""
    rows = np.arange(time.size)
    changes = np.flatnonzero(~whole)
    again = np.zeros(time.size, dtype=bool)
    if changes.size < 3:
        return again
    before, middle, after = changes[:-2], changes[1:-1], changes[2:]
    first = value[middle] - value[before]
    second = value[after] - value[middle]
    share = (time[middle] - time[before]) / (time[after] - time[before])
    bend = np.abs(first - share[:, None] * (first + second))
    least = np.minimum(np.abs(first), np.abs(second))
    straight = (first * second > 0) & (bend * limits.abrupt < least)
    again[middle] = (straight & (least > _moves(limits) * sigma)).any(axis=1)
    source = np.maximum.accumulate(np.where(whole, 0, rows))
    return np.asarray(whole & again[source])
