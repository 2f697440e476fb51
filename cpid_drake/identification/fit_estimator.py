"""The trajectory fit as an estimator, and the Cramér-Rao bound on unbiased estimators."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.least_squares import solution_of_information
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.likelihood.priors import psi_scale
from cpid_drake.estimation.momentum_filter import PSI, vague_prior
from cpid_drake.estimation.trajectory_fit import TrajectoryFit, fit_trajectory, state_information
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.problem import Estimator, Problem
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.splines import smooth_joints
from cpid_drake.sensing.suite import SensorSuite

NOT_CONVERGED = "the trajectory fit did not converge: its result is not the best fit"
"""The warning if the fit stopped before it converged."""


def estimate_by_fit(problem: Problem) -> Identification:
    """Fit the target to all samples of the sensors by maximum likelihood.

    Raises:
        InputError: too few samples.

    """
    problem, sensors, noise_warnings = problem.with_sensors()
    fit = fit_measurements(
        problem.spacecraft.tree,
        problem.measurements,
        sensors,
        momentum=problem.momentum,
        known_bodies=problem.known_bodies,
        robust=problem.robust,
    )
    warnings = list(noise_warnings)
    if not fit.converged:
        warnings.append(NOT_CONVERGED)
    misfit = fit.chi_squared / max(fit.rows, 1)
    if misfit > 1 + 5 * np.sqrt(2 / max(fit.rows, 1)):
        warnings.append(
            f"the fit misses the samples by {np.sqrt(misfit):.2g} times the sensors' noise: the "
            "noise is larger than given, the momentum is not zero, or the spacecraft differs from "
            "its model; the intervals are too narrow by that factor at least"
        )
    return replace(identification_of_fit(fit), warnings=tuple(warnings))


def fit_measurements(
    tree: KinematicTree,
    measurements: Measurements,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    robust: bool = False,
) -> TrajectoryFit:
    """Fit the target to screened measurements and a vague prior; start at the prior's mean.

    The prior keeps undetermined unknowns within plausible limits. `identification_of_fit` removes
    the prior's information from the result.

    Args:
        tree: the known bodies.
        measurements: screened samples of the sensors.
        sensors: the sensors' errors.
        momentum: the total momentum; default: zero.
        known_bodies: uncertainty of the known bodies, whose effect the covariance includes.
        robust: whether to use the Huber loss instead of squares.

    Raises:
        InputError: too few samples.

    """
    still = np.zeros((1, len(measurements.joint_names)))
    known = relative_dynamics(tree, still, still)
    prior = vague_prior(known.mass, known.I_K[0])
    model = TrajectoryModel(
        tree,
        smooth_joints(measurements, sensors),
        measurements,
        sensors,
        momentum=momentum,
        psi_prior=(prior.psi, prior.psi_sigma),
    )
    return fit_trajectory(model, prior.psi, known_bodies=known_bodies, robust=robust)


def identification_of_fit(fit: TrajectoryFit) -> Identification:
    """Return a fit as an identification; its information excludes the prior."""
    dynamics, measurements = fit.model.dynamics, fit.model.measurements
    solution = solution_of_information(
        fit.state.psi,
        fit.data_information(),
        psi_scale(dynamics.mass, dynamics.I_K[0]),
        consider=fit.consider[PSI, PSI],
        residual_sum=fit.chi_squared,
        row_count=fit.rows,
    )
    own_noise = fit.own_noise()
    return Identification(
        relative_parameterization(dynamics.mass),
        solution,
        sum(len(getattr(measurements, name)) for name in fit.model.sensors),
        TRAJECTORY_FIT.name,
        sensors=fit.model.suite,
        converged=fit.converged,
        whiteness=max(map(whiteness, own_noise.values()), key=lambda white: abs(white.lag_one)),
        residuals={
            name: ResidualSeries(getattr(measurements, name).time, rest, "σ")
            for name, rest in own_noise.items()
        },
    )


def cramer_rao_bound(
    tree: KinematicTree,
    psi: NDArray[np.float64],
    measurements: Measurements,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
) -> NDArray[np.float64]:
    """Return the Cramér-Rao bound (10, 10) on the covariance of the parameters π.

    Attitude and position at the start, gyro bias, an unknown momentum and all errors of the joint
    motion are estimated as well. The bound holds for unbiased estimators.

    Args:
        tree: the known bodies.
        psi: (10,) relative unknowns of the target.
        measurements: samples of the sensors, or ideal samples of a planned motion; the first
            attitude and position are treated as true.
        sensors: the sensors' errors.
        momentum: the true total momentum, marked as unknown if it is to be estimated; default:
            zero.
        known_bodies: uncertainty of the known bodies: the bound then holds for an estimator that
            treats them as exact.

    """
    joints = smooth_joints(measurements, sensors)
    model = TrajectoryModel(tree, joints, measurements, sensors, momentum=momentum)
    trajectory = model.trajectory(model.start(psi))
    information, consider = state_information(model, trajectory, known_bodies)
    dynamics = model.dynamics
    scale = psi_scale(dynamics.mass, dynamics.I_K[0])
    solution = solution_of_information(psi, information, scale, consider=consider)
    jacobian = relative_parameterization(dynamics.mass).jacobian(psi)
    return jacobian @ solution.covariance @ jacobian.T


def needs_of_fit(family: RowFamily | None, momentum: TotalMomentum) -> tuple[tuple[str, ...], ...]:
    """Return the sensors that the fit needs: at least one sensor of each entry."""
    return (("encoders",), ("attitude",))


TRAJECTORY_FIT = Estimator(
    name="trajectory_fit",
    label="trajectory fit (maximum likelihood)",
    good_for="the best estimate from noisy sensors, after the motion",
    estimate=estimate_by_fit,
    needs=needs_of_fit,
    most_samples=6_000,  # the time grows with the cube of their number
    prefers_sensors=True,
    uses_added_sensors=True,
)
