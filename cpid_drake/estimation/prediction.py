"""Prediction of the base's motion with a known target, and the errors of the prediction.

The start, momentum, biases and constant errors are fitted to the samples at the beginning of a log,
with the target as given. The rest of the log is then predicted from the joint motion alone. The
covariance of a prediction contains the sensors' noise, the uncertainty of all that was fitted, and
that of the target, about which the samples give no information here: a Schmidt-Kalman filter
(Schmidt 1966, Application of State-Space Methods to Navigation Problems).

The errors of a prediction that another target would not have are found by fitting the predicted
samples too, from the same beginning: the rows that this leaves about the target.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.block_equations import at_nominal
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.combination import SourceRows
from cpid_drake.estimation.faults import block_model
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.estimation.square_root import triangle
from cpid_drake.estimation.whiteness import LagSums, Whiteness


@dataclass(frozen=True, eq=False)
class SensorPrediction:
    """Predictions of one sensor's samples.

    Attributes:
        time: (M,) [s].
        error: (M, w) measured minus predicted values [SI units, rad].
        covariance: (M, w, w) of `error`.
        sigmas: (w,) the sensor's own noise.

    """

    time: NDArray[np.float64]
    error: NDArray[np.float64]
    covariance: NDArray[np.float64]
    sigmas: NDArray[np.float64]

    @property
    def rms(self) -> float:
        """Root mean square of the errors' magnitude [SI units, rad]."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))

    @property
    def largest(self) -> float:
        """Largest magnitude of an error."""
        return float(np.linalg.norm(self.error, axis=1).max())

    @property
    def expected_rms(self) -> float:
        """The expected root mean square of the errors' magnitude."""
        return float(np.sqrt(np.mean(np.trace(self.covariance, axis1=1, axis2=2))))

    @property
    def squares(self) -> NDArray[np.float64]:
        """(M,) squares of the errors in σ; each has a χ² distribution with w degrees of freedom."""
        scaled = self.covariance / self.sigmas / self.sigmas[:, None]
        error = self.error / self.sigmas
        solved = np.linalg.solve(scaled, error[..., None])[..., 0]
        return np.asarray(np.sum(error * solved, axis=1))

    @property
    def in_sigma(self) -> float:
        """Root mean square of the errors in σ: about 1 for the right target."""
        return float(np.sqrt(np.mean(self.squares) / self.error.shape[1]))


@dataclass(frozen=True, eq=False)
class Prediction:
    """The prediction of a log.

    Attributes:
        start: time from which on samples are predicted [s].
        end: time of the last predicted sample [s].
        is_complete: whether all of the log is predicted; it ends before a gap of the encoders.
        sensors: the predictions by sensor.
        chi_squared, freedom: of the samples of the beginning, to which the rest was fitted.
        noise: what the fit to the beginning leaves of each sensor's samples, in σ.
        target: rows about ψ of the predicted samples, of one sensor by its name and of `ALL`; None
            where no start explains the samples.

    """

    start: float
    end: float
    is_complete: bool
    sensors: dict[str, SensorPrediction]
    chi_squared: float
    freedom: int
    noise: dict[str, Whiteness]
    target: dict[str, SourceRows | None]


ALL = "all"
"""Name of all sensors of the base together."""


@dataclass
class _Parts:
    sigmas: NDArray[np.float64]
    time: list[NDArray[np.float64]] = field(default_factory=list)
    error: list[NDArray[np.float64]] = field(default_factory=list)
    covariance: list[NDArray[np.float64]] = field(default_factory=list)


def predicted(
    estimator: RecursiveFit,
    psi: NDArray[np.float64],
    target: SourceRows,
    blocks: Iterable[Block],
    until: float,
    constants: NDArray[np.float64] | None = None,
    *,
    tested: bool = True,
) -> Prediction:
    """Predict a log after its beginning.

    Args:
        estimator: the recursive fit, for its sensors and the prior of the momentum.
        psi: (10,) relative unknowns of the target.
        target: what is known about them.
        blocks: the blocks of the log, in order.
        until: end of the beginning, to which everything but the target is fitted [s].
        constants: (k,) values of the constant errors about which the model is linear; see
            `initial_state`.
        tested: whether to compute `Prediction.target`, which takes longer than all else.

    Raises:
        InputError: the log has too few samples, or cannot be predicted with this target.

    """
    solver, prior = estimator.solver, replace(estimator.prior, psi=psi)
    state: BlockState | None = None
    parts: dict[str, _Parts] = {}
    noise: dict[str, Whiteness] = {}
    start = end = np.nan
    chi_squared, freedom, is_complete = 0.0, 0, True
    lags: dict[str, LagSums] = {}
    fitted: dict[str, BlockState | None] = {}
    for block in blocks:
        if state is None:
            try:
                state = initial_state(solver, prior, psi, block, constants)
            except InputError:  # the log begins without attitude
                continue
        if np.isnan(start) and block.end <= until:
            # All samples are used: a wrong target is not to be explained by changes of momentum.
            fit = solver.solve(state, block_model(solver, state, block))
            state = fit.state
            chi_squared, freedom = chi_squared + fit.chi_squared, freedom + fit.freedom
            for name, rest in fit.residuals.items():
                lags[name] = lags.get(name, LagSums()).added(rest)
            continue
        if np.isnan(start):
            if not freedom:
                break
            start = end = state.time
            noise = {name: sums.whiteness for name, sums in lags.items()}
            unknown = _with_target(solver, prior, state, SourceRows(np.zeros((0, 10)), np.zeros(0)))
            fitted = dict.fromkeys((ALL, *noise) if tested else (), unknown)
            state = _with_target(solver, prior, state, target)
        try:
            model = block_model(solver, state, block)
        except InputError:
            is_complete = False
            break
        _add_errors(solver, state, model, parts)
        nothing = np.zeros(sum(len(sensor.samples) for sensor in model.sensors.values()))
        state = solver.solve(state, model, weights=nothing).state
        fitted = {
            name: _after(solver, known, block, {name: noise[name]} if name in noise else noise)
            for name, known in fitted.items()
        }
        end = block.end
    if not parts:
        raise InputError(
            "the log is too short to predict a part of it from its beginning, or its attitude is "
            "missing; give a log of at least a few seconds"
        )
    sensors = {
        name: SensorPrediction(
            np.concatenate(part.time),
            np.concatenate(part.error),
            np.concatenate(part.covariance),
            part.sigmas,
        )
        for name, part in parts.items()
    }
    rows = {name: None if last is None else _rows(last) for name, last in fitted.items()}
    return Prediction(start, end, is_complete, sensors, chi_squared, freedom, noise, rows)


def _after(
    solver: BlockSolver, state: BlockState | None, block: Block, noise: dict[str, Whiteness]
) -> BlockState | None:
    """Return the state after the samples of some sensors, as noisy as the beginning shows."""
    if state is None:
        return None
    try:
        model = block_model(solver, state, block)
        weights = [
            np.full(len(each.samples), 1 / noise[name].scale if name in noise else 0.0)
            for name, each in model.sensors.items()
        ]
        return solver.solve(state, model, weights=np.concatenate([[], *weights])).state
    except (InputError, np.linalg.LinAlgError):
        return None


def _rows(state: BlockState) -> SourceRows:
    R, z = state.psi_equations()
    return SourceRows(R, z + R @ state.nominal.psi)


def _with_target(
    solver: BlockSolver, prior: Prior, state: BlockState, target: SourceRows
) -> BlockState:
    """Return a state in which the target is known as given, and not from the beginning.

    The joints are known by their own sensors alone: the samples of the base, with a wrong target,
    contradict them.
    """
    n, psi, joints = len(state.root), solver.places["psi"], solver.places["joints"]
    others = np.setdiff1d(np.arange(n), np.r_[joints, psi])
    order = np.concatenate([np.r_[joints], others, np.r_[psi]])
    bodies = state.by_bodies.shape[1]
    R = triangle(np.hstack([state.root[:, order], state.by_bodies, state.rest[:, None]]))
    kept = slice(joints.stop - joints.start, n - 10)
    root, rest, by_bodies = np.zeros((n, n)), np.zeros(n), np.zeros((n, bodies))
    root[np.ix_(others, order[kept.start :])] = R[kept, kept.start : n]
    by_bodies[others], rest[others] = R[kept, n : n + bodies], R[kept, -1]
    if state.track is not None:
        count = state.track.mean.shape[1]
        root[joints, joints] = np.kron(np.eye(count), state.track.root)
    root[psi, psi] = triangle(np.vstack([target.A, np.diag(1 / prior.plausible)]))
    return replace(state, root=root, rest=rest, by_bodies=by_bodies, jumps=())


def _add_errors(
    solver: BlockSolver, state: BlockState, model: BlockModel, parts: dict[str, _Parts]
) -> None:
    """Add the errors of the predicted samples of a block, and their covariances."""
    state = solver.kicked(state, model)
    trajectory, shift = at_nominal(solver, state, model)
    residuals = model.residuals(trajectory)
    jacobian, _ = model.jacobian(trajectory)
    links, rest = model.links(trajectory.state)
    n, m, c = len(state.root), len(rest), state.by_bodies.shape[1]
    size = model.size + c
    A = np.zeros((n + m + c, size + 1))
    A[:n, model.at_start], A[:n, model.size : size] = state.root, state.by_bodies
    A[:n, -1] = state.rest - state.root @ shift
    A[n : n + m, : links.shape[1]], A[n : n + m, -1] = links, rest
    A[n + m :, model.size : size] = np.eye(c)
    R = triangle(A)
    jacobian = jacobian[:, :size]
    gain = solve_triangular(R[:size, :size], jacobian.T, trans="T").T
    errors = residuals - gain @ R[:size, -1]
    first = 0
    for name, sensor in model.sensors.items():
        count, width = len(sensor.samples), sensor.width
        rows = slice(first, first + count * width)
        first = rows.stop
        spread = gain[rows].reshape(count, width, -1)
        covariance = spread @ np.swapaxes(spread, 1, 2) + np.eye(width)
        sigma = sensor.scale
        part = parts.setdefault(name, _Parts(sigma))
        part.time.append(sensor.samples.time)
        part.error.append(errors[rows].reshape(count, width) * sigma)
        part.covariance.append(covariance * sigma * sigma[:, None])
