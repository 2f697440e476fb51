"""Compares a log's positions with its rates, to find wrong units and conventions.

Differences of positions over half a second are compared with the mean of the rates in the same half
second. Their mismatch, relative to the motion, is the score of a convention. Another convention,
such as degrees or another order of the quaternion's entries, is named if it explains what the
expected one does not.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.logs.log import Measurements, Samples

AGREES = 0.2
"""Largest mismatch of positions and rates that agree; a wrong unit, axis or sign gives 0.5."""

_DIFFERS = 0.5
"""Mismatch of positions and rates that are of different motions."""

_CLEARLY = 2.0
"""Ratio of mismatches from which another convention explains the motion clearly better."""

_SLOWEST = 0.5
"""Step from sample to sample [s] above which the time may be in another unit."""

_MOST = 20_000
"""Largest number of differences that are compared, evenly distributed over the log."""

_STEP = 0.5
"""Length of the differences [s]."""

_SIZES = {
    "rad": {"degrees": np.pi / 180},
    "m": {"millimetres": 1e-3, "centimetres": 1e-2},
}
"""By expected unit, other units and their sizes."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Findings:
    """Contradictions in a log: `errors` have a known cause and remedy; `warnings` do not."""

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def check_consistency(
    measurements: Measurements, sliding: Collection[str] | None = None
) -> Findings:
    """Compare positions with rates, both of the joints and of the base.

    Args:
        measurements: the samples.
        sliding: names of the joints that slide instead of turning; None if that is not known.

    """
    found = Findings()
    clock = _clock_unit(measurements)
    if clock is not None:
        found.errors.append(
            f"positions and rates agree if the time is in {clock}: it must be in s (time.unit of a "
            "map of columns)"
        )
        return found
    for k, joint in enumerate(measurements.joint_names):
        pair = [
            Samples(samples.time, samples.value[:, k : k + 1])
            for samples in (measurements.encoders, measurements.joint_rates)
        ]
        units = ("rad", "m") if sliding is None else ("m" if joint in sliding else "rad",)
        _check_vector(pair[0], pair[1], f"q:{joint}", f"qd:{joint}", units, found)
    _check_vector(measurements.position, measurements.velocity, "x,y,z", "vx,vy,vz", ("m",), found)
    _check_attitude(measurements, found)
    return found


def _clock_unit(measurements: Measurements) -> str | None:
    """Return the unit of the time if it is not s: positions and rates agree with that unit only."""
    m = measurements
    comparisons: list[tuple[Callable[[Samples, Samples], float | None], Samples, Samples]] = [
        (rate_mismatch, m.encoders, m.joint_rates),
        (rate_mismatch, m.position, m.velocity),
        (attitude_mismatch, m.attitude, m.gyro),
    ]
    comparisons = [each for each in comparisons if min(len(each[1]), len(each[2])) > 9]
    if not comparisons or np.median(np.diff(comparisons[0][1].time)) < _SLOWEST:
        return None
    for unit, scale in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        for compare, *pair in comparisons:
            positions, rates = (Samples(s.time * scale, s.value) for s in pair)
            mismatch = compare(positions, rates)
            if mismatch is not None and mismatch < AGREES:
                return unit
    return None


def rate_mismatch(positions: Samples, rates: Samples) -> float | None:
    """Return the difference of positions' changes from rates, relative to the changes.

    0 means that they agree; a wrong unit, axis or sign gives 0.5 or more. None for too few samples.
    """
    pairs = _pairs(positions, rates)
    if pairs is None:
        return None
    first, second, elapsed, mean_rate = pairs
    return _mismatch((second - first) / elapsed, mean_rate)


def attitude_mismatch(attitude: Samples, gyro: Samples) -> float | None:
    """Return the difference of attitudes' changes from angular velocities in B; as `rate_mismatch`.

    Args:
        attitude: quaternions of R_WB (N, 4), scalar first.
        gyro: w_WB_B (N, 3) [rad/s].

    """
    pairs = _pairs(attitude, gyro)
    if pairs is None:
        return None
    first, second, elapsed, w_B = pairs
    before, after = (Rotation.from_quat(q, scalar_first=True) for q in (first, second))
    return _mismatch((before.inv() * after).as_rotvec() / elapsed, w_B)


def _mismatch(moved: Array, rate: Array) -> float:
    size = max(np.sum(moved**2), np.sum(rate**2))
    return float(np.sqrt(np.sum((moved - rate) ** 2) / size)) if size > 0 else 0.0


def _better(expected: float, others: list[tuple[str, Array, Array]]) -> str | None:
    """Return the sentence of the convention that explains the motion clearly better."""
    text, least = min(
        ((text, _mismatch(moved, rate)) for text, moved, rate in others), key=lambda each: each[1]
    )
    return text if least < AGREES and _CLEARLY * least < expected else None


def _check_vector(
    positions: Samples,
    rates: Samples,
    name: str,
    rate_name: str,
    units: tuple[str, ...],
    found: Findings,
) -> None:
    pairs = _pairs(positions, rates)
    if pairs is None:
        return
    first, second, elapsed, rate = pairs
    moved = (second - first) / elapsed
    others = [(f"{rate_name} is the rate of {name} with the opposite sign", moved, -rate)]
    for unit in units:
        for other, size in _SIZES[unit].items():
            text = f"{name} changes {1 / size:.3g} times as fast as {rate_name} says: is it in "
            others.append((f"{text}{other}? It must be in {unit}", size * moved, rate))
            text = f"{rate_name} says {1 / size:.3g} times as much as {name} changes: is it in "
            others.append((f"{text}{other}/s? It must be in {unit}/s", moved, size * rate))
    mismatch = _mismatch(moved, rate)
    better = _better(mismatch, others)
    if better is not None:
        found.errors.append(better)
    elif mismatch > _DIFFERS and _is_motion(moved, rate):
        found.warnings.append(
            f"{name} does not change at the rate that {rate_name} gives: they differ by "
            f"{mismatch:.0%}"
        )


def _check_attitude(measurements: Measurements, found: Findings) -> None:
    pairs = _pairs(measurements.attitude, measurements.gyro)
    if pairs is None:
        return
    first, second, elapsed, w_B = pairs

    def moved(order: list[int], inverse: bool) -> tuple[Rotation, Array]:
        """Return R_WB at the start, and angular velocities in B, for a convention."""
        R = [Rotation.from_quat(q[:, order], scalar_first=True) for q in (first, second)]
        before, after = (R[0].inv(), R[1].inv()) if inverse else (R[0], R[1])
        return before, (before.inv() * after).as_rotvec() / elapsed

    R_WB, by_attitude = moved([0, 1, 2, 3], False)
    in_W = R_WB.apply(w_B)  # the columns as read, if they were wx, wy, wz
    name = "the angular velocity seems to be"
    order = "the quaternion seems to be in the order x, y, z, w; it must be qw, qx, qy, qz"
    inverse = "the quaternion seems to be that of R_BW; it must be that of R_WB, B's axes in W"
    degrees = np.pi / 180
    others = [
        (
            f"the angular velocity says {1 / degrees:.3g} times as much as the attitude turns: is "
            "it in degrees/s? It must be in rad/s",
            by_attitude,
            degrees * w_B,
        ),
        (
            f"{name} expressed in the world; name its columns wx, wy, wz",
            by_attitude,
            R_WB.inv().apply(w_B),
        ),
        (f"{name} expressed in the body; name its columns bwx, bwy, bwz", by_attitude, in_W),
    ]
    for text, entries, turned in (
        (order, [3, 0, 1, 2], False),
        (inverse, [0, 1, 2, 3], True),
        (f"{order}; and {inverse}", [3, 0, 1, 2], True),
    ):
        R, w = moved(entries, turned)
        others += [(text, w, w_B), (text, w, R.inv().apply(in_W))]
    mismatch = _mismatch(by_attitude, w_B)
    better = _better(mismatch, others)
    if better is not None:
        found.errors.append(better)
    elif mismatch > _DIFFERS and _is_motion(by_attitude, w_B):
        found.warnings.append(
            f"the attitude does not change at the measured angular velocity: they differ by "
            f"{mismatch:.0%}"
        )


def _pairs(positions: Samples, rates: Samples) -> tuple[Array, Array, Array, Array] | None:
    """Return the values at both ends of n intervals, their lengths (n, 1), and the mean rates.

    The intervals overlap. They have the length `_STEP` if the sensor is faster than that: over one
    step of a fast sensor, the noise would be larger than the motion. Return None for fewer than
    eight intervals.
    """
    if len(positions) < 10 or len(rates) < 10:
        return None
    time, value = positions.time, positions.value
    stride = max(int(_STEP / np.median(np.diff(time))), 1)
    before, after = time[:-stride], time[stride:]
    inside = (before >= rates.time[0]) & (after <= rates.time[-1])
    inside &= after - before <= 2 * _STEP
    if inside.sum() < 8:
        return None
    chosen = np.flatnonzero(inside)
    chosen = chosen[:: -(-chosen.size // _MOST)]
    before, after = before[chosen], after[chosen]
    sums = cumulative_trapezoid(rates.value, rates.time, axis=0, initial=0.0)
    mean = np.stack(
        [np.interp(after, rates.time, c) - np.interp(before, rates.time, c) for c in sums.T],
        axis=1,
    )
    elapsed = (after - before)[:, None]
    return value[chosen], value[chosen + stride], elapsed, mean / elapsed


def _is_motion(moved: Array, rate: Array) -> bool:
    """Return whether neighbouring intervals agree; in mere noise they do not."""

    def smooth(values: Array) -> bool:
        size = np.sum(values**2)
        return bool(np.sum(values[1:] * values[:-1]) > 0.5 * size > 0)

    return smooth(moved) and smooth(rate)
