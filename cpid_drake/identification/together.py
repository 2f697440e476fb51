"""Whether several sources, logs and a prior, have the same target.

All logs share the hardware's errors. The sum of squares with one target, minus that with a target
for each source, has a χ² distribution if all have the same target. The noise of a log is that of a
fit to this log alone: otherwise a difference would look like noise. Source: Rao 1973, Linear
Statistical Inference and Its Applications, ch. 4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, chdtri

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import LeastSquaresSolution, quantile_95
from cpid_drake.identification.result import AGREEMENT, IMPROBABLE, Check, Identification
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.identification.target_prior import TargetPrior

DOMINATED = 0.5
"""Share of the variance of a parameter that the prior removes from which it dominates."""


def with_sources(
    result: SolvedIdentification,
    vague: Gaussian,
    sources: Mapping[str, Gaussian],
    target: str,
    solution: Callable[[Gaussian], LeastSquaresSolution],
    facts: Mapping[str, tuple[int, tuple[str, ...]]],
    prior: TargetPrior | None = None,
) -> SolvedIdentification:
    """Return an identification with the estimate of each source, and whether they agree.

    Args:
        result: the identification from all sources.
        vague: all unknowns before the samples.
        sources: what each log, and last the prior, tells about them, by its name; at least two.
        target: name of the target among the unknowns.
        solution: returns the target of a distribution of all unknowns.
        facts: number of samples of each log, and the failed checks of its own estimate.
        prior: what is known of the target besides.

    """
    names = list(sources)

    def told(*groups: Sequence[str]) -> Gaussian:
        return _with(vague, sources, target, groups)

    one, apart = told(names), told(*([name] for name in names))
    joint, alone = solution(one), {name: solution(told([name])) for name in names}
    rank = {name: found.rank for name, found in alone.items()}
    parts, rests, dominated = dict[str, Identification](), {}, tuple[str, ...]()
    warnings = [
        f"{name} determines nothing about the target, and was not used"
        for name in facts
        if not rank[name]
    ]
    if prior is not None:  # what it tells is known, however vague it is
        R = sources[prior.name].R
        rank[prior.name] = int(np.linalg.matrix_rank(R / np.linalg.norm(R, axis=0).clip(1e-300)))
    for name in names:
        others = [other for other in names if other != name]
        rests[name] = solution(told(others))
        chi_squared = one.least_cost - told([name], others).least_cost
        freedom = rests[name].rank + rank[name] - joint.rank
        check = _agreement("it differs from the others", chi_squared, freedom)
        if prior is not None and name == prior.name:
            dominated = _dominated(result, rests[name], joint)
            failures, part = prior.failures, _of_prior(prior, rank[name])
        else:
            count, failures = facts[name]
            part = replace(_alone(result, alone[name]), sample_count=count)
        checks = (check, *(Check("source", text) for text in failures))
        parts[name] = replace(part, checks=checks)
    worst = max(names, key=lambda name: _size(parts[name].agreement))
    sentence = "the logs" + (" and the prior" if prior is not None else "")
    sentence += f" do not have the same target: {worst} differs from the rest"
    sentence += _difference(result, alone[worst], rests[worst])
    freedom = sum(rank.values()) - joint.rank
    tests = [_agreement(sentence, one.least_cost - apart.least_cost, freedom)]
    if prior is not None:
        shown = ", ".join(dominated) or "no parameter"
        warnings.append(f"{prior.name} was used; it determines {shown} more than the samples do")
        tests += [Check("prior", f"{prior.name}: {text}") for text in prior.failures]
    return replace(
        result,
        logs=parts,
        dominated=dominated,
        warnings=(*warnings, *result.warnings),
        checks=(*tests, *result.checks),
    )


def _agreement(sentence: str, chi_squared: float, freedom: int) -> Check:
    """Return the check of a difference; its probability is put behind the sentence."""
    if freedom <= 0:
        return Check(AGREEMENT, "", passed=True)
    chi_squared = max(chi_squared, 0.0)
    sentence += f" (probability {float(chdtrc(freedom, chi_squared)):.1g})"
    return Check.of(AGREEMENT, sentence, chi_squared, float(chdtri(freedom, IMPROBABLE)))


def _size(check: Check | None) -> float:
    """Return the statistic of a check as a share of its limit."""
    if check is None or check.statistic is None or check.limit is None:
        return 0.0
    return check.statistic / check.limit


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


def _of_prior(prior: TargetPrior, rank: int) -> Identification:
    """Return what a prior tells, as an identification."""
    return Identification(
        parameters=prior.parameters,
        covariance=prior.covariance,
        intervals=prior.intervals,
        rank=rank,
        singular_values=np.full(10, np.nan),
        sample_count=0,
        estimator="prior",
    )


def _with(
    vague: Gaussian, sources: Mapping[str, Gaussian], target: str, groups: Sequence[Sequence[str]]
) -> Gaussian:
    """Return what some sources say together if each group of them has a target of its own."""
    others = [name for name in vague.places if name != target]
    total = vague.marginal(others) if others else None
    for k, group in enumerate(groups):
        for each in (vague.marginal([target]), *(sources[name] for name in group)):
            places = {f"{n} {k}" if n == target and k else n: p for n, p in each.places.items()}
            renamed = replace(each, places=places)
            total = renamed if total is None else total.add(renamed)
    assert total is not None
    return total


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
