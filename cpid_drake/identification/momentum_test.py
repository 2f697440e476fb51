"""Tests whether the total momentum is zero, and estimates it where the samples demand it."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from cpid_drake.dynamics.rows import STANDARD_ROWS
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.problem import LARGEST_NOISE, Estimator, Problem
from cpid_drake.identification.requirements import require_sensors
from cpid_drake.identification.result import Identification
from cpid_drake.identification.row_estimator import estimate_by_rows

IMPLAUSIBLE = 0.01
"""Probability of samples of a zero momentum below which the momentum is estimated instead.

An unneeded estimate of the momentum makes the intervals a little wider, so the limit is generous.
"""

CONTRADICTED = 1e-5
"""Probability below which samples contradict a momentum that the caller has said to be zero."""

ESTIMATED = (
    "the samples contradict a total momentum of zero, so the momentum was estimated; say so with "
    "--momentum unknown"
)
"""The warning if the momentum was estimated because zero does not explain the samples."""

NOT_ZERO = (
    "the samples contradict a total momentum of zero, which may bias the estimate: identify with "
    "--momentum unknown"
)
"""The doubt if the momentum is not zero and has not been estimated."""

NOT_ESTIMATED = (
    "the samples contradict a total momentum of zero, and {} cannot estimate it: identify with "
    "--momentum unknown and another estimator, such as least_squares with --rows standard"
)
"""The doubt if the momentum is not zero and the estimator cannot estimate it."""

_WORSE = 1.2  # ratio of misfits of which the larger one explains the samples worse
_LEAST_GAIN = 0.05  # share of a variance that knowing the momentum must remove to count


@dataclass(frozen=True, eq=False)
class TestedMomentum:
    """What the test of the momentum returns.

    Attributes:
        found: the identification; its momentum agrees with the samples, or there is a doubt.
        doubts: the doubts about the momentum.
        free: the identification with an unknown momentum if the samples contradict the zero that
            the caller has given, unless less can be known without it.

    """

    __test__ = False  # no test of pytest

    found: Identification
    doubts: tuple[str, ...] = ()
    free: Identification | None = None


def with_tested_momentum(
    record: Estimator, problem: Problem, found: Identification, *, is_given: bool
) -> TestedMomentum:
    """Return an identification whose momentum the samples do not contradict, or doubts about it.

    Args:
        record: the estimator.
        problem: the problem, with a momentum of zero.
        found: the identification with this momentum.
        is_given: whether the caller has said that the momentum is zero. If not, the momentum is
            estimated where the samples demand it.

    """
    if found.contradicts_zero is None and problem.log.is_long:
        contradicts = _beginning_contradicts(record, problem, is_given=is_given)
        found = replace(found, contradicts_zero=contradicts)
    if found.contradicts_zero is False:
        return TestedMomentum(found)
    beginning = problem.with_measurements(problem.log.head)
    if found.misfit > LARGEST_NOISE and not _rows_agree(beginning):
        return TestedMomentum(found)  # a momentum does not explain this: the gate doubts the misfit
    free = _with_unknown(record, problem)
    if found.contradicts_zero is None:
        limit = CONTRADICTED if is_given or free is None else IMPLAUSIBLE
        pair = _by_standard_rows(beginning) if free is None else (found, free)
        if pair is not None:
            found = replace(found, contradicts_zero=_contradicts(*pair, limit))
    if not found.contradicts_zero:
        return TestedMomentum(found)
    if is_given:
        knows_less = free is None or free.solution.rank < found.solution.rank
        return TestedMomentum(found, (NOT_ZERO,), None if knows_less else free)
    if free is None:
        return TestedMomentum(found, (NOT_ESTIMATED.format(found.rows or found.estimator),))
    if free.solution.rank < found.solution.rank and not np.isfinite(free.parameters).any():
        return TestedMomentum(found, (NOT_ZERO,))
    return TestedMomentum(replace(free, warnings=(*free.warnings, ESTIMATED)))


def _beginning_contradicts(record: Estimator, problem: Problem, *, is_given: bool) -> bool:
    """Return whether the beginning of a long log contradicts a momentum of zero.

    The time of the test does not depend on the length of the log.
    """
    beginning = problem.with_measurements(problem.log.head)
    try:
        found = record.estimate(beginning)
    except (InputError, np.linalg.LinAlgError):
        return False
    if found.contradicts_zero is not None:
        return found.contradicts_zero
    free = _with_unknown(record, beginning)
    limit = CONTRADICTED if is_given else IMPLAUSIBLE
    return free is not None and _contradicts(found, free, limit)


def _with_unknown(record: Estimator, problem: Problem) -> Identification | None:
    """Return the identification with an unknown momentum; None if that is impossible."""
    unknown, family = TotalMomentum.unknown(), problem.family
    if family is not None and family.momentum_columns is None:
        return None
    try:
        require_sensors(problem.log.counts, problem.sensors, record, family, unknown)
        return record.estimate(replace(problem, momentum=unknown))
    except (InputError, np.linalg.LinAlgError):
        return None


def _by_standard_rows(problem: Problem) -> tuple[Identification, Identification] | None:
    """Return the estimates for zero and unknown momentum by rows that can estimate it."""
    try:
        zero, free = (
            estimate_by_rows(replace(problem, family=STANDARD_ROWS, momentum=momentum))
            for momentum in (problem.momentum, TotalMomentum.unknown())
        )
    except (InputError, np.linalg.LinAlgError):
        return None
    return zero, free


def _rows_agree(problem: Problem) -> bool:
    """Return whether least squares with an unknown momentum nearly explains the samples.

    It takes much less time than a fit of samples that no target explains.
    """
    unknown = TotalMomentum.unknown()
    try:
        found = estimate_by_rows(replace(problem, family=STANDARD_ROWS, momentum=unknown))
    except (InputError, np.linalg.LinAlgError):
        return True  # it cannot be said
    return found.misfit < LARGEST_NOISE


def _contradicts(zero: Identification, free: Identification, limit: float) -> bool:
    """Return whether an unknown momentum explains the samples, and zero does not."""
    if zero.converged and free.misfit > _WORSE * zero.misfit:
        return False  # the fit with the unknown momentum has found no answer
    changes = [0 if f.momentum_changes is None else f.momentum_changes.count for f in (zero, free)]
    if changes[0] > changes[1] or zero.misfit > _WORSE * free.misfit:
        return True
    if zero.unexplained > free.unexplained + 0.01:
        return True
    if changes[1]:
        return False  # the estimate is that of the momentum after the last change
    if free.momentum_estimate is not None:
        return free.momentum_estimate.probability_of_zero < limit
    return _probability_of_difference(zero, free) < limit


def _probability_of_difference(zero: Identification, free: Identification) -> float:
    """Return the probability of so large a difference of the parameters if the momentum is zero.

    The estimate with a momentum of zero is then the more precise one, and the difference has the
    difference of the covariances. Source: Hausman 1978, "Specification tests in econometrics".
    """
    both = np.isfinite(zero.parameters) & np.isfinite(free.parameters)
    if not both.any():
        return 1.0
    with_zero, covariance = (each.covariance[np.ix_(both, both)] for each in (zero, free))
    inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    gains, axes = np.linalg.eigh(np.eye(both.sum()) - inverse @ with_zero @ inverse.T)
    kept = gains > _LEAST_GAIN
    parts = axes[:, kept].T @ inverse @ (free.parameters - zero.parameters)[both]
    return float(chdtrc(kept.sum(), np.sum(parts**2 / gains[kept])))
