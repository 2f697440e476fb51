"""Converts sensor samples of different rates to motion at common times, with its covariance.

The method is regression splines, that is, least squares in a B-spline basis. Each knot interval
contains about the same number of samples; Akaike's criterion chooses the number of intervals. Rates
that no sensor measures are the derivatives of the splines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import right_jacobian, rotate, skew
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.splines import (
    INTERVALS,
    Basis,
    DerivativeSamples,
    SplineFit,
    best_fit,
    bridge_gaps,
    fit_samples,
    measured_by,
    misfit_factor,
    smooth_joints,
    solve_normal_equations,
)
from cpid_drake.sensing.suite import SensorSuite

_NEAR = 0.02
"""Largest angle from a reference attitude to the samples [rad], for Gauss-Newton to converge."""


@dataclass(frozen=True, eq=False)
class ErrorBlock:
    """Effect of the errors of one spline's coefficients on the motion at N times.

    Attributes:
        columns: indices of the affected quantities of the motion (see `SmoothedMotion`).
        basis: (N, columns, n) derivatives of these quantities with respect to the coefficients.
        covariance: (n, n) covariance of the coefficients.

    """

    columns: NDArray[np.intp]
    basis: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothedMotion:
    """Motion at N common times, and its errors.

    The quantities with errors are, in order: attitude (3, right perturbation, in B), angular
    velocity (3, in B), position (3) and velocity (3) in W, joint positions (J), joint rates (J).

    Attributes:
        telemetry: the motion.
        errors: independent parts of its error.
        gyro_bias: (3,) estimated gyro bias, in B [rad/s].

    """

    telemetry: Telemetry
    errors: tuple[ErrorBlock, ...]
    gyro_bias: NDArray[np.float64]

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariance (N, n, n) of the quantities at each time."""
        N, n = len(self.telemetry), 12 + 2 * len(self.telemetry.joint_names)
        result = np.zeros((N, n, n))
        for block in self.errors:
            part = block.basis @ block.covariance @ np.swapaxes(block.basis, -1, -2)
            result[:, block.columns[:, None], block.columns] += part
        return result


def smooth(
    measurements: Measurements,
    suite: SensorSuite,
    times: ArrayLike | None = None,
    *,
    with_position: bool = True,
) -> SmoothedMotion:
    """Return the motion at common times, smoothed from samples of different rates.

    Args:
        measurements: samples of the sensors; attitude, position and encoders are required. Samples
            of sensors that the suite lacks are left out. Of registered sensors, only those of
            joints are used.
        suite: the sensors' errors.
        times: (N,) [s]; default: ten per second in the interval in which all sensors have samples.
        with_position: whether to compute the base's position and velocity, else they are zero.

    Raises:
        InputError: too few samples of a required sensor, or times outside the samples.

    """
    measurements = measured_by(suite, measurements)
    joints = smooth_joints(measurements, suite)
    needed = {"attitude": measurements.attitude}
    if with_position:
        needed["position"] = measurements.position
    for name, samples in needed.items():
        if len(samples) < 4:
            raise InputError(f"smoothing needs at least 4 samples of {name}, not {len(samples)}")
    start = max(s.time[0] for s in (measurements.encoders, *needed.values()))
    end = min(s.time[-1] for s in (measurements.encoders, *needed.values()))
    if times is None:
        times = np.linspace(start, end, max(int(np.ceil((end - start) * 10)), 3) + 1)
    times = np.asarray(times, dtype=float)
    if not (times[0] >= start - 1e-9 and times[-1] <= end + 1e-9):
        raise InputError(f"all sensors have samples from {start:g} to {end:g} s only")

    attitude, rate, attitude_error, bias = _smooth_attitude(measurements, suite, times)
    position, velocity = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    position_error: list[ErrorBlock] = []
    if with_position:
        position, velocity, position_error = _smooth_position(measurements, suite, times)
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
    basis = np.stack([joints.basis(times), joints.basis(times, 1)], axis=1)
    joint_errors = [
        ErrorBlock(np.array([12 + j, 12 + J + j]), basis, joints.covariance) for j in range(J)
    ]
    return SmoothedMotion(telemetry, (attitude_error, *position_error, *joint_errors), bias)


@dataclass(frozen=True, eq=False)
class _Reference:
    """A coarse attitude path without singularities: a normalized spline of quaternions."""

    basis: Basis
    coefficients: NDArray[np.float64]

    @classmethod
    def near(cls, times: NDArray[np.float64], attitude: Rotation) -> "_Reference":
        """Return the smoothest path within `_NEAR` of all attitudes (N), if there is one."""
        quaternions = attitude.as_quat(scalar_first=True)
        flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
        quaternions = quaternions * np.cumprod(np.where(np.append(False, flips), -1, 1))[:, None]
        for intervals in INTERVALS:
            basis = Basis.through(times, intervals, 5)
            if basis.size > len(times):
                basis = Basis.through(times, 1, min(5, len(times) - 1))
            reference = cls(basis, solve_normal_equations(basis(times), quaternions, False)[0])
            distance = (reference(times)[0].inv() * attitude).magnitude().max()
            if distance < _NEAR or basis.size > len(times) / 2:
                break
        return reference

    def __call__(self, times: NDArray[np.float64]) -> tuple[Rotation, NDArray[np.float64]]:
        """Return attitude and angular velocity in B (N, 3)."""
        q, rate = (self.basis(times, d) @ self.coefficients for d in range(2))
        w, x, dw, dx = q[:, :1], q[:, 1:], rate[:, :1], rate[:, 1:]
        turning = 2 * (w * dx - dw * x - np.cross(x, dx)) / np.sum(q**2, axis=1, keepdims=True)
        return Rotation.from_quat(q, scalar_first=True), turning


@dataclass(frozen=True, eq=False)
class _AttitudeFit(SplineFit):
    """R(t) = reference(t) exp(r(t)) with the spline r, and the gyro bias (3,) in B [rad/s]."""

    reference: _Reference
    bias: NDArray[np.float64]

    def evaluate(
        self, times: NDArray[np.float64]
    ) -> tuple[Rotation, NDArray[np.float64], NDArray[np.float64]]:
        """Return attitude, angular velocity in B (N, 3), and the derivative of both (N, 6, 3 K)."""
        B, B_dot = self.basis(times), self.basis(times, 1)
        r, rdot = B @ self.coefficients, B_dot @ self.coefficients
        turn = right_jacobian(r)
        before, w_before = self.reference(times)
        added = Rotation.from_rotvec(r)
        w = added.inv().apply(w_before) + rotate(turn, rdot)
        # The rate of the right Jacobian is computed by finite differences over a millisecond.
        ahead, behind = (right_jacobian(r + e * rdot) for e in (5e-4, -5e-4))
        by_rate = skew(w) @ turn + (ahead - behind) / 1e-3
        columns = np.zeros((len(r), 6, B.shape[1], 3))
        row, k = np.nonzero((B != 0) | (B_dot != 0))
        b, b_dot = B[row, k, None, None], B_dot[row, k, None, None]
        columns[row, :3, k] = b * turn[row]
        columns[row, 3:, k] = b * by_rate[row] + b_dot * turn[row]
        return before * added, w, columns.reshape(len(r), 6, 3 * B.shape[1])


def _smooth_attitude(
    measurements: Measurements, suite: SensorSuite, times: NDArray[np.float64]
) -> tuple[Rotation, NDArray[np.float64], ErrorBlock, NDArray[np.float64]]:
    """Return attitude, angular velocity in B, their errors and the gyro bias.

    The method is Gauss-Newton on SO(3), in the rotation vector relative to a reference path. The
    base may therefore rotate by any angle.
    """
    attitude, gyro = measurements.attitude, measurements.gyro
    gyro = gyro.where((gyro.time >= attitude.time[0]) & (gyro.time <= attitude.time[-1]))
    measured = Rotation.from_quat(attitude.value, scalar_first=True)
    tracker = suite.attitude
    assert tracker is not None  # absent sensors have no samples
    whiten = tracker.R_BS.T / suite.sigmas("attitude")[:, None]
    sigma_rate, bias_rows = 1.0, np.eye(3)
    if suite.gyro is not None and len(gyro):
        sigma_rate = suite.sigmas("gyro")[0]
        bias_rows = np.eye(3) / max(suite.gyro.bias_sigma, 1e-8)
    knot_times = gyro.time if len(gyro) > len(attitude) else attitude.time
    reference = _Reference.near(attitude.time, measured)
    linear = Basis.through(knot_times, 1, 1)
    rough = _AttitudeFit(linear, np.zeros((2, 3)), np.empty(0), np.inf, reference, np.zeros(3))
    latest = rough

    def refined(
        start: _AttitudeFit,
        basis: Basis,
        bridges: Sequence[DerivativeSamples] = (),
        last: bool = False,
    ) -> _AttitudeFit:
        """Return a fit in another basis, one Gauss-Newton step from `start`.

        Only the last fit has a covariance.
        """
        K = basis.size
        dense = np.linspace(knot_times[0], knot_times[-1], 4 * K)
        r, _ = solve_normal_equations(basis(dense), start.basis(dense) @ start.coefficients, False)
        start = replace(start, basis=basis, coefficients=r)
        R, _, columns = start.evaluate(attitude.time)
        _, w, rate_columns = start.evaluate(gyro.time)
        residual = (R.inv() * measured).as_rotvec()
        n, m = 3 * len(attitude), 3 * len(gyro)
        A, b = np.zeros((n + m + 3, 3 * K + 3)), np.zeros(n + m + 3)
        A[:n, :-3] = (whiten @ columns[:, :3]).reshape(n, 3 * K)
        A[n:-3, :-3] = rate_columns[:, 3:].reshape(m, 3 * K) / sigma_rate
        A[n:-3, -3:] = np.tile(np.eye(3), (len(gyro), 1)) / sigma_rate
        A[-3:, -3:] = bias_rows
        b[:n] = (residual @ whiten.T).ravel()
        b[n:-3] = (gyro.value - w - start.bias).ravel() / sigma_rate
        b[-3:] = -bias_rows @ start.bias
        for samples, derivative, sigma in bridges:
            rows = np.kron(basis(samples.time, derivative) / sigma, np.eye(3))
            A = np.vstack([A, np.pad(rows, [(0, 0), (0, 3)])])
            b = np.append(b, -rows @ r.ravel())
        step, covariance = solve_normal_equations(A, b[:, None], last)
        return _AttitudeFit(
            basis,
            r + step[:-3].reshape(K, 3),
            covariance[:-3, :-3],
            float(np.sum((A @ step - b[:, None]) ** 2)),
            reference,
            start.bias + step[-3:, 0],
        )

    def fit(intervals: int) -> _AttitudeFit:
        # One step from the previous fit is enough; three are needed from the reference path.
        nonlocal latest
        for _ in range(3 if latest is rough else 1):
            latest = refined(latest, Basis.through(knot_times, intervals, 5))
        return latest

    samples, first = len(attitude) + len(gyro), reference.basis.size - reference.basis.degree
    chosen = best_fit(fit, samples, first=first)
    chosen = refined(chosen, *bridge_gaps(chosen.basis, chosen.coefficients), last=True)
    R, w, columns = chosen.evaluate(times)
    covariance = chosen.covariance * misfit_factor(chosen, 3 * samples)
    return R, w, ErrorBlock(np.arange(6), columns, covariance), chosen.bias


def _smooth_position(
    measurements: Measurements, suite: SensorSuite, times: NDArray[np.float64]
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

    best = best_fit(fit, len(position) + len(velocity))
    bridged, bridges = bridge_gaps(best.basis, best.coefficients)
    if bridges:
        best = fit_samples(bridged, [*rows, *bridges])
    B, B_dot = best.basis(times), best.basis(times, 1)
    basis = np.stack([B, B_dot], axis=1)
    covariance = best.covariance * misfit_factor(best, 3 * (len(position) + len(velocity)))
    blocks = [ErrorBlock(np.array([6 + i, 9 + i]), basis, covariance) for i in range(3)]
    return B @ best.coefficients, B_dot @ best.coefficients, blocks
