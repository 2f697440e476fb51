"""Which samples can be used: the rest is left out and counted."""

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import ATTITUDE, SENSORS

LONGEST_GAP = 3600.0
"""Stamps further apart than this cannot be of one identification [s]: a clock is wrong."""


def screen(measurements: Measurements) -> tuple[Measurements, dict[str, int]]:
    """Return the samples that can be used, and how many of each sensor could not.

    Left out are

    - samples with an entry that is not finite;
    - attitudes whose quaternion is more than 1e-3 off unit norm;
    - stamps that are further than `LONGEST_GAP` from most others: of a clock that jumps, or is not
      set yet; one in the far future costs no more than its own sample;
    - as few samples as possible for the stamps of the rest to increase; of repeated stamps the
      first stays.

    Quaternions are normalized; their sign has no meaning and stays as it is.

    Raises:
        InputError: samples that are not numbers, or whose shapes do not fit.

    """
    kept, rejected = {}, {}
    for name, samples in measurements.items():
        width = SENSORS[name].width(len(measurements.joint_names))
        try:
            time, value = np.asarray(samples.time, float), np.asarray(samples.value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"measurements: '{name}' is not made of numbers: {error}") from error
        if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
            raise InputError(
                f"measurements: '{name}' needs times (N,) and values (N, {width}), "
                f"not {time.shape} and {value.shape}"
            )
        value = value.reshape(time.size, width)
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
    """Return the indices, in their order, of the most stamps without a gap of `LONGEST_GAP`."""
    order = np.argsort(time)
    gaps = np.flatnonzero(time[order][1:] > time[order][:-1] + LONGEST_GAP)
    ends = np.concatenate([[0], gaps + 1, [time.size]])
    k = int(np.diff(ends).argmax())
    return np.sort(order[ends[k] : ends[k + 1]])


def _increasing(time: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the most stamps that strictly increase; of equal choices the first."""
    if (time[1:] > time[:-1]).all():
        return np.arange(time.size)
    # Backwards, by length: the largest first stamp of such a series, its index; and what follows.
    first, start = [], []
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
