"""Converts sensor samples of different rates to motion at common times, with its covariance.

The method is regression splines, that is, least squares in a B-spline basis. Each knot interval
contains about the same number of samples; Akaike's criterion chooses the number of intervals. Rates
that no sensor measures are the derivatives of the splines.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.plane import levelled
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.logs.attitude_smoothing import smooth_attitude
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.smoothed_motion import ErrorBlock, SmoothedMotion
from cpid_drake.logs.splines import (
    Basis,
    SplineFit,
    best_fit,
    bridge_gaps,
    fit_samples,
    measured_by,
    misfit_factor,
    smooth_joints,
)
from cpid_drake.sensors.sensors import ANGULAR_VELOCITY, ATTITUDE, POSITION, SENSORS, VELOCITY
from cpid_drake.sensors.suite import SensorSuite

WINDOW = 30.0
"""Least length of the windows in which long logs are smoothed [s].

The time for a window grows faster than its length.
"""

FEWEST = 60
"""Least number of samples of the slowest required sensor in a window."""

MARGIN = 0.2
"""Margin on each side of a window, as a share of its length: several intervals between knots."""

LONGEST_WHOLE = 60.0
"""Duration of logs that are smoothed as a whole [s]."""


def smooth(
    measurements: Measurements,
    suite: SensorSuite,
    times: ArrayLike | None = None,
    *,
    with_position: bool = True,
    within: tuple[float, float] | None = None,
    normal_B: NDArray[np.float64] | None = None,
) -> SmoothedMotion:
    """Return the motion at common times, smoothed from samples of different rates.

    Args:
        measurements: samples of the sensors; attitude, position and encoders are required. Samples
            of sensors that the suite lacks are left out.
        suite: the sensors' errors.
        times: (N,) [s]; default: ten per second in the interval in which all sensors have samples.
        with_position: whether to compute the base's position and velocity, else they are zero.
        within: if no times are given, the interval [start, end) in which they must be [s].
        normal_B: (3,) normal in B of a table, whose tilt and height are then not smoothed but zero;
            None for a spacecraft that floats freely.

    Raises:
        InputError: too few samples of a required sensor, or no times inside the samples.

    """
    measurements = measured_by(suite, measurements)
    if normal_B is not None:
        measurements = _in_plane(measurements, normal_B)
    joints = smooth_joints(measurements, suite)
    needed = {"attitude": measurements.attitude}
    if with_position:
        needed["position"] = measurements.position
    for name, samples in needed.items():
        if len(samples) < 4:
            raise InputError(f"smoothing needs at least 4 samples of {name}, not {len(samples)}")
    start = max(s.time[0] for s in (measurements.encoders, *needed.values()))
    end = min(s.time[-1] for s in (measurements.encoders, *needed.values()))
    if times is None and within is not None:
        first, last = max(start, within[0]), min(end, within[1])
        times = np.arange(np.ceil(first * 10), np.ceil(last * 10)) / 10
        times = times[(times >= first) & (times <= last)]
    elif times is None:
        times = np.linspace(start, end, max(int(np.ceil((end - start) * 10)), 3) + 1)
    times = np.asarray(times, dtype=float)
    if not (len(times) and times[0] >= start - 1e-9 and times[-1] <= end + 1e-9):
        raise InputError(f"all sensors have samples from {start:g} to {end:g} s only")

    # Shares of the three axes that vary: what a table holds must not decide on the splines.
    about, along = (1.0, 1.0) if normal_B is None else (1 / 3, 2 / 3)
    attitude, rate, attitude_error, bias = smooth_attitude(measurements, suite, times, about)
    position, velocity = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    position_error: list[ErrorBlock] = []
    if with_position:
        position, velocity, position_error = _smooth_position(measurements, suite, times, along)
    q, qdot, _ = np.moveaxis(joints.evaluate(times), 1, 0)
    telemetry = Telemetry(
        measurements.joint_names,
        times,
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=position,
        w_WB=attitude.apply(rate),
        v_WB=velocity,
        q=q,
        qdot=qdot,
    )
    J = q.shape[1]
    support, basis = _values_and_rates(joints.basis, times)
    joint_errors = [
        ErrorBlock(np.array([12 + j, 12 + J + j]), support, basis, joints.covariance)
        for j in range(J)
    ]
    return SmoothedMotion(telemetry, (attitude_error, *position_error, *joint_errors), bias)


def smooth_windows(
    measurements: Measurements,
    suite: SensorSuite,
    *,
    with_position: bool = True,
    normal_B: NDArray[np.float64] | None = None,
) -> Iterator[SmoothedMotion]:
    """Yield the motion of a log of any length, smoothed in windows; see `smooth`.

    The time for a window does not depend on the length of the log. A window has a margin of samples
    on both sides, because splines are less accurate near their ends. The gyro bias is estimated in
    each window. Windows with too few samples of a required sensor are left out.

    Args:
        measurements: samples of the sensors.
        suite: the sensors' errors.
        with_position: whether to compute the base's position and velocity, else they are zero.
        normal_B: see `smooth`.

    Raises:
        InputError: all windows have too few samples of a required sensor.

    """
    start, end = measurements.interval
    if not end - start > LONGEST_WHOLE:
        yield smooth(measurements, suite, with_position=with_position, normal_B=normal_B)
        return
    needed = ["encoders", "attitude", *(["position"] if with_position else [])]
    steps = [np.median(np.diff(measurements[n].time)) for n in needed if len(measurements[n]) > 1]
    seconds = max(WINDOW, FEWEST * float(max(steps, default=0.0)))
    refused: InputError | None = None
    is_empty = True
    for first in np.arange(start, end, seconds).tolist():
        last = first + seconds if first + seconds < end else np.inf
        around = measurements.between(first - MARGIN * seconds, last + MARGIN * seconds)
        try:
            motion = smooth(
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
        yield motion
    if is_empty and refused is not None:
        raise refused


def _in_plane(measurements: Measurements, normal_B: NDArray[np.float64]) -> Measurements:
    """Return samples without their components out of the plane, which are noise."""
    samples = dict(measurements.samples)
    for name, given in samples.items():
        quantity = SENSORS[name].quantity
        if quantity is ATTITUDE:
            samples[name] = replace(given, value=levelled(given.value, normal_B))
        elif quantity is ANGULAR_VELOCITY:
            samples[name] = replace(given, value=np.outer(given.value @ normal_B, normal_B))
        elif quantity is POSITION or quantity is VELOCITY:
            samples[name] = replace(given, value=given.value * [1.0, 1.0, 0.0])
    return Measurements(measurements.joint_names, samples)


def _smooth_position(
    measurements: Measurements, suite: SensorSuite, times: NDArray[np.float64], share: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[ErrorBlock]]:
    """Return position and velocity in W and their errors, from samples of both."""
    position, velocity = measurements.position, measurements.velocity
    inside = (velocity.time >= position.time[0]) & (velocity.time <= position.time[-1])
    velocity = velocity.where(inside)
    rows = [(position, 0, suite.sigmas("position")[0])]
    if len(velocity):
        rows.append((velocity, 1, suite.sigmas("velocity")[0]))

    def fit(intervals: int) -> SplineFit:
        return fit_samples(Basis.through(position.time, intervals, 5), rows)

    samples = len(position) + len(velocity)
    best = best_fit(fit, samples, share=share, finer=share < 1)
    bridged, bridges = bridge_gaps(best.basis, best.coefficients)
    if bridges:
        best = fit_samples(bridged, [*rows, *bridges])
    B, B_dot = best.basis(times), best.basis(times, 1)
    support, basis = _values_and_rates(best.basis, times)
    covariance = best.covariance * misfit_factor(best, 3 * samples, share)
    blocks = [ErrorBlock(np.array([6 + i, 9 + i]), support, basis, covariance) for i in range(3)]
    return B @ best.coefficients, B_dot @ best.coefficients, blocks


def _values_and_rates(
    basis: Basis, times: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the support (N, m) of a basis, and its values and their rates there (N, 2, m)."""
    k = basis.support(times)
    parts = [np.take_along_axis(basis(times, d), k, axis=1) for d in range(2)]
    return k, np.stack(parts, axis=1)
