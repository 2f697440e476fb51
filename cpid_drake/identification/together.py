"""A result of several sources, logs and a prior: the estimate of each, and whether they agree.

All logs share the hardware's errors. The noise of a log is that of a fit to this log alone:
otherwise a difference would look like noise.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution
from cpid_drake.identification.agreement import Sources, largest_difference, most_different
from cpid_drake.identification.checks import Check
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification


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
    of_all = Sources(vague, sources, target, result.solution.unit)

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

    alone = {name: solution(of_all.together([name])) for name in names}
    warnings = [
        f"{name} identifies nothing of the target, and was not used"
        for name in counts
        if not alone[name].rank
    ]
    tests = []
    if prior is not None:  # what it contains is known, however vague it is
        both = (of_all.others(prior.name), names)
        pair = (part(solution(of_all.together(some))) for some in both)
        without, variance = (np.diag(each.covariance) for each in pair)
        # var(π) of all is less than half of that of the others
        is_half = ~np.isfinite(without) | (variance < without / 2)
        dominated = np.array(PARAMETER_NAMES)[is_half & np.isfinite(variance)]
        shown = ", ".join(dominated) or "no parameter"
        warnings.append(f"{prior.name} was used; it determines {shown} more than the samples do")
        tests = [Check("prior", f"{prior.name}: {text}") for text in prior.failures]
    separate = of_all.checks_of_each()
    parts = {name: part(alone[name], counts.get(name, 0), separate[name]) for name in names}
    worst = most_different(separate)
    sentence = "the logs" + (" and the prior" if prior is not None else "")
    sentence += f" do not have the same target: {worst} differs from the rest"
    rest = part(solution(of_all.together(of_all.others(worst))))
    sentence += largest_difference(parts[worst], rest)
    checks = (of_all.check(sentence, *([name] for name in names)), *tests)
    return replace(
        result,
        logs=parts,
        warnings=(*warnings, *result.warnings),
        checks=(*checks, *result.checks),
    )
