"""Do a log's positions and rates tell the same story? Mixed units and conventions show there.

Positions are differenced over half a second and compared with the mean of the rates in between.
Radians against degrees, metres against millimetres, quaternions in another order: each shows as a
factor, or as a much better fit in another convention.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.measurements import Measurements, Samples

_FACTORS = {
    180 / np.pi: "degrees",
    1000.0: "millimetres",
    100.0: "centimetres",
}
_SCALAR_LAST = "the quaternion seems to be in the order x, y, z, w; it must be qw, qx, qy, qz"
_INVERSE = "the quaternion seems to turn W into B; it must be that of R_WB, B's axes in W"
_IN_WORLD = "the angular velocity seems to be given in the world; call its columns wx, wy, wz"
_IN_BODY = "the angular velocity seems to be given in the body; call its columns bwx, bwy, bwz"
_CLEAR = 0.98  # correlation from which on a factor, or another convention, is no accident
_WINDOW = 20_000
_STEP = 0.5  # [s]


@dataclass(frozen=True)
class Findings:
    """What a check found: `errors` have a clear cause and remedy, `warnings` have not."""

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def check_consistency(measurements: Measurements) -> Findings:
    """Compare positions with rates, of the joints and of the base."""
    found = Findings()
    for k, joint in enumerate(measurements.joint_names):
        positions, rates = (
            Samples(samples.time, samples.value[:, k : k + 1])
            for samples in (measurements.encoders, measurements.joint_rates)
        )
        _check_vector(positions, rates, f"q:{joint}", f"qd:{joint}", "rad", found)
    _check_vector(measurements.position, measurements.velocity, "x,y,z", "vx,vy,vz", "m", found)
    _check_attitude(measurements, found)
    return found


def _check_vector(
    positions: Samples, rates: Samples, name: str, rate_name: str, unit: str, found: Findings
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
        for factor, other in _FACTORS.items():
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
        found.warnings.append(f"{name} does not change as {rate_name} says")


def _check_attitude(measurements: Measurements, found: Findings) -> None:
    pairs = _pairs(measurements.attitude, measurements.gyro)
    if pairs is None:
        return
    first, second, elapsed, w_B = pairs

    straight, scalar_last = [0, 1, 2, 3], [3, 0, 1, 2]

    def attitudes(order: list[int], inverse: bool) -> tuple[Rotation, Rotation]:
        """Return R_WB before and after if the quaternions' entries mean this."""
        R = [Rotation.from_quat(q[:, order], scalar_first=True) for q in (first, second)]
        return (R[0].inv(), R[1].inv()) if inverse else (R[0], R[1])

    def turning(before: Rotation, after: Rotation) -> NDArray[np.float64]:
        return (before.inv() * after).as_rotvec() / elapsed

    as_read = attitudes(straight, False)
    w_by_attitude = turning(*as_read)
    slope, correlation = _compare(w_by_attitude, w_B)
    if correlation > _CLEAR:
        if 0.9 < slope < 1.1:
            return
        for factor, other in _FACTORS.items():
            if abs(slope * factor - 1) < 0.05:
                found.errors.append(
                    f"the angular velocity is {1 / slope:.3g} times as large as the attitude "
                    f"turns: is it in {other}/s? It must be in rad/s"
                )
                return
    w_if_in_W = as_read[0].apply(w_B)  # what was read, if wx, wy, wz were
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
            (turning(*R_WB), w_B, text),
            (turning(*R_WB), R_WB[0].inv().apply(w_if_in_W), text),
        ]
    for moved, w, text in explanations:
        slope, other = _compare(moved, w)
        # Noise is the same in every convention: what explains so much more of it is no accident.
        if other > _CLEAR and 0.9 < slope < 1.1 and 1 - other < 0.2 * (1 - correlation):
            found.errors.append(text)
            return
    if correlation < 0.5 and _is_motion(w_by_attitude, w_B):
        found.warnings.append("the attitude does not turn as the angular velocity says")


def _pairs(
    positions: Samples, rates: Samples
) -> tuple[NDArray, NDArray, NDArray, NDArray[np.float64]] | None:
    """Return values before and after intervals, their length (n, 1), and the mean rate in each.

    They overlap, and are as long as `_STEP` where there are samples in between: over one fast
    sensor's step, noise would drown the motion.
    """
    if len(positions) < 10 or len(rates) < 10:
        return None
    time, value = positions.time[:_WINDOW], positions.value[:_WINDOW]
    rates = rates.where(slice(0, np.searchsorted(rates.time, time[-1]) + 1))
    stride = max(int(_STEP / np.median(np.diff(time))), 1)
    before, after = time[:-stride], time[stride:]
    inside = (before >= rates.time[0]) & (after <= rates.time[-1])
    inside &= after - before <= 2 * _STEP
    if inside.sum() < 8:
        return None
    before, after = before[inside], after[inside]
    sums = cumulative_trapezoid(rates.value, rates.time, axis=0, initial=0.0)
    mean = np.stack(
        [np.interp(after, rates.time, c) - np.interp(before, rates.time, c) for c in sums.T],
        axis=1,
    )
    elapsed = (after - before)[:, None]
    return value[:-stride][inside], value[stride:][inside], elapsed, mean / elapsed


def _compare(moved: NDArray[np.float64], rate: NDArray[np.float64]) -> tuple[float, float]:
    """Return the factor that takes rates to motion best, and their correlation; no offset."""
    both, own, other = np.sum(moved * rate), np.sum(rate**2), np.sum(moved**2)
    if not (own > 0 and other > 0):
        return 1.0, 1.0 if own == other else 0.0
    return float(both / own), float(both / np.sqrt(own * other))


def _is_motion(moved: NDArray[np.float64], rate: NDArray[np.float64]) -> bool:
    """Whether neighbouring intervals agree: what differences of noise never do."""

    def smooth(values: NDArray[np.float64]) -> bool:
        size = np.sum(values**2)
        return bool(np.sum(values[1:] * values[:-1]) > 0.5 * size > 0)

    return smooth(moved) and smooth(rate)
