"""Whether several sources, logs and a prior, have the same target.

All logs share the hardware's errors. With a target for each source, what is known of the
differences between these targets has a χ² distribution about zero if all have the same target. The
noise of a log is that of a fit to this log alone: otherwise a difference would look like noise.
Source: Rao 1973, Linear Statistical Inference and Its Applications, ch. 4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, chdtri

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.estimation.posterior import difference
from cpid_drake.files.digits import with_half_width
from cpid_drake.identification.checks import AGREEMENT, IMPROBABLE, Check
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification

NO_PRIOR = 1e-4
"""So small a share of the prior's inverse σ is no prior, but leaves nothing undetermined."""


def with_sources(
    result: Identification,
    vague: Gaussian,
    sources: Mapping[str, Gaussian],
    target: str,
    solution: Callable[[Gaussian], LeastSquaresSolution],
    counts: Mapping[str, int],
    prior: TargetPrior | None = None,
) -> Identification:
    """Return an identification with the estimate of each source, and whether they agree.

    Args:
        result: the identification from all sources.
        vague: all unknowns before the samples, the target too.
        sources: the Gaussians of each log, and last of the prior, by its name; at least two.
        target: name of the target among the unknowns.
        solution: returns the target of a distribution of all unknowns.
        counts: number of samples of each log.
        prior: what is known of the target besides.

    """
    form, names = result.form, list(sources)
    assert form is not None
    assert result.solution is not None
    plausible = result.solution.unit

    def combined(*groups: Sequence[str]) -> Gaussian:
        return _with(vague, sources, target, groups)

    def part(own: LeastSquaresSolution, count: int = 0, *checks: Check) -> Identification:
        return Identification.of_solution(
            form,
            own,
            sensors=result.sensors,
            sample_count=count,
            estimator=result.estimator,
            rows=result.rows,
            momentum=result.momentum,
            checks=checks,
        )

    def agreement(sentence: str, *groups: Sequence[str]) -> Check:
        own = [target, *(f"{target} {k}" for k in range(1, len(groups)))]
        apart = _with(vague, sources, target, groups, share=NO_PRIOR)
        return _agreement(sentence, *difference(apart, plausible, own))

    others = {name: [other for other in names if other != name] for name in names}
    alone = {name: solution(combined([name])) for name in names}
    warnings = [
        f"{name} identifies nothing of the target, and was not used"
        for name in counts
        if not alone[name].rank
    ]
    tests = []
    if prior is not None:  # what it contains is known, however vague it is
        pair = (part(solution(combined(some))) for some in (others[prior.name], names))
        without, variance = (np.diag(each.covariance) for each in pair)
        is_half = ~np.isfinite(without) | (variance < without / 2)
        dominated = np.array(PARAMETER_NAMES)[is_half & np.isfinite(variance)]
        shown = ", ".join(dominated) or "no parameter"
        warnings.append(f"{prior.name} was used; it determines {shown} more than the samples do")
        tests = [Check("prior", f"{prior.name}: {text}") for text in prior.failures]
    parts, sizes = {}, {}
    for name in names:
        check = agreement("it differs from the others", [name], others[name])
        sizes[name] = (check.statistic or 0.0) / (check.limit or 1.0)
        parts[name] = part(alone[name], counts.get(name, 0), check)
    worst = max(names, key=lambda name: sizes[name])
    sentence = "the logs" + (" and the prior" if prior is not None else "")
    sentence += f" do not have the same target: {worst} differs from the rest"
    sentence += _difference(parts[worst], part(solution(combined(others[worst]))))
    checks = (agreement(sentence, *([name] for name in names)), *tests)
    return replace(
        result,
        logs=parts,
        warnings=(*warnings, *result.warnings),
        checks=(*checks, *result.checks),
    )


def _agreement(sentence: str, chi_squared: float, freedom: int) -> Check:
    """Return the check of a difference; its probability is put behind the sentence."""
    if not freedom:
        return Check(AGREEMENT, "", passed=True)
    sentence += f" (probability {float(chdtrc(freedom, chi_squared)):.1g})"
    return Check.of(AGREEMENT, sentence, chi_squared, float(chdtri(freedom, IMPROBABLE)))


def _with(
    vague: Gaussian,
    sources: Mapping[str, Gaussian],
    target: str,
    groups: Sequence[Sequence[str]],
    share: float = 1.0,
) -> Gaussian:
    """Return what groups of sources say, each with its own target and a share of its prior."""
    total, own = vague.marginal(n for n in vague.places if n != target), vague.marginal([target])
    own = replace(own, R=share * own.R, z=share * own.z)
    for k, group in enumerate(groups):
        for each in (own, *(sources[name] for name in group)):
            places = {f"{n} {k}" if n == target and k else n: p for n, p in each.places.items()}
            total = total.add(replace(each, places=places))
    return total


def _difference(one: Identification, other: Identification) -> str:
    """Return the parameter in which two estimates differ most, in words."""
    values = np.array([one.parameters, other.parameters])
    sigmas = np.sqrt([np.diag(one.covariance), np.diag(other.covariance)])
    ratio = np.abs(values[0] - values[1]) / np.hypot(*sigmas)
    if not np.isfinite(ratio).any():
        return ""
    i, wide = int(np.nanargmax(ratio)), quantile_95() * sigmas
    return (
        f", most in {PARAMETER_NAMES[i]}: {with_half_width(values[0, i], wide[0, i])} "
        f"against {with_half_width(values[1, i], wide[1, i])}"
    )
