"""From sensors' samples to the target's parameters, by any of the estimators."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import solution_of_information
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.likelihood.priors import psi_scale
from cpid_drake.estimation.momentum_filter import (
    PSI,
    MomentumFilter,
    guessed_prior,
    vague_prior,
)
from cpid_drake.estimation.online import OnlineEstimator, OnlineState
from cpid_drake.estimation.square_root import empty_root, solve_root, update_root
from cpid_drake.estimation.trajectory_fit import TrajectoryFit, fit_trajectory, state_information
from cpid_drake.identification.identification import Identification, row_family
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.smoothing import SmoothedMotion, smooth
from cpid_drake.sensing.splines import smooth_joints
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.plant_dynamics import PlantRelativeDynamics
from cpid_drake.spacecraft.spacecraft import Spacecraft

ESTIMATORS = ("eq18", "standard", "relative", "momentum_filter", "trajectory_fit")
"""Names of the estimators: weighted least squares on three row families, and two that are not."""

_MOST_WEIGHINGS = 20

Momentum = tuple[ArrayLike, ArrayLike]
"""(L, v_Wcm), (3,) each, in W: constant angular momentum about the system's centre of mass
[N·m·s], and that centre's velocity [m/s]."""


def identify_from_sensors(
    spacecraft: Spacecraft,
    measurements: Measurements,
    suite: SensorSuite,
    *,
    estimator: str = "trajectory_fit",
    unknown_momentum: bool = False,
    momentum: Momentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    robust: bool = False,
) -> Identification:
    """Identify the target held by a spacecraft from what its sensors gave.

    Args:
        spacecraft: the known spacecraft.
        measurements: samples of its sensors, each at its own times; bad ones are left out.
        suite: how good the sensors are.
        estimator: one of `ESTIMATORS`.
        unknown_momentum: whether the total momentum is constant and unknown, and not known.
        momentum: what it is, if it is known and not zero; not with the momentum filter.
        known_bodies: how well the spacecraft itself is known; what that adds to the covariance is
            in that of the trajectory fit and of the momentum filter, not of the rows.
        robust: Huber loss in the trajectory fit.

    Raises:
        InputError: no such estimator, measurements of other joints, too few samples, or a momentum
            for the momentum filter.

    """
    if estimator not in ESTIMATORS:
        raise InputError(f"no estimator '{estimator}'; choose from {', '.join(ESTIMATORS)}")
    if estimator == "momentum_filter" and momentum is not None:
        raise InputError("the momentum filter takes the momentum as zero or as unknown, not given")
    if measurements.joint_names != spacecraft.joint_names:
        raise InputError(
            f"measurements of joints {', '.join(measurements.joint_names)} are not of this "
            f"spacecraft, whose joints are {', '.join(spacecraft.joint_names)}"
        )
    measurements, _ = screen(measurements)
    if estimator == "trajectory_fit":
        fit = fit_measurements(
            spacecraft.tree,
            measurements,
            suite,
            unknown_momentum=unknown_momentum,
            momentum=momentum,
            known_bodies=known_bodies,
            robust=robust,
        )
        return identification_of_fit(fit)
    if estimator == "momentum_filter":
        online = online_estimator(spacecraft, suite, unknown_momentum=unknown_momentum)
        state = online.run(measurements)
        consider = None
        if known_bodies is not None:
            consider = consider_covariance(online, state, measurements, known_bodies)
        return identification_of_filter(online, state, consider)
    motion = smooth(measurements, suite, with_position=estimator != "relative")
    family = row_family(estimator, unknown_momentum)
    return identify_smoothed(spacecraft.tree, motion, family, unknown_momentum, momentum)


# -- trajectory fit -------------------------------------------------------------------------------


def fit_measurements(
    tree: KinematicTree,
    measurements: Measurements,
    suite: SensorSuite,
    *,
    unknown_momentum: bool = False,
    momentum: Momentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    robust: bool = False,
) -> TrajectoryFit:
    """Fit the target to screened measurements and a vague prior, started from its mean.

    The prior keeps what the data leave open within what is plausible at all; it has no part in what
    `identification_of_fit` says is known. Arguments as for `identify_from_sensors`; of an unknown
    momentum, `momentum` is where to start.

    Raises:
        InputError: too few samples.

    """
    still = np.zeros((1, len(measurements.joint_names)))
    known = relative_dynamics(tree, still, still)
    prior = vague_prior(known.mass, known.I_K[0])
    model = TrajectoryModel(
        tree,
        smooth_joints(measurements, suite),
        measurements,
        suite,
        unknown_momentum=unknown_momentum,
        momentum=momentum,
        psi_prior=(prior.psi, prior.psi_sigma),
    )
    return fit_trajectory(model, prior.psi, known_bodies=known_bodies, robust=robust)


def identification_of_fit(fit: TrajectoryFit) -> Identification:
    """Return what a trajectory fit has found."""
    dynamics = fit.model.dynamics
    solution = solution_of_information(
        fit.state.psi,
        fit.data_information(),
        psi_scale(dynamics.mass, dynamics.I_K[0]),
        consider=fit.consider[PSI, PSI],
        residual_sum=fit.chi_squared,
        row_count=fit.rows,
    )
    samples = sum(len(getattr(fit.model.measurements, name)) for name in fit.model.sensors)
    return Identification(relative_parameterization(dynamics.mass), solution, samples)


def cramer_rao_bound(
    tree: KinematicTree,
    psi: NDArray[np.float64],
    measurements: Measurements,
    suite: SensorSuite,
    *,
    momentum: Momentum | None = None,
    unknown_momentum: bool = False,
    known_bodies: BodyUncertainty | None = None,
) -> NDArray[np.float64]:
    """Return the Cramér-Rao bound (10, 10) on the covariance of the parameters π.

    Attitude and place at the start, gyro bias, momentum (if unknown) and all errors of the joint
    motion are nuisances. The bound is that of unbiased estimators.

    Args:
        tree: the known spacecraft.
        psi: (10,) relative unknowns of the target.
        measurements: what the sensors give (for a bound beforehand: what they would without noise);
            the first attitude and position are taken as true.
        suite: how good they are.
        momentum: the true one; default: zero.
        unknown_momentum: whether it is to be estimated.
        known_bodies: how well the spacecraft is known: the bound then holds for an estimator that
            takes it as known all the same.

    """
    joints = smooth_joints(measurements, suite)
    model = TrajectoryModel(
        tree, joints, measurements, suite, unknown_momentum=unknown_momentum, momentum=momentum
    )
    trajectory = model.trajectory(model.start(psi))
    information, consider = state_information(model, trajectory, known_bodies)
    parameterization = relative_parameterization(model.dynamics.mass)
    solution = solution_of_information(
        psi, information, psi_scale(model.dynamics.mass, model.dynamics.I_K[0]), consider=consider
    )
    jacobian = parameterization.jacobian(psi)
    return jacobian @ solution.covariance @ jacobian.T


# -- momentum filter ------------------------------------------------------------------------------


def online_estimator(
    spacecraft: Spacecraft,
    suite: SensorSuite,
    *,
    unknown_momentum: bool = False,
    guess: InertialParameters | None = None,
    guess_sigma: float = 0.5,
) -> OnlineEstimator:
    """Return the online estimator for a spacecraft's sensors.

    Args:
        spacecraft: the known spacecraft.
        suite: how good its sensors are.
        unknown_momentum: whether the total momentum is unknown instead of zero.
        guess: of the target beforehand; without it the estimator starts from a vague prior.
        guess_sigma: how good the guess is, relative; see `momentum_filter.guessed_prior`.

    Raises:
        InputError: the guess is no rigid body, or a point at C's origin, or its σ is out of range.

    """
    joints = len(spacecraft.joint_names)
    still = np.zeros((1, joints))
    inertia = relative_dynamics(spacecraft.tree, still, still).I_K[0]
    prior = vague_prior(spacecraft.mass, inertia, unknown_momentum)
    if guess is not None:
        check_guess(guess, guess_sigma)
        psi = relative_parameterization(spacecraft.mass).from_parameters(guess.to_vector())
        prior = guessed_prior(prior, psi, guess_sigma)
    momentum_filter = MomentumFilter(suite, joints, PlantRelativeDynamics(spacecraft), prior)
    return OnlineEstimator(spacecraft.tree, spacecraft.joint_names, momentum_filter)


def check_guess(guess: InertialParameters, sigma: float) -> None:
    """Refuse a guess of the target that a filter cannot start from.

    Raises:
        InputError: as `online_estimator`.

    """
    problems = guess.infeasibilities()
    if problems:
        raise InputError(f"not a rigid body: {'; '.join(problems)}")
    if not (guess.p_CTcm_C.any() or guess.I_TTcm_C.any()):
        raise InputError("a point at C's origin says nothing of size; give an inertia")
    if not 1e-6 <= sigma <= 100:
        raise InputError(f"sigma must be a number from 1e-6 to 100, not {sigma}")


def identification_of_filter(
    online: OnlineEstimator, state: OnlineState, consider: NDArray[np.float64] | None = None
) -> Identification:
    """Return what the online estimator has found so far; from samples and from a guess, if any.

    Args:
        online: the estimator.
        state: its state.
        consider: (10, 10) covariance to add for what was taken as known but is not.

    """
    prior, known_mass = online.filter.prior, online.tree.mass
    P = state.filter.P[PSI, PSI]
    guessed = prior.plausible is not None
    scale = prior.plausible if guessed else prior.psi_sigma
    scaled = np.linalg.inv(P / scale / scale[:, None])
    information = (scaled if guessed else scaled - np.eye(10)) / scale / scale[:, None]
    solution = solution_of_information(state.filter.psi, information, scale, consider=consider)
    return Identification(
        relative_parameterization(known_mass), solution, int(state.filter.used[:-1].sum())
    )


def consider_covariance(
    online: OnlineEstimator,
    state: OnlineState,
    measurements: Measurements,
    known_bodies: BodyUncertainty,
) -> NDArray[np.float64]:
    """Return what the known bodies' uncertainty adds to the covariance of ψ, (10, 10).

    It is that of the trajectory fit on the same samples: both estimators weigh them alike.
    """
    suite = online.filter.suite
    model = TrajectoryModel(
        online.tree,
        smooth_joints(measurements, suite),
        measurements,
        suite,
        unknown_momentum=not online.filter.prior.momentum_known,
    )
    now = replace(model.start(state.filter.psi), L=state.filter.L, v_Wcm=state.filter.v_Wcm)
    return state_information(model, model.trajectory(now), known_bodies)[1]


# -- least squares on rows ------------------------------------------------------------------------


def identify_smoothed(
    tree: KinematicTree,
    motion: SmoothedMotion,
    family: RowFamily,
    unknown_momentum: bool,
    momentum: Momentum | None = None,
) -> Identification:
    """Solve a row family on smoothed motion by least squares, each sample weighted by its errors.

    The weights come from linear propagation of the smoothed motion's covariance into the rows, at
    an unweighted estimate first, which can be far off: then at the weighted one, until it stands.
    The covariance takes into account that errors of neighbouring samples hang together, but not the
    bias that errors inside the rows cause.
    """
    if momentum is not None and not unknown_momentum:
        # Seen from a frame that moves with the centre of mass, linear momentum is zero.
        L, v_Wcm = (np.asarray(part, dtype=float) for part in momentum)
        moved = replace(motion.telemetry, v_WB=motion.telemetry.v_WB - v_Wcm)
        motion = replace(motion, telemetry=moved)
    else:
        L = np.zeros(3)
    known_mass = tree.mass
    nuisance = family.momentum_size if unknown_momentum else 0
    rows = _rows(tree, motion.telemetry, family, unknown_momentum, L)
    count = family.rows_per_sample
    rows = rows.reshape(-1, count, rows.shape[1])
    covariance = motion.covariance()
    solution = _solve(rows.reshape(-1, rows.shape[2]), nuisance)
    for _ in range(_MOST_WEIGHINGS):
        if not solution.is_observable:
            return Identification(
                family.parameterization(known_mass), solution, len(motion.telemetry)
            )
        full = _full_solution(rows, nuisance, solution.estimate)
        by_motion = _row_derivatives(tree, motion, family, unknown_momentum, L, full)
        S = by_motion @ covariance @ np.swapaxes(by_motion, -1, -2)
        S += 1e-9 * np.trace(S, axis1=1, axis2=2)[:, None, None] * np.eye(count) / count
        S += 1e-300 * np.eye(count)
        whiten = np.linalg.inv(np.linalg.cholesky(S))
        white = whiten @ rows
        before, solution = solution, _solve(white.reshape(-1, rows.shape[2]), nuisance)
        change = solution.estimate - before.estimate
        if np.all(np.abs(change) < 0.01 * np.sqrt(np.diag(solution.covariance))):
            break
    if solution.is_observable:
        # Errors of one spline coefficient are in many samples: add them up before squaring.
        A = white[:, :, :-1]
        normal = np.einsum("nri,nrj->ij", A, A)
        scale = 1 / np.sqrt(np.diag(normal))
        inverse = scale[:, None] * np.linalg.inv(normal * scale * scale[:, None]) * scale
        white_by_motion = whiten @ by_motion
        total = np.zeros_like(normal)
        for block in motion.errors:
            part = white_by_motion[:, :, block.columns] @ block.basis
            gain = inverse @ np.einsum("nri,nrk->ik", A, part)
            total += gain @ block.covariance @ gain.T
        solution = replace(solution, covariance=total[nuisance:, nuisance:])
    return Identification(family.parameterization(known_mass), solution, len(motion.telemetry))


def _rows(
    tree: KinematicTree,
    telemetry: Telemetry,
    family: RowFamily,
    unknown_momentum: bool,
    L: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the rows [N | A | b] of all samples, for a known angular momentum L (3,) in W.

    The angular rows, the last three of each sample, sum up to it. That holds about any point while
    linear momentum is zero.
    """
    samples = momentum_samples(tree, telemetry)
    rows = family.full_rows(samples, unknown_momentum)
    if L.any():
        by_sample = rows.reshape(len(samples), family.rows_per_sample, -1)
        by_sample[:, -3:, -1] += rotate(np.swapaxes(samples.motion.R_WC, -1, -2), L)
    return rows


def _solve(rows: NDArray[np.float64], nuisance: int):
    root = update_root(empty_root(rows.shape[1] - 1), rows)
    return solve_root(root, len(rows), eliminated=nuisance)


def _full_solution(
    rows: NDArray[np.float64], nuisance: int, estimate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the solution with the unknown momentum before it: (nuisance + 10,)."""
    flat = rows.reshape(-1, rows.shape[2])
    rest = flat[:, -1] - flat[:, nuisance:-1] @ estimate
    momentum = np.linalg.lstsq(flat[:, :nuisance], rest, rcond=None)[0] if nuisance else []
    return np.concatenate([momentum, estimate])


def _row_derivatives(
    tree: KinematicTree,
    motion: SmoothedMotion,
    family: RowFamily,
    unknown_momentum: bool,
    L: NDArray[np.float64],
    solution: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the derivative (N, rows, quantities) of A x − b by the smoothed quantities."""
    telemetry, step = motion.telemetry, 1e-6
    N, J = len(telemetry), len(telemetry.joint_names)
    count = 12 + 2 * J
    shift = step * np.eye(count)[:, None, :] * np.ones((1, N, 1))
    shift = np.concatenate([np.zeros((1, N, count)), shift]).reshape(-1, count)
    tiled = {
        name: np.tile(getattr(telemetry, name), (count + 1, 1))
        for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")
    }
    attitude = Rotation.from_quat(tiled["quaternion_WB"], scalar_first=True)
    w_B = attitude.inv().apply(tiled["w_WB"]) + shift[:, 3:6]
    attitude = attitude * Rotation.from_rotvec(shift[:, :3])
    moved = Telemetry(
        telemetry.joint_names,
        np.arange(len(shift), dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=tiled["p_WB"] + shift[:, 6:9],
        w_WB=attitude.apply(w_B),
        v_WB=tiled["v_WB"] + shift[:, 9:12],
        q=tiled["q"] + shift[:, 12 : 12 + J],
        qdot=tiled["qdot"] + shift[:, 12 + J :],
    )
    rows = _rows(tree, moved, family, unknown_momentum, L)
    residuals = (rows[:, :-1] @ solution - rows[:, -1]).reshape(count + 1, N, -1)
    return np.moveaxis((residuals[1:] - residuals[0]) / step, 0, -1)
