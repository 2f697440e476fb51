"""The online estimator (trajectory fits, then the momentum filter) in the form of an estimator."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import solution_of_information
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.momentum_filter import (
    FILTER_ORDER,
    PSI,
    MomentumFilter,
    guessed_prior,
    vague_prior,
)
from cpid_drake.estimation.online import OnlineEstimator, OnlineState
from cpid_drake.estimation.trajectory_fit import state_information
from cpid_drake.identification.fit_estimator import needs_of_fit
from cpid_drake.identification.problem import Estimator, Problem
from cpid_drake.identification.result import Identification, MomentumChanges
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.splines import smooth_joints
from cpid_drake.sensing.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.spacecraft.spacecraft import Spacecraft


def estimate_by_filter(problem: Problem) -> Identification:
    """Run the online estimator over all samples, in order of time.

    Raises:
        InputError: too few samples to estimate the noise from.

    """
    problem, sensors, noise_warnings = problem.with_sensors()
    online = online_estimator(problem.spacecraft, sensors, momentum=problem.momentum)
    state = online.run(problem.measurements)
    consider = None
    if problem.known_bodies is not None:
        consider = consider_covariance(online, state, problem.measurements, problem.known_bodies)
    found = identification_of_filter(online, state, consider)
    warnings = list(noise_warnings)
    if state.initializing:
        warnings.append(
            "the momentum filter did not start: the target was not known well enough before the "
            "end; the result is that of the last trajectory fit"
        )
    changes = found.momentum_changes
    if changes is not None and changes.count:
        warnings.append(
            f"the momentum changed {changes.count} times, last at {changes.last_time:.3f} s; it "
            "was estimated again from then on"
        )
    return replace(found, warnings=tuple(warnings))


def online_estimator(
    spacecraft: "Spacecraft",
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    guess: InertialParameters | None = None,
    guess_sigma: float = 0.5,
) -> OnlineEstimator:
    """Return the online estimator for a spacecraft's sensors.

    Args:
        spacecraft: the known spacecraft.
        sensors: its sensors and their errors.
        momentum: the total momentum, zero (default) or unknown.
        guess: prior estimate of the target; default: none, for a vague prior.
        guess_sigma: relative standard deviation of the guess; see
            `cpid_drake.estimation.momentum_filter.guessed_prior`.

    Raises:
        InputError: the momentum is known and not zero; the guess is not a rigid body, or is a point
            mass at C's origin; the standard deviation is out of range.

    """
    from cpid_drake.spacecraft.plant_dynamics import PlantRelativeDynamics

    momentum = momentum or TotalMomentum.zero()
    if momentum.name == "known":
        raise InputError("the momentum filter needs a total momentum that is zero or unknown")
    still = np.zeros((1, len(spacecraft.joint_names)))
    inertia = relative_dynamics(spacecraft.tree, still, still).I_K[0]
    prior = vague_prior(spacecraft.mass, inertia, momentum.is_unknown)
    if guess is not None:
        check_guess(guess, guess_sigma)
        psi = relative_parameterization(spacecraft.mass).from_parameters(guess.to_vector())
        prior = guessed_prior(prior, psi, guess_sigma)
    dynamics = PlantRelativeDynamics(spacecraft)
    momentum_filter = MomentumFilter(sensors, len(spacecraft.joint_names), dynamics, prior)
    return OnlineEstimator(spacecraft.tree, spacecraft.joint_names, momentum_filter)


def check_guess(guess: InertialParameters, sigma: float) -> None:
    """Refuse a guess of the target with which the online estimator cannot start.

    Raises:
        InputError: for the same reasons as `online_estimator`.

    """
    problems = guess.infeasibilities()
    if problems:
        raise InputError(f"not a rigid body: {'; '.join(problems)}")
    if not (guess.p_CTcm_C.any() or guess.I_TTcm_C.any()):
        raise InputError("a point at C's origin has no size; give an inertia")
    if not 1e-6 <= sigma <= 100:
        raise InputError(f"sigma must be a number from 1e-6 to 100, not {sigma}")


def identification_of_filter(
    online: OnlineEstimator, state: OnlineState, consider: NDArray[np.float64] | None = None
) -> Identification:
    """Return the current estimate from the samples and from the guess, if there is one.

    Args:
        online: the estimator.
        state: its state.
        consider: (10, 10) covariance to add for the uncertainty of the known bodies.

    """
    prior, known_mass = online.filter.prior, online.tree.mass
    P = state.filter.P[PSI, PSI]
    guessed = prior.plausible is not None
    scale = prior.psi_sigma if prior.plausible is None else prior.plausible
    scaled = np.linalg.inv(P / scale / scale[:, None])
    information = (scaled if guessed else scaled - np.eye(10)) / scale / scale[:, None]
    changes = state.filter.momentum_changes, state.filter.momentum_change_time
    rejected = {
        name: int(state.filter.rejected[online.filter.index(name)]) for name in FILTER_ORDER
    }
    return Identification(
        relative_parameterization(known_mass),
        solution_of_information(state.filter.psi, information, scale, consider=consider),
        int(state.filter.used[:-1].sum()),
        MOMENTUM_FILTER.name,
        sensors=online.filter.suite,
        rejected={name: count for name, count in rejected.items() if count},
        momentum_changes=MomentumChanges(int(changes[0]), float(changes[1])),
    )


def consider_covariance(
    online: OnlineEstimator,
    state: OnlineState,
    measurements: Measurements,
    known_bodies: BodyUncertainty,
) -> NDArray[np.float64]:
    """Return the covariance (10, 10) of ψ that the uncertainty of the known bodies causes.

    It is computed from a trajectory fit to the same samples, which weights them as the filter does.
    """
    sensors, now = online.filter.suite, state.filter
    model = TrajectoryModel(
        online.tree,
        smooth_joints(measurements, sensors),
        measurements,
        sensors,
        momentum=TotalMomentum(is_unknown=not online.filter.prior.momentum_known),
    )
    start = replace(model.start(now.psi), L=now.L, v_Wcm=now.v_Wcm)
    return state_information(model, model.trajectory(start), known_bodies)[1]


MOMENTUM_FILTER = Estimator(
    name="momentum_filter",
    label="momentum filter",
    good_for="an estimate online from noisy sensors; finds firings of thrusters",
    estimate=estimate_by_filter,
    needs=needs_of_fit,
    momenta=("zero", "unknown"),
    reports=8,
)
