"""Converts sensor samples of different rates to motion at common times, with its covariance.

The method is regression splines: least squares in a B-spline basis of degree 5. Each piece holds
about the same number of samples; Akaike's criterion chooses the number of pieces. Rates that no
sensor measures are the derivatives of the splines. The attitude is the spline of the quaternion
times the exponential of a spline, so that the base may rotate by any angle. No times are in gaps of
the samples.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.sparse import block_array, bsr_array, csr_array, kron, vstack
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.plane import levelled
from cpid_drake.dynamics.rotations import angular_velocity, right_jacobian, rotate, skew
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples, without_flips
from cpid_drake.logs.splines import (
    DEGREE,
    basis,
    best,
    covariance,
    in_gap,
    knots_of,
    regression_spline,
    solve,
)
from cpid_drake.sensors.suite import SensorSuite

WINDOW, MARGIN = 30.0, 0.2
"""Length of the windows in which logs of more than twice this length are smoothed [s], and the
margin on each side as a share of it: the time for a window grows faster than its length."""

FEWEST_IN_WINDOW = 60
"""Least number of samples of the slowest required sensor in a window."""


def smooth(
    given: Log,
    suite: SensorSuite,
    times: ArrayLike | None = None,
    *,
    with_position: bool = True,
    within: tuple[float, float] = (-np.inf, np.inf),
    normal_B: Array | None = None,
) -> tuple[Motion, Array]:
    """Return the motion at N common times, smoothed from samples of different rates.

    Args:
        given: samples of the sensors; attitude, position and encoders are required. Samples
            of sensors that the suite lacks are left out.
        suite: the sensors' errors.
        times: (N,) [s]; default: ten per second where all sensors have samples.
        with_position: whether to compute the base's position and velocity, else they are zero.
        within: if no times are given, the interval [start, end) in which they must be [s].
        normal_B: (3,) normal in B of a table, whose tilt and height are then not smoothed but zero;
            None for a spacecraft that floats freely.

    Returns:
        The motion, and the covariance (N, n, n) of attitude (3, right perturbation, in B), angular
        velocity (3, in B), position (3) and velocity (3) in W, joint positions (J) and joint rates
        (J).

    Raises:
        InputError: too few samples of a required sensor, or no times inside the samples.

    """
    present = suite.present()
    kept = {name: s for name, s in given.samples.items() if name in present}
    log = Log(given.joint_names, kept)
    if normal_B is not None:
        log = _in_plane(log, normal_B)
    needed = [log.encoders, log.attitude, *([log.position] if with_position else [])]
    for name, samples, least in zip(("encoders", "attitude", "position"), needed, (8, 4, 4)):
        if len(samples) < least:
            raise InputError(
                f"smoothing needs at least {least} samples of {name}, not {len(samples)}"
            )
    start, end = max(s.time[0] for s in needed), min(s.time[-1] for s in needed)
    if times is None:
        first, last = max(start, within[0]), min(end, within[1])
        grid = np.arange(np.ceil(first * 10), np.floor(last * 10) + 1) / 10
        grid = grid[(grid >= first) & (grid <= end) & (grid < within[1])]
        for samples in needed:
            grid = grid[~in_gap(samples.time, grid)]
        times = grid
    times = np.asarray(times, dtype=float)
    if not (len(times) and times[0] >= start - 1e-9 and times[-1] <= end + 1e-9):
        raise InputError(f"all sensors have samples from {start:g} to {end:g} s only")

    def parts(*names: str) -> list[tuple[Samples, int, float]]:
        """Return samples, order of the derivative, and σ, from the first of values to the last."""
        inside = log.between(log[names[0]].time[0], log[names[0]].time[-1])
        given = [(inside[name], nu, name) for nu, name in enumerate(names)]
        return [(s, nu, float(suite.sigmas(name)[0])) for s, nu, name in given if len(s)]

    q, qdot, joint_errors = _smooth_vectors(parts("encoders", "joint_rates"), times, finer=True)
    attitude, w_B, attitude_errors = _smooth_attitude(log, suite, times, normal_B)
    N, J = q.shape
    p_WB, v_WB, place_errors = np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 2, 2))
    if with_position:
        place = parts("position", "velocity")
        p_WB, v_WB, place_errors = _smooth_vectors(place, times, finer=normal_B is not None)
    whole = np.zeros((N, 12 + 2 * J, 12 + 2 * J))
    whole[:, :6, :6] = attitude_errors
    for first, width, errors in ((6, 3, place_errors), (12, J, joint_errors)):
        for k in range(first, first + width):
            both = np.array([k, k + width])
            whole[:, both[:, None], both] = errors
    motion = Motion(
        log.joint_names,
        times,
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=p_WB,
        w_WB=attitude.apply(w_B),
        v_WB=v_WB,
        q=q,
        qdot=qdot,
    )
    return motion, whole


def smooth_windows(
    given: Log, suite: SensorSuite, *, with_position: bool = True, normal_B: Array | None = None
) -> Iterator[tuple[Motion, Array]]:
    """Yield the motion of a log of any length, smoothed in windows; see `smooth`.

    A window has a margin of samples on both sides, because splines are less accurate near their
    ends. The gyro bias is estimated in each window. Windows with too few samples of a required
    sensor are left out.

    Raises:
        InputError: all windows have too few samples of a required sensor.

    """
    start, end = given.interval
    needed = ["encoders", "attitude", *(["position"] if with_position else [])]
    steps = [np.median(np.diff(given[n].time)) for n in needed if len(given[n]) > 1]
    seconds = max(WINDOW, FEWEST_IN_WINDOW * float(max(steps, default=0.0)))
    starts = np.arange(start, end, seconds) if end - start > 2 * WINDOW else np.array([start])
    refused, is_empty = None, True
    for first in starts.tolist():
        last = first + seconds if first < starts[-1] else np.inf
        around = given.between(first - MARGIN * seconds, last + MARGIN * seconds)
        try:
            smoothed = smooth(
                around,
                suite,
                with_position=with_position,
                within=(first, last),
                normal_B=normal_B,
            )
        except InputError as error:
            refused = error
            continue
        is_empty = False
        yield smoothed
    if is_empty and refused is not None:
        raise refused


def _in_plane(log: Log, normal_B: Array) -> Log:
    """Return samples without their components out of the plane, which are noise."""
    samples = dict(log.samples)
    for name, given in samples.items():
        if name == "attitude":
            samples[name] = replace(given, value=levelled(given.value, normal_B))
        elif name == "gyro":
            samples[name] = replace(given, value=np.outer(given.value @ normal_B, normal_B))
        elif name in ("position", "velocity"):
            samples[name] = replace(given, value=given.value * [1.0, 1.0, 0.0])
    return Log(log.joint_names, samples)


def _smooth_vectors(
    parts: Sequence[tuple[Samples, int, float]], times: Array, *, finer: bool
) -> tuple[Array, Array, Array]:
    """Return values and rates (N, c) at times, and the covariance (N, 2, 2) of one channel.

    Args:
        parts: samples of the values or of their derivatives, the order of the derivative, and σ;
            first those of the values.
        times: (N,) [s].
        finer: see `best`.

    """
    given, count = parts[0][0], sum(len(samples) for samples, _, _ in parts)
    b = np.vstack([samples.value / sigma for samples, _, sigma in parts])
    width = int(np.count_nonzero(b.any(axis=0)))  # what a table holds must not decide

    def design(pieces: int) -> tuple[Array, csr_array]:
        knots = knots_of(given.time, pieces)
        blocks = [basis(knots, samples.time, nu) / sigma for samples, nu, sigma in parts]
        return knots, vstack(blocks, format="csr")

    def fit(pieces: int) -> tuple[float, Array]:
        x, chi = solve(design(pieces)[1], b)
        return chi, x

    pieces, x = best(fit, len(given), width, finer=finer)
    knots, A = design(pieces)
    chi = float(np.sum((A @ x - b) ** 2))
    C = covariance(A, chi, (count - A.shape[1]) * width)
    spline, both = BSpline(knots, x, DEGREE), [basis(knots, times, nu) for nu in (0, 1)]
    return spline(times), spline(times, 1), _errors(both, C, len(times))


def _errors(rows: Sequence[csr_array], C: Array, count: int) -> Array:
    """Return the covariance (N, k, k) at N times of what rows (N · k', n) say, in their order."""
    # J C Jᵀ
    J = np.concatenate([each.toarray().reshape(count, -1, len(C)) for each in rows], axis=1)
    return np.asarray(J @ C @ np.swapaxes(J, 1, 2))


def _smooth_attitude(
    log: Log, suite: SensorSuite, times: Array, normal_B: Array | None
) -> tuple[Rotation, Array, Array]:
    """Return attitude, angular velocity in B, and their covariance (N, 6, 6).

    R_WB is the spline of the attitude's quaternions, times exp(r) with the spline r, which follows
    the gyro, too: w = exp(−r) w_path + Jr(r) ṙ. Gauss and Newton's steps keep the derivatives at
    r = 0.
    """
    attitude, gyro = log.attitude, log.gyro
    gyro = gyro.where((gyro.time >= attitude.time[0]) & (gyro.time <= attitude.time[-1]))
    if suite.attitude is None:
        raise InputError("smoothing needs the errors of the attitude")
    knot_times = gyro.time if len(gyro) > len(attitude) else attitude.time
    path = regression_spline(Samples(attitude.time, without_flips(attitude.value)))

    whiten = suite.attitude.R_BS.T / suite.sigmas("attitude")[:, None]
    has_gyro = suite.gyro is not None and len(gyro) > 0
    sigma = float(suite.sigmas("gyro")[0]) if has_gyro else 1.0
    bias_row = 1 / max(suite.gyro.bias_sigma, 1e-8) if suite.gyro is not None and has_gyro else 1.0
    measured = Rotation.from_quat(attitude.value, scalar_first=True)
    # A gyro that integrates measures the mean since its sample before.
    since, weights = np.zeros(1), np.full(1, 2.0)
    if suite.gyro is not None and suite.gyro.integrates:
        points, weights = np.polynomial.legendre.leggauss(3)
        since = (points - 1) / (2 * suite.gyro.rate)
    middle = gyro.time + np.median(since)

    def moved(r: BSpline, at: Array) -> tuple[Rotation, Array]:
        """Return attitude and angular velocity in B (N, 3) of the path rotated by r."""
        # R = R_path exp(r),  w = exp(−r) w_path + Jr(r) ṙ
        turn, w_B = Rotation.from_rotvec(r(at)), angular_velocity(path(at), path(at, 1))
        R = Rotation.from_quat(path(at), scalar_first=True) * turn
        return R, turn.inv().apply(w_B) + rotate(right_jacobian(r(at)), r(at, 1))

    def residuals(r: BSpline, bias: Array) -> Array:
        # the mean of w over a sample, by Gauss and Legendre's rule
        w_B = sum(w / 2 * moved(r, gyro.time + t)[1] for t, w in zip(since, weights))
        turned = (moved(r, attitude.time)[0].inv() * measured).as_rotvec() @ whiten.T
        rates = (gyro.value - bias - w_B) / sigma
        return np.concatenate([turned.ravel(), rates.ravel(), -bias_row * bias])

    still = BSpline(path.t, np.zeros((len(path.c), 3)), DEGREE)
    b, w_ref = residuals(still, np.zeros(3)), moved(still, middle)[1]

    def of_w(knots: Array, at: Array, w: Array) -> csr_array:
        """Return the derivatives (3 N, 3 n) of w_B (N, 3) by the coefficients of r."""
        # δw = δṙ + w × δr
        numbers = np.arange(len(w) + 1)
        wx = bsr_array((skew(w), numbers[:-1], numbers), shape=(w.size, w.size))
        return kron(basis(knots, at, 1), np.eye(3)) + wx @ kron(basis(knots, at), np.eye(3))

    def design(pieces: int) -> tuple[Array, csr_array]:
        knots = knots_of(knot_times, pieces)
        biases = np.tile(np.eye(3), (len(gyro), 1)) / sigma
        blocks = [
            [kron(basis(knots, attitude.time), whiten), None],
            [of_w(knots, middle, w_ref) / sigma, biases],
            [None, bias_row * np.eye(3)],
        ]
        return knots, block_array(blocks, format="csr")

    def fit(pieces: int) -> tuple[float, Array]:
        x, chi = solve(design(pieces)[1], b[:, None])
        return chi, x[:, 0]

    width = 3.0 if normal_B is None else 1.0  # a base on a table rotates about one axis
    # Of one axis the criterion is less certain, and a bias is worse than noise.
    first = len(path.t) - 2 * DEGREE - 1
    samples = len(attitude) + len(gyro)
    pieces, x = best(fit, samples, width, first=first, finer=normal_B is not None)
    knots, A = design(pieces)
    for _ in range(2):  # r is small, but its square is not smaller than the noise
        left = residuals(BSpline(knots, x[:-3].reshape(-1, 3), DEGREE), x[-3:])
        x = x + solve(A, left[:, None])[0][:, 0]
    spline = BSpline(knots, x[:-3].reshape(-1, 3), DEGREE)
    chi = float(np.sum(residuals(spline, x[-3:]) ** 2))
    numbers = (len(attitude) + len(gyro)) * width - (A.shape[1] - 3) * width / 3
    C = covariance(A, chi, numbers)
    R, w_B = moved(spline, times)
    both = kron(basis(knots, times), np.eye(3)), of_w(knots, times, w_B)
    return R, w_B, _errors(both, C[:-3, :-3], len(times))
