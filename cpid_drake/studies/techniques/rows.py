"""Techniques that are linear least squares on rows of a smoothed motion.

All get the best weights there are: the covariance of a sample's rows is that of their residuals
(feasible generalized least squares), and for momentum rows, whose errors change most from sample
to sample, that of the smoothed motion before. Their rows are in ψ = (μ, μc, I_*), the *relative
form* of `dynamics.newton_euler`, unless a technique is called naive.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.newton_euler import newton_euler_regressor
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    STANDARD,
    Parameterization,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.momentum_rows import changed
from cpid_drake.logs.splines import regression_spline
from cpid_drake.studies.techniques.force_sensors import ACCELERATION, effort_name, wrench_name
from cpid_drake.studies.techniques.trial import Trial

Array = NDArray[np.float64]

ITERATIONS = 4
"""Of the weights and of the columns that depend on the solution: a fifth changes no digit shown."""

THINNED = 10
"""Every so many instants give momentum rows: smoothed motion has no more information."""


def worst_error(parameters: Array, truth: Array) -> float:
    """Return the largest error of parameters (10,), relative to m, 0.5 m and the trace of I."""
    scale = parameter_scale(truth, SCALE_LENGTH)
    return float(np.abs((parameters - truth) / scale).max())


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


Design = Callable[[Trial], Callable[[Array], Rows]]
"""Rows of a trial; columns may depend on the unknowns (10,) of the iteration before."""


def estimate(design: Design, trial: Trial) -> Array:
    """Return the parameters (10,) with weights from residuals."""
    x, rows_at = np.zeros(10), design(trial)
    root = np.diag(1 / np.abs(rows_at(x).b).max(axis=0))
    for _ in range(ITERATIONS):
        rows = rows_at(x)
        solution, _ = _solve(rows, root)
        residual = rows.b - rows.A @ solution
        least = 1e-14 * np.abs(rows.b).max()  # weights are never those of rounding alone
        covariance = residual.T @ residual / len(residual) + least**2 * np.eye(len(root))
        root, x = np.linalg.inv(np.linalg.cholesky(covariance)), solution[:10]
    return np.asarray(rows.form.to_parameters(x))


def bound(design: Design, exact: Trial, parameters: Array) -> Array:
    """Return the σ (10,) of the true parameters for an exact motion: (Σ Yᵀ R⁻¹ Y)⁻¹.

    The other unknowns, such as zeros of sensors, are eliminated.
    """
    form = relative_parameterization(exact.spacecraft.mass)
    x = form.from_parameters(parameters)
    rows = design(exact)(x)
    assert rows.sigma is not None
    _, root = _solve(rows, np.diag(1 / rows.sigma))
    return np.asarray(np.linalg.norm(rows.form.jacobian(x) @ root, axis=1))


def _solve(rows: Rows, whiten: Array) -> tuple[Array, Array]:
    """Return x, and a root whose square is the covariance of the target's unknowns."""
    width = rows.A.shape[2]
    A = (whiten @ rows.A).reshape(-1, width)
    prior = np.eye(width)[10:]
    A, b = np.vstack([A, prior]), np.append((rows.b @ whiten.T).ravel(), np.zeros(width - 10))
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    root = (Vt.T / s) / scale[:, None]
    return root @ (U.T @ b), root[:10]


# -- momentum ------------------------------------------------------------------------------------


def momentum_rows(name: str) -> Design:
    """Return the rows of a row family, with weights from the covariance of the smoothed motion."""
    family, step = ROW_FAMILIES[name], 1e-6

    def design(trial: Trial) -> Callable[[Array], Rows]:
        tree, part = trial.spacecraft.tree, slice(None, None, THINNED)
        form, motion = family.parameterization(tree.mass), trial.rates.motion.select(part)
        A, b = family.rows(momentum_samples(tree, motion))
        if trial.covariance is None:
            return lambda x: Rows(form, A, b)
        C = trial.covariance[part]
        shifts = np.repeat(step * np.eye(C.shape[1]), len(motion), axis=0)
        moved_A, moved_b = family.rows(momentum_samples(tree, changed(motion, shifts)))
        by_A, by_b = moved_A.reshape(-1, *A.shape) - A, moved_b.reshape(-1, *b.shape) - b

        def at(x: Array) -> Rows:
            if not x.any():
                return Rows(form, A, b)
            by = np.moveaxis((by_A @ x - by_b) / step, 0, -1)
            covariance = by @ C @ np.swapaxes(by, 1, 2)
            size = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
            whiten = np.linalg.inv(
                np.linalg.cholesky(covariance + 1e-9 * size * np.eye(len(by[0])))
            )
            return Rows(form, whiten @ A, rotate(whiten, b))

        return at

    return design


# -- accelerations -------------------------------------------------------------------------------


def accelerations(trial: Trial) -> Callable[[Array], Rows]:
    """Relative form, torque about K: (Y_n + s̃ Y_f) ψ = −L̇_K."""
    r = trial.rates
    Y = newton_euler_regressor(r.s_ddot, r.alpha, r.w)
    form = relative_parameterization(trial.spacecraft.mass)
    rows = Rows(form, Y[:, :3] + skew(r.s) @ Y[:, 3:], -r.K_rate)
    return lambda x: rows


def naive_accelerations(trial: Trial) -> Callable[[Array], Rows]:
    """Y φ = −[L̇ + v × P; Ṗ]: the base's position is differentiated twice."""
    r = trial.rates
    rows = Rows(STANDARD, newton_euler_regressor(r.a, r.alpha, r.w), -r.momentum_rate)
    return lambda x: rows


def accelerometer(trial: Trial) -> Callable[[Array], Rows]:
    """Rows of the naive form with a measured acceleration of the base, whose bias is estimated.

    An error δ of the base's acceleration changes a by δ, Ṗ by m_k δ and L̇ by −m_k s × δ.
    """
    r, mass, bias = trial.rates, trial.spacecraft.mass, trial.force_sensors.accelerometer.bias
    R_CW = np.swapaxes(r.samples.motion.R_WC, 1, 2)
    smoothed = regression_spline(trial.forces[ACCELERATION])(r.motion.time)
    measured = rotate(r.motion.R_WB, smoothed)
    change = rotate(R_CW, measured - r.vdot[:, 3:6])
    A = newton_euler_regressor(r.a + change, r.alpha, r.w)
    b = -r.momentum_rate - mass * np.hstack([-cross(r.s, change), change])
    R_CB = R_CW @ r.motion.R_WB

    def at(x: Array) -> Rows:
        moment, total = skew(x[1:4] - mass * r.s) @ R_CB, (x[0] + mass) * R_CB
        columns = -bias * np.concatenate([moment, total], axis=1)
        return Rows(STANDARD, np.concatenate([A, columns], axis=2), b)

    return at


# -- joint torques -------------------------------------------------------------------------------


def joint_torques(share: float) -> Design:
    """Return the rows of joint torques with an error of this share of full scale.

    (J_WCᵀ Y − M_J,lin R_WC Y_f/m_k) ψ = τ − ID_J(a_Bo = 0) + M_J,lin a_K0, with ID the inverse
    dynamics of the known plant and a_K0 the acceleration of K for a_Bo = 0. The torques' zeros are
    estimated.
    """

    def design(trial: Trial) -> Callable[[Array], Rows]:
        A, known = _joint_rows(trial)
        sigma = share * trial.spacecraft.limits.efforts
        zeros = np.tile(np.diag(sigma), (len(A), 1, 1))
        b = trial.forces[effort_name(share)].value - known
        form = relative_parameterization(trial.spacecraft.mass)
        rows = Rows(form, np.concatenate([A, zeros], axis=2), b, sigma)
        return lambda x: rows

    return design


@lru_cache(maxsize=1)  # sensors of all errors have the same rows
def _joint_rows(trial: Trial) -> tuple[Array, Array]:
    """Return the columns (N, J, 10) of ψ, and the known torques (N, J)."""
    craft, r, plant = trial.spacecraft, trial.rates, trial.spacecraft.plant
    Y, context = newton_euler_regressor(r.s_ddot, r.alpha, r.w), plant.CreateDefaultContext()
    columns = {k: c - plant.num_positions() for k, c in craft.state_columns.items()}
    joints, linear = columns["qdot"], columns["v_WB"]
    order = np.concatenate([columns["w_WB"], linear, joints])
    no_force, world = MultibodyForces(plant), plant.world_frame()
    A, known = [], []
    for k, (state, R_WC) in enumerate(zip(craft.to_states(r.motion), r.samples.motion.R_WC)):
        plant.SetPositionsAndVelocities(context, state)
        vdot = np.zeros(len(order))
        vdot[order] = r.vdot[k]
        vdot[linear] = 0.0
        force = plant.CalcInverseDynamics(context, vdot, no_force)
        M = plant.CalcMassMatrix(context)[np.ix_(joints, linear)]
        jacobian = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, craft.capture_frame, np.zeros(3), world, world
        )[:, joints]
        in_C = np.vstack([R_WC.T @ jacobian[:3], R_WC.T @ jacobian[3:]])
        A.append(in_C.T @ Y[k] - M @ R_WC @ Y[k, 3:] / craft.mass)
        known.append(force[joints] - M @ force[linear] / craft.mass)
    return np.array(A), np.array(known)


# -- wrist sensor --------------------------------------------------------------------------------


def wrist(calibration: float, *, is_estimated: bool) -> Design:
    """Return the rows of a wrist sensor: y = (1 + K) Y ψ + z + noise.

    The zeros z, and if told the calibration's errors K, are unknowns with the sensor's σ as prior.
    The columns of K are those of the wrench Y ψ with the ψ before: with the measured one, ψ = 0 and
    K = −1 would be an exact solution.
    """

    def design(trial: Trial) -> Callable[[Array], Rows]:
        y, r = trial.forces[wrench_name(calibration)].value, trial.rates
        sensor = trial.force_sensors.wrist_for(y)
        Y = newton_euler_regressor(r.s_ddot, r.alpha, r.w)
        known = np.concatenate([Y, np.tile(np.diag(sensor.zeros), (len(Y), 1, 1))], axis=2)
        form = relative_parameterization(trial.spacecraft.mass)

        def at(x: Array) -> Rows:
            if not is_estimated:
                return Rows(form, known, y, sensor.noise)
            wrench, sizes = Y @ x if x.any() else y, calibration * sensor.ratios
            errors = np.einsum("ik,ij,nj->nkij", np.eye(6), sizes, wrench).reshape(len(Y), 6, 36)
            return Rows(form, np.concatenate([known, errors], axis=2), y, sensor.noise)

        return at

    return design
