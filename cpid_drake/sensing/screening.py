"""Removes unusable samples and counts them."""

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import ATTITUDE, SENSORS

LONGEST_GAP = 3600.0
"""Longest time between two samples of one log [s]; with a longer one, a clock was wrong."""


def as_arrays(measurements: Measurements) -> Measurements:
    """Return measurements whose times (N,) and values (N, width) are arrays of numbers.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor.

    """
    samples = {}
    for name, given in measurements.items():
        width = SENSORS[name].width(len(measurements.joint_names))
        try:
            time, value = np.asarray(given.time, float), np.asarray(given.value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"measurements: '{name}' is not made of numbers: {error}") from error
        if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
            raise InputError(
                f"measurements: '{name}' needs times (N,) and values (N, {width}), "
                f"not {time.shape} and {value.shape}"
            )
        samples[name] = Samples(time, value.reshape(time.size, width))
    return measurements.updated(samples)


def screen(measurements: Measurements) -> tuple[Measurements, dict[str, int]]:
    """Return the usable samples, and the number of unusable ones by sensor.

    These samples are unusable:

    - samples with an entry that is not finite;
    - attitudes whose quaternion has a norm that differs from 1 by more than 1e-3;
    - samples whose stamps are more than `LONGEST_GAP` from most others, for example from a clock
      that jumped or was not yet set. A single stamp in the far future does not make other samples
      unusable;
    - samples out of order: as few as possible are removed so that the stamps increase; of samples
      with the same stamp the first is kept.

    Quaternions are normalized; their sign, which has no meaning, is kept.

    Raises:
        InputError: for the same reasons as `as_arrays`.

    """
    kept, rejected = {}, {}
    for name, samples in as_arrays(measurements).items():
        time, value = samples.time, samples.value
        usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
        if SENSORS[name].quantity is ATTITUDE:
            with np.errstate(over="ignore"):
                norm = np.linalg.norm(value, axis=1)
            usable &= np.abs(norm - 1) < 1e-3
            value = value / np.where(usable, norm, 1.0)[:, None]
        index = np.flatnonzero(usable)
        index = index[_together(time[index])]
        index = index[_increasing(time[index])]
        everything = index.size == time.size
        kept[name] = Samples(time, value) if everything else Samples(time[index], value[index])
        rejected[name] = time.size - index.size
    return measurements.updated(kept), rejected


def _together(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices, ascending, of the largest group of stamps without a too long gap."""
    order = np.argsort(time)
    gaps = np.flatnonzero(time[order][1:] > time[order][:-1] + LONGEST_GAP)
    ends = np.concatenate([[0], gaps + 1, [time.size]])
    k = int(np.diff(ends).argmax())
    return np.sort(order[ends[k] : ends[k + 1]])


def _increasing(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the longest strictly increasing subsequence of the stamps.

    Of several longest ones, return the first.
    """
    if (time[1:] > time[:-1]).all():
        return np.arange(time.size)
    # The loop goes from the last stamp to the first. For each length of a subsequence, the lists
    # contain minus its largest possible first stamp, and that stamp's index. `following` links each
    # stamp to its successor.
    first: list[float] = []
    start: list[int] = []
    following = np.full(time.size, -1)
    for k in range(time.size - 1, -1, -1):
        length = bisect_left(first, -time[k])
        if length:
            following[k] = start[length - 1]
        first[length : length + 1], start[length : length + 1] = [-time[k]], [k]
    series = [start[-1]]
    while following[series[-1]] >= 0:
        series.append(following[series[-1]])
    return np.array(series)
