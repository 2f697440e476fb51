"""The gyro's bias that a log shows: the attitude less the integral of the gyro's samples.

With the integral R(t) of the samples, all errors small, and what is measured less R(t) in W:

    R(t) δ(t) = δ₀ − ∫ R ds b − Σ S_kl ∫ R_k w_l ds + R w τ + R ε

of the bias b, errors S of scales and axes, a delay τ of the attitude, and its mounting ε.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.noise_estimation import FEWEST
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.suite import SensorSuite

LONGEST = 60.0
"""Length of the part of a log that is integrated [s]."""

_GAP = 5.0  # intervals of the gyro that are a gap, in usual ones
_TURNS = 4  # most integrations, each with the bias and the delay of the one before
_LINEAR = 0.1  # of the attitude's noise: a turn by so little changes no derivative
_OFFSET, _BIAS = 1.0, 1.0  # σ of what nothing is known of [rad, rad/s]
_BIASES, _DELAY = slice(3, 6), 15  # places among the unknowns
_EDGE = 0.2  # part of the gyro's samples at both ends in which no attitude is compared [s]


@dataclass(frozen=True, eq=False)
class GyroBias:
    """A bias that a log shows.

    Attributes:
        value: (3,) in B; NaN about axes that the gyro does not measure [rad/s].
        sigma: (3,) of it, with plausible errors of scales, axes, stamps and mounting [rad/s].
        seconds: time over which the gyro is integrated [s].

    """

    value: Array
    sigma: Array
    seconds: float

    @property
    def size(self) -> float:
        """Root mean square of the axes that the gyro measures, with their σ [rad/s]."""
        return float(np.sqrt(np.nanmean(self.value**2 + self.sigma**2)))

    def ratio(self, declared: float) -> float:
        """Return the largest bias in σ, if one of `declared` [rad/s] is assumed."""
        return float(np.nanmax(np.abs(self.value) / np.hypot(self.sigma, declared)))


def gyro_bias(log: Log, suite: SensorSuite) -> GyroBias | None:
    """Return the bias that a screened log shows; None without an attitude, or for too few samples.

    Args:
        log: the log.
        suite: the sensors' noise.

    """
    if not {"attitude", "gyro"} <= suite.present().keys():
        return None
    gyro, attitude = _part(log)
    if min(len(gyro), len(attitude)) < FEWEST:
        return None
    seconds = float(np.ptp(attitude.time))
    measured = Rotation.from_quat(attitude.value, scalar_first=True)
    prior = np.repeat([_OFFSET, _BIAS, *_sizes()], [3, 3, 3, 6, 1, 3])
    rows, sigma = np.diag(1 / prior), float(suite.sigmas("attitude").max())
    total = np.zeros(len(prior))  # of bias and delay, which are not linear
    fastest = float(np.abs(gyro.value).max())
    for _ in range(_TURNS):
        times = attitude.time - total[_DELAY]
        change, columns = _linear(gyro, times, measured, total[_BIASES])
        A = np.vstack([columns / sigma, rows])
        b = np.append(change / sigma, -rows @ total)
        solution = np.linalg.lstsq(A, b, rcond=None)[0]
        total[_DELAY] += solution[_DELAY]
        total[_BIASES] += solution[_BIASES]
        turned = seconds * np.abs(solution[_BIASES]).max() + fastest * abs(solution[_DELAY])
        if turned < _LINEAR * sigma:
            break
    bias = total[_BIASES]
    chi = max(float(np.mean(((change - columns @ solution) / sigma) ** 2)), 1.0)
    variance = chi * np.diag(np.linalg.inv(A.T @ A))[_BIASES]
    # By every other sample, the error of the integral by trapezoids is four times as large.
    half = gyro.where(slice(None, None, 2))
    inside = times <= half.time[-1]
    of_half = Rotation.from_quat(attitude.value[inside], scalar_first=True)
    change, columns = _linear(half, times[inside], of_half, bias)
    A, b = np.vstack([columns / sigma, rows]), np.append(change / sigma, -rows @ total)
    variance += (np.linalg.lstsq(A, b, rcond=None)[0][_BIASES] / 3) ** 2
    walk = float(suite.sigmas("gyro")[0]) ** 2 / (suite["gyro"].rate * seconds)
    is_measured = np.ptp(gyro.value, axis=0) > 0
    return GyroBias(
        np.where(is_measured, bias, np.nan),
        np.where(is_measured, np.sqrt(variance + walk), np.nan),
        seconds,
    )


def _sizes() -> Iterator[float]:
    """Yield plausible σ of scales, axes, the delay between two sensors, and the mounting."""
    for name, count in (("scale", 1), ("misalignment", 1), ("delay", 2), ("mounting", 1)):
        yield float(KINDS[name].sigma * KINDS[name].to_SI * np.sqrt(count))


def _part(log: Log) -> tuple[Samples, Samples]:
    """Return the gyro's samples in the longest part without a gap, and the attitudes in it."""
    gyro, attitude = log.gyro, log.attitude
    steps = np.diff(gyro.time)
    if not len(steps):
        return gyro, attitude
    edges = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    part = max(np.split(np.arange(len(gyro)), edges), key=len)
    start = max(gyro.time[part[0]], attitude.time[0] if len(attitude) else 0.0)
    part = part[(gyro.time[part] >= start) & (gyro.time[part] <= start + LONGEST)]
    if not len(part):
        return gyro.where(part), attitude.where(slice(0))
    gyro = gyro.where(part)
    first, last = gyro.time[0] + _EDGE, gyro.time[-1] - _EDGE
    inside = (attitude.time >= first) & (attitude.time <= last)
    return gyro, attitude.where(inside)


def _linear(gyro: Samples, times: Array, measured: Rotation, bias: Array) -> tuple[Array, Array]:
    """Return R δ (3 N,) at the attitudes, and its derivatives (3 N, 19) by all errors."""
    w, dt = gyro.value - bias, np.diff(gyro.time)
    steps = Rotation.from_rotvec((w[1:] + w[:-1]) / 2 * dt[:, None])
    R = Rotation.concatenate([Rotation.identity(1), _products(steps)])
    before = np.clip(np.searchsorted(gyro.time, times, side="right") - 1, 0, len(dt) - 1)
    share = (times - gyro.time[before]) / dt[before]
    w_at = w[before] + share[:, None] * (w[before + 1] - w[before])
    # From the sample before an attitude on, at the rate in the middle.
    R_at = R[before] * Rotation.from_rotvec(
        (w[before] + w_at) / 2 * (times - gyro.time[before])[:, None]
    )
    turned = (measured[0] * R_at[0].inv()) * R_at  # of the first attitude
    change = turned.apply((turned.inv() * measured).as_rotvec())
    matrices = (measured[0] * R_at[0].inv() * R).as_matrix()
    products = matrices[:, :, :, None] * w[:, None, None, :]  # of R's column k and w_l
    kinds = np.concatenate([matrices, products.reshape(len(w), 3, 9)], axis=2)
    integrals = cumulative_trapezoid(kinds, gyro.time, axis=0, initial=0.0)
    at = integrals[before] + share[:, None, None] * (integrals[before + 1] - integrals[before])
    by_S = at[:, :, 3:]
    order = [*np.flatnonzero(np.eye(3).ravel()), *np.flatnonzero(1 - np.eye(3).ravel())]
    late = -turned.apply(w_at)[:, :, None]
    offset = np.broadcast_to(np.eye(3), at[:, :, :3].shape)
    parts = [offset, -at[:, :, :3], -by_S[:, :, order], late, turned.as_matrix()]
    return change.ravel(), np.concatenate(parts, axis=2).reshape(-1, 19)


def _products(steps: Rotation) -> Rotation:
    """Return the products of all rotations up to each one."""
    count = 1
    while count < len(steps):
        steps = Rotation.concatenate([steps[:count], steps[:-count] * steps[count:]])
        count *= 2
    return steps
