"""Smooths samples of attitude and gyro to attitude and angular velocity at any times.

The attitude is a reference path times the exponential of a spline; see `smoothing`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import right_jacobian, rotate, skew
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.smoothed_motion import ErrorBlock
from cpid_drake.logs.splines import (
    INTERVALS,
    Basis,
    DerivativeSamples,
    SplineFit,
    best_fit,
    bridge_gaps,
    misfit_factor,
    solve_normal_equations,
)
from cpid_drake.sensors.suite import SensorSuite

_NEAR = 0.02
"""Largest angle from a reference attitude to the samples [rad], for Gauss-Newton to converge."""


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
    ) -> tuple[Rotation, NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]]:
        """Return attitude and angular velocity in B (N, 3), and their derivatives.

        Returns:
            Attitude; angular velocity; indices (N, n) of the coefficients on which they depend; and
            the derivative (N, 6, n, 3) of both with respect to these coefficients.

        """
        k = self.basis.support(times)
        B, B_dot = self.basis(times), self.basis(times, 1)
        r, rdot = B @ self.coefficients, B_dot @ self.coefficients
        turn = right_jacobian(r)
        before, w_before = self.reference(times)
        added = Rotation.from_rotvec(r)
        w = added.inv().apply(w_before) + rotate(turn, rdot)
        # The rate of the right Jacobian is computed by finite differences over a millisecond.
        ahead, behind = (right_jacobian(r + e * rdot) for e in (5e-4, -5e-4))
        by_rate = skew(w) @ turn + (ahead - behind) / 1e-3
        b, b_dot = (np.take_along_axis(x, k, axis=1)[:, None, :, None] for x in (B, B_dot))
        turn, by_rate = turn[:, :, None], by_rate[:, :, None]
        return before * added, w, k, np.concatenate([b * turn, b * by_rate + b_dot * turn], axis=1)

    def sparse(self, k: NDArray[np.intp], derivative: NDArray[np.float64]) -> csr_array:
        """Return derivatives (N, rows, n, 3) from `evaluate` as rows (N rows, 3 K)."""
        N, rows, n, _ = derivative.shape
        columns = np.broadcast_to((3 * k[:, :, None] + np.arange(3))[:, None], derivative.shape)
        ends = np.arange(0, derivative.size + 1, 3 * n)
        shape = (N * rows, 3 * self.basis.size)
        return csr_array((derivative.ravel(), columns.ravel(), ends), shape=shape)


def smooth_attitude(
    measurements: Measurements, suite: SensorSuite, times: NDArray[np.float64], share: float
) -> tuple[Rotation, NDArray[np.float64], ErrorBlock, NDArray[np.float64]]:
    """Return attitude, angular velocity in B, their errors and the gyro bias.

    The method is Gauss-Newton on SO(3), in the rotation vector relative to a reference path. The
    base may therefore rotate by any angle.

    Args:
        measurements: samples of the attitude and, if there is one, of the gyro.
        suite: the sensors' errors.
        times: (N,) [s].
        share: share of the three axes about which the base turns.

    Returns:
        R_WB at the times; w_WB_B (N, 3) [rad/s]; the errors of both; and the gyro bias (3,) in B
        [rad/s].

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
        R, _, k, by_coefficient = start.evaluate(attitude.time)
        turned = np.einsum("ij,njkl->nikl", whiten, by_coefficient[:, :3])
        of_attitude = start.sparse(k, turned)
        _, w, k, by_coefficient = start.evaluate(gyro.time)
        of_gyro = start.sparse(k, by_coefficient[:, 3:] / sigma_rate)
        biases = np.tile(np.eye(3), (len(gyro), 1)) / sigma_rate
        blocks = [[of_attitude, None], [of_gyro, csr_array(biases)], [None, csr_array(bias_rows)]]
        residual = (R.inv() * measured).as_rotvec()
        right = [
            (residual @ whiten.T).ravel(),
            (gyro.value - w - start.bias).ravel() / sigma_rate,
            -bias_rows @ start.bias,
        ]
        for samples, derivative, sigma in bridges:
            rows = np.kron(basis(samples.time, derivative) / sigma, np.eye(3))
            blocks.append([csr_array(rows), None])
            right.append(-rows @ r.ravel())
        A, b = block_array(blocks, format="csr"), np.concatenate(right)
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
    # Of one axis the criterion is less certain, and a bias is worse than noise.
    chosen = best_fit(fit, samples, first=first, share=share, finer=share < 1)
    chosen = refined(chosen, *bridge_gaps(chosen.basis, chosen.coefficients), last=True)
    R, w, k, by_coefficient = chosen.evaluate(times)
    columns = (3 * k[:, :, None] + np.arange(3)).reshape(len(times), -1)
    basis = by_coefficient.reshape(len(times), 6, -1)
    covariance = chosen.covariance * misfit_factor(chosen, 3 * samples, share)
    return R, w, ErrorBlock(np.arange(6), columns, basis, covariance), chosen.bias
