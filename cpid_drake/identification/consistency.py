"""What a rigid body can have of an estimate: the nearest body, intervals, and bounds of the rest.

The estimate of an estimator may be physically inconsistent: a negative moment of inertia, or
moments that violate the triangle inequality. No negative part of the interval of a mass or of a
moment is shown; the rest contains the true value as often as the whole interval. Parameters that
the samples do not determine have the bounds of what they do determine, and of sizes like the
spacecraft's.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.estimation.rigid_bodies import nearest, sizes, without_rounding
from cpid_drake.identification.checks import IMPROBABLE, NEAREST, NOISE, Check
from cpid_drake.identification.result import Combinations, Identification, extremes


def checked(found: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with the checks of its body, and the failed checks first.

    Args:
        found: the identification, with or without its nearest rigid body.
        tree: the spacecraft model.

    """
    if found.check(NEAREST) is None:
        found = with_nearest_body(found, tree)
    # The larger noise explains the other failures.
    checks = sorted(found.checks, key=lambda check: (check.passed, check.name != NOISE))
    found = replace(found, checks=tuple(checks))
    known, near = _identified(found, tree), found.check(NEAREST)
    if not found.rank or known is None or near is None or near.statistic is None:
        return found
    possible = _possible(found) if near.passed else np.full((10, 2), np.nan)
    return replace(found, consistent_intervals=possible)


def with_nearest_body(found: Identification, tree: KinematicTree) -> Identification:
    """Return an identification with its nearest rigid body, and the check that it is near enough.

    This takes a few milliseconds; the bounds of `checked` take a tenth of a second.
    """
    solution, form = found.solution, found.form
    assert solution is not None
    assert form is not None
    if not solution.rank:  # no number is shown
        return found
    body = None if found.consistent is None else found.consistent.to_vector()
    combinations, distance = None, np.nan
    known = _identified(found, tree)
    if known is not None:
        distance, unknowns = 0.0, solution.values
        if found.inconsistencies or not found.is_identifiable:
            distance, unknowns = nearest(known.rows, form, tree.mass, known.scale)
        if found.inconsistencies and np.isfinite(distance):
            near = InertialParameters.from_vector(form.to_parameters(unknowns))
            body = near.nearest_consistent().to_vector()  # the solver rounds
    if np.isfinite(solution.information).all():
        combinations = Combinations(form.name, solution.values, solution.information, tree.mass)
    return replace(
        found,
        nearest=body,
        combinations=combinations,
        checks=(*found.checks, *_checks(found, distance, known)),
    )


@dataclass(frozen=True, eq=False)
class _Identified:
    """The identified combinations of the unknowns."""

    rows: Gaussian  # A x = b with unit errors, without what is rounding
    scale: NDArray[np.float64]  # (10,) plausible sizes of the unknowns
    radius: float  # with probability 1 − IMPROBABLE, the target's |A x − b| is no larger


def _checks(found: Identification, distance: float, known: _Identified | None) -> tuple[Check, ...]:
    """Return the check that a rigid body has the estimate, within its covariance."""
    rows, shown = 0 if found.solution is None else found.solution.row_count, found.parameters
    if not np.isfinite(np.diag(found.covariance)[np.isfinite(shown)]).all():
        if found.sensors is None and 0 < rows <= found.rank:
            return ()  # as many rows as unknowns: no residuals show the noise
        return (Check("uncertainty", "the uncertainty of the estimate could not be computed"),)
    problems = "; ".join(found.inconsistencies)
    sentence = "no rigid body agrees with the estimate within its uncertainty"
    sentence += f" ({problems})" if problems else ""
    sentence += ": the momentum, the spacecraft's model, units, signs or frames are not as assumed"
    if known is None:
        return (Check.of(NEAREST, sentence, passed=not problems),)
    if np.isnan(distance):
        return (Check(NEAREST, "the nearest rigid body could not be computed"),)
    return (Check.of(NEAREST, sentence, distance, known.radius),)


def _identified(found: Identification, tree: KinematicTree) -> _Identified | None:
    """Return the identified combinations; None if there are none."""
    solution, form = found.solution, found.form
    assert solution is not None
    assert form is not None
    known, freedom = solution.known, _freedom(found)
    finite = (solution.values, known.R, known.z)
    if freedom == 0 or not all(np.isfinite(each).all() for each in finite):
        return None
    mass, squares = found.parameters[0], [np.trace(tree.at_rest.I_BBcm) / 2 / tree.mass]
    if not 1e-3 < mass / tree.mass < 1e3:
        mass = tree.mass
    elif found.is_identifiable:
        about_C = found.raw().to_standard_vector()
        squares.append(np.sum(about_C[[4, 7, 9]]) / 2 / mass)
    scale = sizes(form, float(mass), float(np.sqrt(max(squares))))
    radius = float(np.sqrt(_improbable(solution.rank, freedom)))
    return _Identified(without_rounding(known, scale), scale, radius)


def _freedom(found: Identification) -> int | None:
    """Return the degrees of freedom of residuals that show the noise; None if it is known."""
    if found.sensors is not None or found.solution is None:
        return None
    return max(found.solution.row_count - found.solution.rank, 0)


def _improbable(count: int, freedom: int | None) -> float:
    """Return the χ² of `count` unknowns that the true ones exceed with `IMPROBABLE`."""
    if freedom is None:
        return float(chdtri(count, IMPROBABLE))
    return count * float(fdtri(count, freedom, 1 - IMPROBABLE))


def _possible(found: Identification) -> NDArray[np.float64]:
    """Return the intervals (10, 2), and bounds of the rest, without negative masses and moments."""
    solution, form = found.solution, found.form
    assert solution is not None
    assert form is not None
    wide = extremes(form, solution.values, solution.spread, quantile_95(_freedom(found)))
    if not wide[0, 0] > 0:  # nothing bounds c and I if the mass may be zero
        wide[1:] = np.nan
    is_open = np.isnan(found.intervals).any(axis=1, keepdims=True)
    intervals = np.where(is_open, wide, found.intervals)
    places = [0, 4, 5, 6]
    intervals[places] = np.maximum(intervals[places], 0.0)
    intervals[places, 0] = np.nan_to_num(intervals[places, 0])
    return intervals
