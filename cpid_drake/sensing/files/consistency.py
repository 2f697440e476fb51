"""Compares a log's positions with its rates, to find wrong units and conventions.

Differences of positions over half a second are compared with the mean of the rates in the same half
second. A wrong unit shows as a factor between them, such as 180/π for degrees. A wrong convention,
such as another order of the quaternion's entries, shows as a much better agreement in that
convention.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.measurements import Measurements, Samples

_FACTORS = {
    180 / np.pi: ("degrees", "rad"),
    1000.0: ("millimetres", "m"),
    100.0: ("centimetres", "m"),
}
_SCALAR_LAST = "the quaternion seems to be in the order x, y, z, w; it must be qw, qx, qy, qz"
_INVERSE = "the quaternion seems to be that of R_BW; it must be that of R_WB, B's axes in W"
_IN_WORLD = "the angular velocity seems to be expressed in the world; name its columns wx, wy, wz"
_IN_BODY = "the angular velocity seems to be expressed in the body; name its columns bwx, bwy, bwz"
_CLEAR = 0.98
"""Correlation above which a factor, or another convention, is certain."""

_SLOWEST = 0.5
"""Step from sample to sample [s] above which the time may be in another unit."""

AGREES = 0.2
"""Largest mismatch of positions and rates that agree."""

_MOST = 20_000
"""Largest number of differences that are compared, evenly distributed over the log."""

_STEP = 0.5
"""Length of the differences [s]."""


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
        positions, rates = (
            Samples(samples.time, samples.value[:, k : k + 1])
            for samples in (measurements.encoders, measurements.joint_rates)
        )
        units = ("rad", "m") if sliding is None else ("m" if joint in sliding else "rad",)
        _check_vector(positions, rates, f"q:{joint}", f"qd:{joint}", units, found)
    _check_vector(measurements.position, measurements.velocity, "x,y,z", "vx,vy,vz", ("m",), found)
    _check_attitude(measurements, found)
    return found


_Comparison = tuple[Callable[[Samples, Samples], float | None], Samples, Samples]


def _clock_unit(measurements: Measurements) -> str | None:
    """Return the unit of the time if it is not s: positions and rates agree with that unit only."""
    joints = measurements.encoders, measurements.joint_rates
    pairs = [joints, (measurements.position, measurements.velocity)]
    comparisons: list[_Comparison] = [(rate_mismatch, *pair) for pair in pairs]
    comparisons.append((attitude_mismatch, measurements.attitude, measurements.gyro))
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


def _mismatch(moved: NDArray[np.float64], rate: NDArray[np.float64]) -> float:
    size = max(np.sum(moved**2), np.sum(rate**2))
    return float(np.sqrt(np.sum((moved - rate) ** 2) / size)) if size > 0 else 0.0


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
    first, second, elapsed, mean_rate = pairs
    moved = (second - first) / elapsed
    slope, correlation = _compare(moved, mean_rate)
    if correlation < -_CLEAR and 0.9 < -slope < 1.1:
        found.errors.append(f"{rate_name} is the rate of {name} with the opposite sign")
    elif correlation > _CLEAR and not 0.9 < slope < 1.1:
        for factor, (other, unit) in _FACTORS.items():
            if unit not in units:
                continue
            if abs(slope / factor - 1) < 0.05:
                found.errors.append(
                    f"{name} changes {round(slope, 1):g} times as fast as {rate_name} says: is it "
                    f"in {other}? It must be in {unit}"
                )
                return
            if abs(slope * factor - 1) < 0.05:
                found.errors.append(
                    f"{rate_name} says {1 / slope:.3g} times as much as {name} changes: is it in "
                    f"{other}/s? It must be in {unit}/s"
                )
                return
        found.warnings.append(f"{name} changes {slope:.3g} times as fast as {rate_name} says")
    elif correlation < 0.5 and _is_motion(moved, mean_rate):
        found.warnings.append(f"{name} does not change at the rate that {rate_name} gives")


def _check_attitude(measurements: Measurements, found: Findings) -> None:
    pairs = _pairs(measurements.attitude, measurements.gyro)
    if pairs is None:
        return
    first, second, elapsed, w_B = pairs

    straight, scalar_last = [0, 1, 2, 3], [3, 0, 1, 2]

    def attitudes(order: list[int], inverse: bool) -> tuple[Rotation, Rotation]:
        """Return R_WB at the start and end of the intervals, for this convention of quaternions."""
        R = [Rotation.from_quat(q[:, order], scalar_first=True) for q in (first, second)]
        return (R[0].inv(), R[1].inv()) if inverse else (R[0], R[1])

    def angular_velocity(before: Rotation, after: Rotation) -> NDArray[np.float64]:
        """Return the mean angular velocity (n, 3) over each interval, in B."""
        return (before.inv() * after).as_rotvec() / elapsed

    as_read = attitudes(straight, False)
    w_by_attitude = angular_velocity(*as_read)
    slope, correlation = _compare(w_by_attitude, w_B)
    if correlation > _CLEAR:
        if 0.9 < slope < 1.1:
            return
        if abs(slope * 180 / np.pi - 1) < 0.05:
            found.errors.append(
                f"the angular velocity is {1 / slope:.3g} times the rate of the attitude: "
                "is it in degrees/s? It must be in rad/s"
            )
            return
    w_if_in_W = as_read[0].apply(w_B)  # the columns as read, if they were wx, wy, wz
    explanations = [
        (w_by_attitude, as_read[0].inv().apply(w_B), _IN_WORLD),
        (w_by_attitude, w_if_in_W, _IN_BODY),
    ]
    for order, inverse, text in (
        (scalar_last, False, _SCALAR_LAST),
        (straight, True, _INVERSE),
        (scalar_last, True, f"{_SCALAR_LAST}; and {_INVERSE}"),
    ):
        R_WB = attitudes(order, inverse)
        explanations += [
            (angular_velocity(*R_WB), w_B, text),
            (angular_velocity(*R_WB), R_WB[0].inv().apply(w_if_in_W), text),
        ]
    for moved, w, text in explanations:
        slope, agreement = _compare(moved, w)
        # Noise is the same in every convention, so a convention with a much smaller disagreement is
        # right.
        if agreement > _CLEAR and 0.9 < slope < 1.1 and 1 - agreement < 0.2 * (1 - correlation):
            found.errors.append(text)
            return
    if correlation < 0.5 and _is_motion(w_by_attitude, w_B):
        found.warnings.append("the attitude does not change at the measured angular velocity")


def _pairs(
    positions: Samples, rates: Samples
) -> tuple[NDArray, NDArray, NDArray, NDArray[np.float64]] | None:
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


def _compare(moved: NDArray[np.float64], rate: NDArray[np.float64]) -> tuple[float, float]:
    """Return the factor from rates to motion in the least-squares sense, and their correlation."""
    both, own, other = np.sum(moved * rate), np.sum(rate**2), np.sum(moved**2)
    if not (own > 0 and other > 0):
        return 1.0, 1.0 if own == other else 0.0
    return float(both / own), float(both / np.sqrt(own * other))


def _is_motion(moved: NDArray[np.float64], rate: NDArray[np.float64]) -> bool:
    """Return whether neighbouring intervals agree; in mere noise they do not."""

    def smooth(values: NDArray[np.float64]) -> bool:
        size = np.sum(values**2)
        return bool(np.sum(values[1:] * values[:-1]) > 0.5 * size > 0)

    return smooth(moved) and smooth(rate)
