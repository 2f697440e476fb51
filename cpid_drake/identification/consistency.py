"""What a rigid body can have of an estimate: the nearest body, intervals, and bounds of the rest.

The estimate of an estimator may be impossible: a negative moment of inertia, or moments that
violate the triangle inequality. Only the part of an interval that some rigid body can have is
shown. It contains the true value as often as the whole interval, because the true value is
possible. Bounds of parameters that the samples do not determine assume a size of the target.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.rigid_body_set import RigidBodySet
from cpid_drake.identification.checks import IMPROBABLE, NEAREST, NOISE, REACH, Check
from cpid_drake.identification.result import Combinations, Identification


def checked(found: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with the checks of its body, and the failed checks first.

    Args:
        found: the identification, with or without its nearest rigid body.
        tree: the known spacecraft.

    """
    if found.check(NEAREST) is None:
        found = with_nearest_body(found, tree)
    # The larger noise explains the other failures.
    checks = sorted(found.checks, key=lambda check: (check.passed, check.name != NOISE))
    found = replace(found, checks=tuple(checks))
    bodies, nearest = _bodies(found, tree), found.check(NEAREST)
    if not found.rank or bodies is None or nearest is None or nearest.statistic is None:
        return found
    possible = _possible(found, bodies) if nearest.passed else np.full((10, 2), np.nan)
    return replace(found, consistent_intervals=possible)


def with_nearest_body(found: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with its nearest rigid body, and the check that it is near enough.

    This takes a few milliseconds, as `checked` takes for each bound of a parameter.
    """
    solution, form = found.solution, found.form
    assert solution is not None
    assert form is not None
    if not solution.rank:  # no number is shown
        return found
    nearest = None if found.consistent is None else found.consistent.to_vector()
    combinations, distance = None, np.nan
    bodies = _bodies(found, tree)
    if bodies is not None:
        is_body = found.is_observable and not found.infeasibilities
        distance, unknowns = (0.0, solution.values) if is_body else bodies.nearest()
        if found.infeasibilities and np.isfinite(distance):
            near = InertialParameters.from_vector(form.to_parameters(unknowns))
            nearest = near.nearest_feasible().to_vector()  # the solver rounds
    if np.isfinite(solution.information).all():
        combinations = Combinations(form.name, solution.values, solution.information, tree.mass)
    return replace(
        found,
        nearest=nearest,
        size=None if bodies is None else bodies.size,
        combinations=combinations,
        checks=(*found.checks, *_checks(found, distance, bodies)),
    )


def _checks(
    found: Identification, distance: float, bodies: RigidBodySet | None
) -> tuple[Check, ...]:
    """Return the check that a rigid body has the estimate, within its covariance."""
    rows, shown = 0 if found.solution is None else found.solution.row_count, found.parameters
    if not np.isfinite(np.diag(found.covariance)[np.isfinite(shown)]).all():
        if found.sensors is None and 0 < rows <= found.rank:
            return ()  # as many rows as unknowns: no residuals show the noise
        return (Check("uncertainty", "the uncertainty of the estimate could not be computed"),)
    problems = "; ".join(found.infeasibilities)
    sentence = "no rigid body agrees with the estimate within its uncertainty"
    sentence += f" ({problems})" if problems else ""
    sentence += ": the momentum, the spacecraft's model, units, signs or frames are not as assumed"
    if bodies is None:
        return (Check.of(NEAREST, sentence, passed=not problems),)
    if np.isnan(distance):
        return (Check(NEAREST, "the nearest rigid body could not be computed"),)
    return (Check.of(NEAREST, sentence, distance, bodies.radius),)


def _bodies(found: Identification, tree: KinematicTree) -> RigidBodySet | None:
    """Return the rigid bodies that agree with an identification; None if nothing is known."""
    solution, form = found.solution, found.form
    assert solution is not None
    assert form is not None
    if not np.isfinite(solution.values).all():
        return None
    radius = float(chdtri(solution.rank, IMPROBABLE))
    freedom = solution.row_count - solution.rank
    if found.sensors is None:
        if freedom < 1:
            return None
        radius = solution.rank * float(fdtri(solution.rank, freedom, 1 - IMPROBABLE))
    known = solution.known
    if not (np.isfinite(known.R).all() and np.isfinite(known.z).all()):
        return None
    mass, size = _plausible(found, tree)
    return RigidBodySet(known, float(np.sqrt(radius)), form.name, tree.mass, mass, size)


def _possible(found: Identification, bodies: RigidBodySet) -> NDArray[np.float64]:
    """Return the physically consistent part (10, 2) of the intervals."""
    bounds = bodies.bounds()
    if bounds is None:  # the solver rounds, and only the estimate's surroundings are possible
        return found.intervals
    known = np.isfinite(found.parameters)[:, None] & ~np.isnan(found.intervals)
    free = np.where(known, found.intervals, [-np.inf, np.inf])
    mass, size = bodies.mass, bodies.size
    slack = 1e-6 * np.array([mass, *3 * [size], *6 * [mass * size**2]])  # the solver rounds
    low = np.where(bounds[:, 0] > free[:, 0] + slack, bounds[:, 0], free[:, 0])
    high = np.where(bounds[:, 1] < free[:, 1] - slack, bounds[:, 1], free[:, 1])
    # No body may have a value of the interval and be in the confidence region of all unknowns.
    empty = low > high
    low, high = np.where(empty, bounds[:, 0], low), np.where(empty, bounds[:, 1], high)
    intervals = np.stack([low, high], axis=1)
    return np.where(np.isfinite(intervals), intervals, np.nan)


def _plausible(found: Identification, tree: KinematicTree) -> tuple[float, float]:
    """Return a plausible mass [kg] and size [m] of the target.

    The target is as large as the spacecraft, or as its own moments about C say.
    """
    squares = [np.trace(tree.at_rest.I_BBcm) / 2 / tree.mass]
    mass = found.parameters[0]
    if not 1e-3 < mass / tree.mass < 1e3:
        mass = tree.mass
    elif found.is_observable:
        about_C = found.raw().to_standard_vector()
        squares.append(np.sum(about_C[[4, 7, 9]]) / 2 / mass)
    return float(mass), REACH * float(np.sqrt(max(squares)))
