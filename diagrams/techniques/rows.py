"""Techniques that are linear least squares on rows of a smoothed motion.

All get weights from residuals: the covariance of a sample's rows is that of their residuals
(feasible generalized least squares). Their rows are in ψ = (μ, μc, I_*), the *relative form* of
`dynamics.newton_euler`, unless a technique is called naive.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake import Motion
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    STANDARD,
    Parameterization,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.momentum_rows import changed_motion
from cpid_drake.logs.log import Samples
from cpid_drake.logs.splines import regression_spline
from techniques.force_sensors import RATE, Accelerometer, ForceSensors
from techniques.newton_euler import newton_euler_regressor
from techniques.trial import Trial

Array = NDArray[np.float64]

ITERATIONS = 4
"""Of the weights and of the columns that depend on the solution: a fifth changes no digit shown."""

THINNED = 10
"""Every so many instants give momentum rows: smoothed motion has no more information."""

UNKNOWN_MOMENTUM = 1e3
"""σ of an unknown momentum [N·m·s or N·s]: that of a target that tumbles by a turn a second."""


def worst_error(parameters: Array, truth: Array) -> float:
    """Return the largest error of parameters (10,), relative to m, 0.5 m and the trace of I."""
    return float(np.abs((parameters - truth) / parameter_scale(truth, SCALE_LENGTH)).max())


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows A x = b of N samples; x are ten unknowns of the target, then e others with σ = 1.

    Attributes:
        form: the target's unknowns.
        A: (N, k, 10 + e).
        b: (N, k).
        sigma: (k,) σ of each of the rows if the motion is exact; None if it has no such number.

    """

    form: Parameterization
    A: Array
    b: Array
    sigma: Array | None = None


Design = Callable[[Trial, Array], Rows]
"""Rows of a trial; columns may depend on the unknowns (10,) of the iteration before."""


def estimate(design: Design, trial: Trial) -> Array:
    """Return the parameters (10,) with weights from residuals."""
    x, root = np.zeros(10), None
    for _ in range(ITERATIONS):
        rows = design(trial, x)
        root = np.diag(1 / np.abs(rows.b).max(axis=0)) if root is None else root
        solution, _ = _solve(rows, root)
        residual = rows.b - rows.A @ solution
        least = 1e-10 * np.abs(rows.b).max()  # weights of rounding alone would hide the priors
        covariance = residual.T @ residual / len(residual) + least**2 * np.eye(len(root))
        root, x = np.linalg.inv(np.linalg.cholesky(covariance)), solution[:10]
    return np.asarray(rows.form.to_parameters(x))


def bound(design: Design, exact: Trial, parameters: Array) -> float:
    """Return the σ of the worst of the true parameters for an exact motion: (Σ Yᵀ R⁻¹ Y)⁻¹.

    The other unknowns, such as zeros of sensors, are eliminated.
    """
    x = relative_parameterization(exact.spacecraft.mass).from_parameters(parameters)
    rows = design(exact, x)
    assert rows.sigma is not None
    _, root = _solve(rows, np.diag(1 / rows.sigma))
    sigma = np.linalg.norm(rows.form.jacobian(x) @ root, axis=1)
    return float((sigma / parameter_scale(parameters, SCALE_LENGTH)).max())


def instants(design: Design, exact: Trial) -> int:
    """Return the least number of instants whose rows determine all ten; 0 if ten do not."""
    A = design(exact, np.zeros(10)).A[..., :10]
    for count in range(1, 11):
        some = A[np.linspace(0.2 * len(A), 0.8 * len(A), count).astype(int)].reshape(-1, 10)
        some = some / np.maximum(np.linalg.norm(some, axis=0), 1e-300)
        if np.linalg.matrix_rank(some, tol=1e-8) == 10:
            return count
    return 0


def _solve(rows: Rows, whiten: Array) -> tuple[Array, Array]:
    """Return x, and a root whose square is the covariance of the target's unknowns."""
    width = rows.A.shape[2]
    A = np.vstack([(whiten @ rows.A).reshape(-1, width), np.eye(width)[10:]])
    b = np.append((rows.b @ whiten.T).ravel(), np.zeros(width - 10))
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    root = (Vt.T / s) / scale[:, None]
    return root @ (U.T @ b), root[:10]


def momentum_design(name: str, *, is_unknown: bool = False) -> Design:
    """Return the rows of a row family, at a momentum of zero or up to `UNKNOWN_MOMENTUM`.

    Their errors change most from sample to sample: they are weighted by the covariance of the
    smoothed motion.
    """
    family, step = ROW_FAMILIES[name], 1e-6

    def design(trial: Trial, x: Array) -> Rows:
        tree, part = trial.spacecraft.tree, slice(None, None, THINNED)
        motion, form = trial.rates.motion.select(part), family.parameterization(tree.mass)

        def rows(motion: Motion) -> Array:
            found = family.full_rows(momentum_samples(tree, motion), is_unknown)
            return found.reshape(len(motion), family.rows_per_sample, -1)

        found, whiten = rows(motion), np.eye(family.rows_per_sample)
        if trial.covariance is not None and x.any():
            C = trial.covariance[part]
            changes = np.repeat(step * np.eye(C.shape[1]), len(motion), axis=0)
            moved = rows(changed_motion(motion, changes))[..., -11:] @ np.append(x, -1.0)
            here = found[..., -11:] @ np.append(x, -1.0)
            by = np.moveaxis((moved.reshape(-1, *here.shape) - here) / step, 0, -1)
            covariance = by @ C @ np.swapaxes(by, 1, 2)
            least = 1e-9 * np.trace(covariance, axis1=1, axis2=2)[:, None, None] * whiten
            whiten = np.linalg.inv(np.linalg.cholesky(covariance + least))
        found = whiten @ found
        A = np.concatenate([found[..., -11:-1], UNKNOWN_MOMENTUM * found[..., :-11]], axis=2)
        return Rows(form, A, found[..., -1])

    return design


def accelerations(trial: Trial, x: Array) -> Rows:
    """Relative form, torque about K: (Y_n + s̃ Y_f) ψ = −L̇_K."""
    r = trial.rates
    A = r.wrench[:, :3] + skew(r.s) @ r.wrench[:, 3:]
    return Rows(relative_parameterization(trial.spacecraft.mass), A, -r.K_rate)


def naive_accelerations(trial: Trial, x: Array) -> Rows:
    """Y φ = −[L̇ + v × P; Ṗ]: the base's position is differentiated twice."""
    r = trial.rates
    return Rows(STANDARD, newton_euler_regressor(r.a, r.alpha, r.w), -r.momentum_rate)


def accelerometer(sensor: Accelerometer) -> Design:
    """Return rows of the naive form with a measured acceleration, whose bias is estimated.

    An error δ of the base's acceleration changes a by δ, Ṗ by m_k δ and L̇ by −m_k s × δ.
    """

    def design(trial: Trial, x: Array) -> Rows:
        r, mass = trial.rates, trial.spacecraft.mass
        values = trial.acceleration.by(sensor.noise_density * np.sqrt(RATE), sensor.bias)
        smoothed = regression_spline(Samples(r.motion.time, values))(r.motion.time)
        change = rotate(r.R_CB, smoothed) - r.a_B
        A = newton_euler_regressor(r.a + change, r.alpha, r.w)
        b = -r.momentum_rate - mass * np.hstack([-np.cross(r.s, change), change])
        moment, total = skew(x[1:4] - mass * r.s) @ r.R_CB, (x[0] + mass) * r.R_CB
        columns = -sensor.bias * np.concatenate([moment, total], axis=1)
        return Rows(STANDARD, np.concatenate([A, columns], axis=2), b)

    return design


def joint_torques(share: float) -> Design:
    """Return the rows of joint torques with an error of this share of full scale.

    See `Rates.efforts`; the torques' zeros are estimated.
    """

    def design(trial: Trial, x: Array) -> Rows:
        A, known = trial.rates.efforts
        sigma = share * trial.spacecraft.limits.efforts
        zeros = np.tile(np.diag(sigma), (len(A), 1, 1))
        form, b = relative_parameterization(trial.spacecraft.mass), trial.efforts.by(sigma, sigma)
        return Rows(form, np.concatenate([A, zeros], axis=2), b - known, sigma)

    return design


def wrist(sensors: ForceSensors, size: float, *, is_estimated: bool) -> Design:
    """Return the rows of a wrist sensor: y = (1 + K) Y ψ + z + noise.

    The zeros z, and if estimated the calibration's errors K of this relative size, are unknowns
    with the sensor's σ as prior. The columns of K are those of the wrench Y ψ with the ψ before:
    with the measured one, ψ = 0 and K = −1 would be an exact solution.
    """

    def design(trial: Trial, x: Array) -> Rows:
        sensor, Y = sensors.wrist_for(trial.wrench.exact), trial.rates.wrench
        noise, zero = np.repeat([sensor.noise, sensor.zero], 3, axis=1)
        sizes = size * sensor.ratios
        y = trial.wrench.by(noise, zero, sizes)
        A = np.concatenate([Y, np.tile(np.diag(zero), (len(Y), 1, 1))], axis=2)
        if is_estimated:
            errors = np.einsum("ik,ij,nj->nkij", np.eye(6), sizes, Y @ x if x.any() else y)
            A = np.concatenate([A, errors.reshape(len(Y), 6, 36)], axis=2)
        return Rows(relative_parameterization(trial.spacecraft.mass), A, y, noise)

    return design
