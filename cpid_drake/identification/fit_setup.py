"""The recursive fit of a spacecraft with its sensors."""

from typing import TYPE_CHECKING

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.likelihood.priors import Prior, guessed_prior, vague_prior
from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.identification.problem import Problem
from cpid_drake.sensing.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.spacecraft.spacecraft import Spacecraft


def recursive_fit(
    spacecraft: "Spacecraft",
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    guess: InertialParameters | None = None,
    guess_sigma: float = 0.5,
    most_work: int | None = None,
) -> RecursiveFit:
    """Return the recursive fit for a spacecraft's sensors.

    Args:
        spacecraft: the known spacecraft.
        sensors: its sensors and their errors.
        momentum: the total momentum; default: zero.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.
        guess: prior estimate of the target; default: none, for a vague prior.
        guess_sigma: relative standard deviation of the guess; see
            `cpid_drake.estimation.likelihood.priors.guessed_prior`.
        most_work: see `RecursiveFit`.

    Raises:
        InputError: the guess is not a rigid body, or is a point mass at C's origin; the standard
            deviation is out of range.

    """
    prior = prior_of(spacecraft.tree, momentum)
    if guess is not None:
        check_guess(guess, guess_sigma)
        psi = relative_parameterization(spacecraft.mass).from_parameters(guess.to_vector())
        prior = guessed_prior(prior, psi, guess_sigma)
    return RecursiveFit(spacecraft.tree, sensors, prior, known_bodies, most_work)


def check_guess(guess: InertialParameters, sigma: float) -> None:
    """Refuse a guess of the target with which the recursive fit cannot start.

    Raises:
        InputError: for the same reasons as `recursive_fit`.

    """
    problems = guess.infeasibilities()
    if problems:
        raise InputError(f"not a rigid body: {'; '.join(problems)}")
    if not (guess.p_CTcm_C.any() or guess.I_TTcm_C.any()):
        raise InputError("a point at C's origin has no size; give an inertia")
    if not 1e-6 <= sigma <= 100:
        raise InputError(f"sigma must be a number from 1e-6 to 100, not {sigma}")


def prior_of(tree: KinematicTree, momentum: TotalMomentum | None) -> Prior:
    """Return the vague prior for the known bodies `tree`."""
    still = np.zeros((1, sum(body.joint >= 0 for body in tree.bodies)))
    known = relative_dynamics(tree, still, still)
    return vague_prior(known.mass, known.I_K[0], momentum)


def estimator_of(problem: Problem, sensors: SensorSuite) -> RecursiveFit:
    """Return the recursive fit for a problem with these sensors."""
    return recursive_fit(
        problem.spacecraft, sensors, momentum=problem.momentum, known_bodies=problem.known_bodies
    )
