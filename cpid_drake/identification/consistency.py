"""What a rigid body can have of an estimate: the nearest body, intervals, and bounds of the rest.

The estimate of an estimator may be physically inconsistent: a negative moment of inertia, or
moments that violate the triangle inequality. No negative part of the interval of a mass or of a
moment is shown; the rest contains the true value as often as the whole interval. Parameters that
the samples do not determine have the bounds of what they do determine, and of sizes like the
spacecraft's.
"""

from dataclasses import replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import LeastSquaresSolution
from cpid_drake.estimation.least_squares import improbable, quantile_95
from cpid_drake.estimation.rigid_bodies import nearest, sizes, without_rounding
from cpid_drake.identification.checks import NEAREST, NOISE, Check
from cpid_drake.identification.result import Combinations, Identification, extremes


def checked(result: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with the checks of its body, and the failed checks first.

    Args:
        result: the identification, with or without its nearest rigid body.
        tree: the spacecraft model.

    """
    if result.check(NEAREST) is None:
        result = with_nearest_body(result, tree)
    # The larger noise explains the other failures.
    checks = sorted(result.checks, key=lambda check: (check.passed, check.name != NOISE))
    result, near = replace(result, checks=tuple(checks)), result.check(NEAREST)
    if not result.rank or near is None or near.statistic is None:
        return result
    possible = _possible(result) if near.passed else np.full((10, 2), np.nan)
    return replace(result, consistent_intervals=possible)


def with_nearest_body(result: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with its nearest rigid body, and the check that it is near enough.

    The bounds of `checked` take much longer.
    """
    solution, form = result.solution, result.form
    assert solution is not None
    assert form is not None
    if not solution.rank:  # no number is shown
        return result
    body = None if result.consistent is None else result.consistent.to_vector()
    combinations, distance = None, None
    if (
        np.isfinite([*solution.values, *solution.determined.rows.flat]).all()
        and _freedom(result) != 0
    ):
        distance, unknowns = 0.0, solution.values
        if result.inconsistencies or not result.is_identifiable:
            # A x = b with unit errors is what the samples identify, without what is rounding.
            scale = _sizes(result, form, tree)
            rows = without_rounding(solution.determined, scale)
            distance, unknowns = nearest(rows, form, tree.mass, scale)
        if result.inconsistencies and np.isfinite(distance):
            near = InertialParameters.from_vector(form.to_parameters(unknowns))
            body = near.nearest_consistent().to_vector()  # the solver rounds
    if np.isfinite(solution.information).all():
        combinations = Combinations(form.name, solution.values, solution.information, tree.mass)
    return replace(
        result,
        nearest=body,
        combinations=combinations,
        checks=(*result.checks, *_checks(result, solution, distance)),
    )


def _checks(
    result: Identification, solution: LeastSquaresSolution, distance: float | None
) -> tuple[Check, ...]:
    """Return the check that a rigid body has the estimate, within its covariance."""
    if not np.isfinite(np.diag(result.covariance)[np.isfinite(result.parameters)]).all():
        if result.sensors is None and 0 < solution.row_count <= result.rank:
            return ()  # as many rows as unknowns: no residuals show the noise
        return (Check("uncertainty", "the uncertainty of the estimate could not be computed"),)
    problems = "; ".join(result.inconsistencies)
    sentence = "no rigid body agrees with the estimate within its uncertainty"
    sentence += f" ({problems})" if problems else ""
    sentence += ": the momentum, the spacecraft's model, units, signs or frames are not as assumed"
    if distance is None:
        return (Check.of(NEAREST, sentence, passed=not problems),)
    if np.isnan(distance):
        return (Check(NEAREST, "the nearest rigid body could not be computed"),)
    # With probability 1 − IMPROBABLE, the target's |A x − b| is no larger.
    radius = float(np.sqrt(improbable(solution.rank, _freedom(result))))
    return (Check.of(NEAREST, sentence, distance, radius),)


def _sizes(result: Identification, form: Parameterization, tree: KinematicTree) -> Array:
    """Return the plausible sizes (10,) of the unknowns."""
    mass, squares = result.parameters[0], [np.trace(tree.at_rest.I_BBcm) / 2 / tree.mass]
    if not 1e-3 < mass / tree.mass < 1e3:
        mass = tree.mass
    elif result.is_identifiable:
        about_C = result.raw().to_standard_vector()
        squares.append(np.sum(about_C[[4, 7, 9]]) / 2 / mass)
    return sizes(form, float(mass), float(np.sqrt(max(squares))))


def _freedom(result: Identification) -> int | None:
    """Return the degrees of freedom of residuals that show the noise; None if it is known."""
    if result.sensors is not None or result.solution is None:
        return None
    return max(result.solution.row_count - result.solution.rank, 0)


def _possible(result: Identification) -> Array:
    """Return the intervals (10, 2), and bounds of the rest, without negative masses and moments."""
    solution, form = result.solution, result.form
    assert solution is not None
    assert form is not None
    wide = extremes(form, solution.values, solution.spread, quantile_95(_freedom(result)))
    if not wide[0, 0] > 0:  # nothing bounds c and I if the mass may be zero
        wide[1:] = np.nan
    is_open = np.isnan(result.intervals).any(axis=1, keepdims=True)
    intervals = np.where(is_open, wide, result.intervals)
    places = [0, 4, 5, 6]
    intervals[places] = np.maximum(intervals[places], 0.0)
    intervals[places, 0] = np.nan_to_num(intervals[places, 0])
    return intervals
