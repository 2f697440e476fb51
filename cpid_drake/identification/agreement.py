"""Whether several logs, and a prior, have the same target: one test of one fit.

All logs share the hardware's errors. The sum of squares with one target, minus that with a target
for each log, has a χ² distribution if all have the same target. The noise of a log is that of a fit
to this log alone: otherwise a difference would look like noise. Source: Rao 1973, Linear
Statistical Inference and Its Applications, ch. 4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, chdtri

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import LeastSquaresSolution, quantile_95
from cpid_drake.identification.result import AGREEMENT, Check, Identification
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.identification.target_prior import TargetPrior

CONTRADICTED = 1e-4
"""Probability of the differences between logs, or to the prior, below which a check fails."""

DOMINATED = 0.5
"""Share of the variance of a parameter that the prior removes from which it dominates."""


def with_agreement(
    result: SolvedIdentification,
    vague: Gaussian,
    own: Mapping[str, Gaussian],
    target: str,
    solution: Callable[[Gaussian], LeastSquaresSolution],
    counts: Mapping[str, tuple[int, tuple[str, ...]]],
    prior: tuple[TargetPrior, Gaussian] | None = None,
) -> SolvedIdentification:
    """Return an identification with the separate estimates, and whether they agree.

    Args:
        result: the identification from all logs and the prior.
        vague: all unknowns before the samples.
        own: what each log tells about them, by its name.
        target: name of the target among the unknowns.
        solution: returns the target of a distribution of all unknowns.
        counts: number of samples of each log, and the failed checks of its own estimate.
        prior: what is known of the target besides, and the same as a distribution.

    """
    names = list(own)
    one = _with(vague, own, target, [names])
    solutions = {n: solution(_with(vague, own, target, [[n]])) for n in names}
    joint = solution(one)
    tests, others_say, checks = dict.fromkeys(names, (0.0, 0)), {}, []
    if len(names) > 1:
        apart = _with(vague, own, target, [[n] for n in names])
        for name in names:
            others = [n for n in names if n != name]
            two = _with(vague, own, target, [[name], others])
            others_say[name] = solution(_with(vague, own, target, [others]))
            rank = others_say[name].rank + solutions[name].rank - joint.rank
            tests[name] = one.least_cost - two.least_cost, rank
        worst = max(names, key=lambda name: tests[name][0] / max(tests[name][1], 1))
        who = f"{worst} disagrees most with the others"
        if len(names) == 2:
            who = f"{names[0]} and {names[1]} contradict each other"
        freedom = sum(each.rank for each in solutions.values()) - joint.rank
        sentence = f"the logs do not have the same target (probability {{:.1g}}): {who}"
        sentence += _difference(result, solutions[worst], others_say[worst])
        checks.append(_agreement(sentence, one.least_cost - apart.least_cost, freedom))
    logs = {
        name: replace(
            _alone(result, solutions[name]),
            sample_count=counts[name][0],
            checks=(
                _agreement("it differs from the others (probability {:.1g})", *tests[name]),
                *(Check("one log", sentence) for sentence in counts[name][1]),
            ),
        )
        for name in names
    }
    warnings = [
        f"{name} determines nothing about the target, and was not used"
        for name in names
        if len(names) > 1 and not solutions[name].rank
    ]
    warnings += result.warnings
    priors: dict[str, Identification] = {}
    dominated: tuple[str, ...] = ()
    if prior is not None:
        told, rows = prior
        both = one.add(rows)
        rank = int(np.linalg.matrix_rank(rows.R / np.linalg.norm(rows.R, axis=0).clip(1e-300)))
        with_prior = solution(both)
        dominated = _dominated(result, joint, with_prior)
        what = "the log" if len(names) == 1 else "the logs"
        sentence = f"{told.name} and {what} contradict each other (probability {{:.1g}})"
        sentence += _difference(result, solution(vague.add(rows)), joint)
        freedom = rank + joint.rank - with_prior.rank
        agrees = _agreement(sentence, both.least_cost - one.least_cost, freedom)
        failed = [Check("prior", sentence) for sentence in told.failures]
        priors[told.name] = Identification(
            parameters=told.parameters,
            covariance=told.covariance,
            intervals=told.intervals,
            rank=rank,
            singular_values=np.full(10, np.nan),
            sample_count=0,
            estimator="prior",
            checks=(agrees, *failed),
        )
        warnings.append(_of_prior(told, dominated))
        checks += [replace(each, sentence=f"{told.name}: {each.sentence}") for each in failed]
        checks.append(replace(agrees, name="agreement with the prior"))
    return replace(
        result,
        logs=logs,
        priors=priors,
        dominated=dominated,
        warnings=tuple(warnings),
        checks=(*checks, *result.checks),
    )


def _agreement(sentence: str, chi_squared: float, freedom: int) -> Check:
    """Return the check of a difference; its probability is put into the sentence."""
    if freedom <= 0:
        return Check(AGREEMENT, "", passed=True)
    chi_squared = max(chi_squared, 0.0)
    sentence = sentence.format(float(chdtrc(freedom, chi_squared)))
    return Check.of(AGREEMENT, sentence, chi_squared, float(chdtri(freedom, CONTRADICTED)))


def _alone(result: SolvedIdentification, solution: LeastSquaresSolution) -> SolvedIdentification:
    """Return an identification with another solution, without what belongs to all logs."""
    return SolvedIdentification(
        result.parameterization,
        solution,
        sample_count=result.sample_count,
        estimator=result.estimator,
        rows=result.rows,
        momentum=result.momentum,
        sensors=result.sensors,
    )


def _with(
    vague: Gaussian, own: Mapping[str, Gaussian], target: str, groups: Sequence[Sequence[str]]
) -> Gaussian:
    """Return what some logs say together if each group of them has a target of its own."""
    others = [name for name in vague.places if name != target]
    total = vague.marginal(others) if others else None
    for k, group in enumerate(groups):
        for each in (vague.marginal([target]), *(own[name] for name in group)):
            renamed = _renamed(each, target, k)
            total = renamed if total is None else total.add(renamed)
    assert total is not None
    return total


def _renamed(gaussian: Gaussian, target: str, k: int) -> Gaussian:
    """Return a distribution with another name of the target; that of the first group stays."""
    places = {f"{n} {k}" if n == target and k else n: p for n, p in gaussian.places.items()}
    return replace(gaussian, places=places)


def _dominated(
    result: SolvedIdentification, logs: LeastSquaresSolution, both: LeastSquaresSolution
) -> tuple[str, ...]:
    """Return the parameters that the prior determines more than the logs do."""
    without, variance = (np.diag(_alone(result, each).covariance) for each in (logs, both))
    is_less = ~np.isfinite(without) | (variance < DOMINATED * without)
    return tuple(
        name
        for name, less, value in zip(PARAMETER_NAMES, is_less, variance, strict=True)
        if less and np.isfinite(value)
    )


def _difference(
    result: SolvedIdentification, one: LeastSquaresSolution, other: LeastSquaresSolution
) -> str:
    """Return the parameter in which two estimates differ most, in words."""
    pair = [_alone(result, each) for each in (one, other)]
    values = np.array([each.parameters for each in pair])
    sigmas = np.sqrt([np.diag(each.covariance) for each in pair])
    ratio = np.abs(values[0] - values[1]) / np.hypot(*sigmas)
    if not np.isfinite(ratio).any():
        return ""
    i, wide = int(np.nanargmax(ratio)), quantile_95() * sigmas
    return (
        f", most in {PARAMETER_NAMES[i]}: {values[0, i]:.4g} ± {wide[0, i]:.2g} "
        f"against {values[1, i]:.4g} ± {wide[1, i]:.2g}"
    )


def _of_prior(prior: TargetPrior, dominated: Sequence[str]) -> str:
    """Return the warning that says what a prior determines."""
    if dominated:
        return (
            f"{prior.name} was used, and determines {', '.join(dominated)} more than the samples do"
        )
    return f"{prior.name} was used; the samples determine every parameter more than it does"
