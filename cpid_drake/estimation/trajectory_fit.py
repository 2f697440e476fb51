"""Trajectory fit: maximum likelihood from all samples of all sensors.

The Levenberg-Marquardt method fits the readings that `likelihood.model` predicts, in two stages.
The first stage uses the log-Cholesky form of the pseudo-inertia, so that every iterate is a rigid
body (Rucker & Wensing 2022); it finds a good starting point. The second stage uses the relative
unknowns themselves and eliminates the errors of the joint motion. Its result is the unconstrained
maximum. For a target at the limit of physical consistency, such as a flat plate, the maximum may
lie beyond that limit; this keeps the estimate unbiased and its intervals valid.
`Identification.feasible` projects the estimate onto physically consistent parameters.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import LogCholesky
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.likelihood.elimination import WeightedRows, marginal
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.likelihood.motion import Trajectory, TrajectoryState
from cpid_drake.estimation.likelihood.priors import psi_scale

HUBER = 2.5
"""Residual of a sample, in σ over its three axes, above which the robust loss grows linearly."""

_WELL_KNOWN = 0.01  # σ as a share of the plausible size of ψ
_LITTLE = 0.1  # a step that reduces the cost by a smaller share ends the first stage
_STEP_TOLERANCE = 1e-4  # size of a step in units of σ: far below the accuracy of the data


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """The state that fits the samples best.

    Attributes:
        model: the model that was fitted.
        trajectory: the trajectory at the solution.
        information: (n, n) information about the unknowns in `TrajectoryModel.columns`, with the
            joint errors eliminated.
        consider: (n, n) covariance that the known bodies' uncertainty adds; zeros without any.
        chi_squared: χ² of all rows at the solution, weighted as in the last iteration.
        rows: number of scalar rows.
        iterations: number of iterations of both stages.
        converged: whether the last step was far below σ.
        downweighted: number of samples to which the robust loss gives less than full weight.
        weights: (rows,) square roots of the weights of the robust loss; ones without it.

    """

    model: TrajectoryModel
    trajectory: Trajectory
    information: NDArray[np.float64]
    consider: NDArray[np.float64]
    chi_squared: float
    rows: int
    iterations: int
    converged: bool
    downweighted: int
    weights: NDArray[np.float64]

    @property
    def state(self) -> TrajectoryState:
        """The solution."""
        return self.trajectory.state

    def psi_information(self) -> NDArray[np.float64]:
        """Return the information (10, 10) about the relative unknowns, all else eliminated."""
        return marginal(self.information, 10)

    def data_information(self) -> NDArray[np.float64]:
        """Return the information (10, 10) of the data alone about the relative unknowns.

        Unknowns that the data do not determine are fitted to noise. The solution can then be, for
        example, a target that cancels the spacecraft's inertia, and there even these unknowns seem
        to be known. Therefore, if a combination of unknowns is hardly known, the information is
        evaluated at a rigid body near the solution.
        """
        information = self.psi_information() - self._prior
        dynamics = self.model.dynamics
        scale = psi_scale(dynamics.mass, dynamics.I_K[0])
        if np.linalg.eigvalsh(information * scale * scale[:, None])[0] > _WELL_KNOWN**-2:
            return information
        form = LogCholesky(scale)
        psi, _ = form.to_psi(form.from_psi(self.state.psi))
        rigid = self.model.trajectory(replace(self.state, psi=psi), self.trajectory)
        weighted = WeightedRows(self.model.joint_jacobian(rigid), self.weights)
        information, _, _ = _uncertainty(self.model, rigid, weighted, None)
        return marginal(information, 10) - self._prior

    @property
    def _prior(self) -> NDArray[np.float64]:
        prior = self.model.psi_prior
        return np.zeros((10, 10)) if prior is None else np.diag(prior[1] ** -2.0)

    def own_noise(self) -> dict[str, NDArray[np.float64]]:
        """Return the estimated noise of each sensor: residuals (N, 3) in units of σ, by sensor.

        These residuals exclude the most likely errors of the joint motion, which are correlated
        over many samples.
        """
        weighted = WeightedRows(self.model.joint_jacobian(self.trajectory), self.weights)
        rest = weighted.own_noise(self.model.residuals(self.trajectory))
        counts = [len(sensor.samples) for sensor in self.model.sensors.values()]
        parts = np.split(rest, 3 * np.cumsum(counts))
        return {name: part.reshape(-1, 3) for name, part in zip(self.model.sensors, parts[:-1])}


def fit_trajectory(
    model: TrajectoryModel,
    psi: NDArray[np.float64],
    *,
    known_bodies: BodyUncertainty | None = None,
    robust: bool = False,
    max_iterations: int = 60,
) -> TrajectoryFit:
    """Fit the target, the base's start, momentum and gyro bias to all samples.

    Args:
        model: predicts the readings.
        psi: (10,) relative unknowns of a rigid body, at which the fit starts.
        known_bodies: uncertainty of the known bodies, from which the result's `consider` is
            computed.
        robust: whether to use the Huber loss instead of squares.
        max_iterations: largest number of iterations of each stage.

    Raises:
        InputError: the readings cannot be predicted even at the starting point.

    """
    weights = np.ones(len(model.sample_rows()))
    trajectory, iterations = _neighbourhood(model, psi, WeightedRows(None, weights), max_iterations)
    joint_jacobian = model.joint_jacobian(trajectory)
    weighted = WeightedRows(joint_jacobian, weights)
    for k in range(8 if robust else 1):
        if robust:
            if k == 1:  # outliers have falsified the first stage and its derivatives
                joint_jacobian = model.joint_jacobian(trajectory)
            weights = _huber_weights(model, weighted.own_noise(model.residuals(trajectory)))
            weighted = WeightedRows(joint_jacobian, weights)
        trajectory, count, converged = _free_stage(model, trajectory, weighted, max_iterations)
        iterations += count
        if robust:
            residuals = weighted.own_noise(model.residuals(trajectory))
            if np.allclose(weights, _huber_weights(model, residuals), atol=1e-3):
                break
    information, consider, chi_squared = _uncertainty(model, trajectory, weighted, known_bodies)
    return TrajectoryFit(
        model,
        trajectory,
        information,
        consider,
        chi_squared,
        len(weights),
        iterations,
        converged,
        int((weights < 1).sum() // 3),
        weights,
    )


def state_information(
    model: TrajectoryModel, trajectory: Trajectory, known_bodies: BodyUncertainty | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the information about ψ (10, 10) and the covariance that the known bodies add to it.

    All other unknowns and the joint errors are eliminated. At the true state, the inverse of the
    information is the Cramér-Rao bound.
    """
    weighted = WeightedRows(model.joint_jacobian(trajectory), np.ones(len(model.sample_rows())))
    information, consider, _ = _uncertainty(model, trajectory, weighted, known_bodies)
    return marginal(information, 10), consider[:10, :10]


def _uncertainty(
    model: TrajectoryModel,
    trajectory: Trajectory,
    weighted: WeightedRows,
    known_bodies: BodyUncertainty | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return the information about all unknowns, the consider covariance, and χ²."""
    A = model.jacobian(trajectory)
    information, _, chi_squared = weighted.normal_equations(A, model.residuals(trajectory))
    consider = np.zeros_like(information)
    if known_bodies is not None:
        cross = weighted.cross(A, model.body_jacobian(trajectory, known_bodies))
        scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * scale * scale[:, None]
        gain = scale[:, None] * np.linalg.lstsq(scaled, scale[:, None] * cross, rcond=1e-14)[0]
        consider = gain @ gain.T
    return information, consider, chi_squared


def _neighbourhood(
    model: TrajectoryModel, psi: NDArray[np.float64], weighted: WeightedRows, max_iterations: int
) -> tuple[Trajectory, int]:
    """Return the best fit without joint errors, and the number of steps that it took.

    The first stage ends as soon as its steps reduce the cost only a little, as happens near a flat
    body. Then the free stage follows. If the free stage does not converge, the first stage
    continues.
    """
    state, iterations = model.start(psi), 0
    for little in (_LITTLE, 1e-3):
        state, count = _log_cholesky_stage(model, state, weighted, max_iterations, little)
        iterations += count
        rigid = model.trajectory(state)
        free, count, converged = _free_stage(model, rigid, weighted, max_iterations)
        iterations += count
        if converged:
            return free, iterations
    return rigid, iterations


def _log_cholesky_stage(
    model: TrajectoryModel,
    state: TrajectoryState,
    weighted: WeightedRows,
    max_iterations: int,
    little: float,
) -> tuple[TrajectoryState, int]:
    """Minimize over rigid bodies until a step reduces the cost by less than the share `little`."""
    form = LogCholesky(np.abs(state.psi))
    parameters = form.from_psi(state.psi)
    psi, by_parameters = form.to_psi(parameters)
    state = replace(state, psi=psi)
    trajectory = model.trajectory(state)
    residuals = model.residuals(trajectory)
    cost, damping = weighted.cost(residuals), 1e-3
    count = 0
    while count < max_iterations:
        A = model.jacobian(trajectory)
        A = np.hstack([A[:, :10] @ by_parameters, A[:, 10:]])
        N, g, _ = weighted.normal_equations(A, residuals)
        before = cost
        for _ in range(12):
            count += 1
            step = _damped(N, g, damping)
            change = step.copy()
            change[:10] = 0.0
            new_psi, new_by = form.to_psi(parameters + np.clip(step[:10], -1.0, 1.0))
            candidate = replace(model.retracted(state, change), psi=new_psi)
            try:
                new = model.trajectory(candidate, trajectory)
            except InputError:
                damping *= 10
                continue
            new_residuals = model.residuals(new)
            new_cost = weighted.cost(new_residuals)
            if np.isfinite(new_cost) and new_cost < cost:
                parameters = parameters + np.clip(step[:10], -1.0, 1.0)
                state, trajectory, residuals = candidate, new, new_residuals
                by_parameters, cost, damping = new_by, new_cost, damping / 10
                break
            damping *= 10
        else:
            break
        if before - cost < little * cost:
            break
    return state, count


def _free_stage(
    model: TrajectoryModel, trajectory: Trajectory, weighted: WeightedRows, max_iterations: int
) -> tuple[Trajectory, int, bool]:
    """Iterate in the relative unknowns to the maximum of the likelihood."""
    residuals = model.residuals(trajectory)
    cost, damping = weighted.cost(residuals), 0.0
    count = 0
    while count < max_iterations:
        N, g, _ = weighted.normal_equations(model.jacobian(trajectory), residuals)
        for _ in range(12):
            count += 1
            step = _damped(N, g, damping)
            size = np.sqrt(max(float(step @ N @ step), 0.0))
            try:
                new = model.trajectory(model.retracted(trajectory.state, step), trajectory)
                new_residuals = model.residuals(new)
                new_cost = weighted.cost(new_residuals)
            except InputError:
                new_cost = float("inf")
            if np.isfinite(new_cost) and new_cost <= cost * (1 + 1e-9):
                trajectory, residuals, cost = new, new_residuals, new_cost
                damping = damping / 10 if damping > 1e-9 else 0.0
                break
            damping = max(10 * damping, 1e-6)
        else:
            return trajectory, count, False
        if size < _STEP_TOLERANCE and damping == 0.0:
            return trajectory, count, True
    return trajectory, count, False


def _damped(N: NDArray[np.float64], g: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
    """Return the Levenberg-Marquardt step of a normal matrix, scaled by its diagonal."""
    scale = 1 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    scaled = N * scale * scale[:, None] + (damping + 1e-14) * np.eye(len(N))
    return scale * np.linalg.solve(scaled, scale * g)


def _huber_weights(model: TrajectoryModel, residuals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the square roots of the robust loss's weights, equal for the three rows of a sample.

    The residuals must not contain the joint motion's errors, which are not errors of the sample.
    """
    rows = model.sample_rows()
    weights = np.ones(len(rows))
    of_samples = rows >= 0
    size = np.sqrt(np.bincount(rows[of_samples], residuals[of_samples] ** 2) / 3)
    by_sample = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-12)))
    weights[of_samples] = by_sample[rows[of_samples]]
    return weights
