"""One target from several logs and a prior: the sum of their Gaussians, and whether they agree."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, Parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.estimation.least_squares import KNOWN, LeastSquaresSolution
from cpid_drake.estimation.likelihood.priors import psi_scale, vague_prior
from cpid_drake.estimation.rows_fit import TARGET, disagreement, rank_of, solution_of
from cpid_drake.estimation.whiteness import least_white
from cpid_drake.identification.result import Identification, JointEstimate, SeparateEstimate
from cpid_drake.identification.target_prior import TargetPrior

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.spacecraft.spacecraft import Spacecraft

CONTRADICTED = 1e-3
"""Probability below which samples contradict one target, or a momentum of zero."""

SCATTERED = 0.05
"""Probability of the differences between logs below which they widen the intervals."""

DOMINATED = 0.5
"""Share of the variance of a parameter that the prior removes from which it dominates."""

_MOST_ROUNDS = 10  # of linearizing a prior about the joint estimate


@dataclass(frozen=True, eq=False)
class Part:
    """One log: its name in messages, its estimate alone, and its Gaussian of the target."""

    name: str
    found: Identification
    target: Gaussian


def combined(
    spacecraft: "Spacecraft", logs: Sequence[Part], prior: TargetPrior | None = None
) -> Identification:
    """Return the estimate of one target from all logs and the prior, and whether they agree.

    Raises:
        InputError: the prior determines combinations of other unknowns.

    """
    form = logs[0].found.parameterization
    nominal, scale = plausible(spacecraft, form)
    targets = [log.target for log in logs]
    chi_squared, freedom, probability = disagreement(targets)
    widening = 1.0
    if probability < SCATTERED:
        widening = max(float(np.sqrt(chi_squared / freedom)), 1.0)
    weak = [replace(each, R=each.R / widening, z=each.z / widening) for each in targets]
    count = sum(log.found.solution.row_count for log in logs)
    alone = solution_of(reduce(Gaussian.add, weak), nominal, scale, row_count=count)
    found = replace(_summed(logs), solution=alone)
    doubts, warnings = _of_each(logs, "doubts"), _of_each(logs, "warnings")
    if len(logs) > 1 and probability < CONTRADICTED:
        others = [_against(k, targets) for k in range(len(logs))]
        worst = max(range(len(logs)), key=lambda k: others[k][0] / max(others[k][1], 1))
        pair = f"{logs[0].name} and {logs[-1].name} contradict each other"
        who = pair if len(logs) == 2 else f"{logs[worst].name} disagrees most with the others"
        doubts.append(
            f"the logs do not have the same target (probability {probability:.1g}): {who}"
            f"{_difference(worst, targets, found, nominal, scale)}"
        )
    if widening > 1:
        warnings.append(
            f"the logs differ by more than their errors explain (probability {probability:.2g}); "
            f"the intervals are wider by a factor of {widening:.2g}"
        )
    own, dominated = None, tuple[str, ...]()
    if prior is not None:
        told, solution, converged = _with_prior(prior, form, weak, nominal, scale, count)
        found = replace(found, solution=solution, converged=converged)
        targets = [*targets, told]
        dominated = _dominated(found, replace(found, solution=alone))
        words = f"determines {', '.join(dominated)} more than the samples do"
        less = "the samples determine every parameter more than it does"
        warnings.append(f"{prior.name} was used{', and ' + words if dominated else '; ' + less}")
        doubts += [f"{prior.name}: {doubt}" for doubt in prior.doubts]
        differs = _against(len(logs), targets)[2]
        own = SeparateEstimate(
            prior.name, prior.parameters, prior.intervals, rank_of(told), 0, differs, prior.doubts
        )
        if differs < CONTRADICTED:
            doubts.append(
                f"{prior.name} and {'the log' if len(logs) == 1 else 'the logs'} contradict each "
                f"other (probability {differs:.1g})"
                f"{_difference(len(logs), targets, found, nominal, scale)}"
            )
    separate = tuple(
        SeparateEstimate(
            log.name,
            log.found.parameters,
            log.found.intervals,
            log.found.solution.rank,
            log.found.sample_count,
            _against(k, targets)[2],
            log.found.doubts,
        )
        for k, log in enumerate(logs)
    )
    return replace(
        found,
        joint=JointEstimate(separate, own, chi_squared, freedom, probability, widening, dominated),
        warnings=tuple(warnings),
        doubts=tuple(doubts),
    )


def plausible(
    spacecraft: "Spacecraft", form: Parameterization
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a plausible target's unknowns (10,), and their plausible sizes."""
    still = np.zeros((1, len(spacecraft.joint_names)))
    known = relative_dynamics(spacecraft.tree, still, still)
    vague = vague_prior(known.mass, known.I_K[0])
    size = psi_scale(known.mass, known.I_K[0])
    if form.name == "relative":
        return vague.psi, size
    mass = vague.psi[0]
    inertia = np.full(3, vague.psi[4])
    x = form.from_parameters(np.concatenate([[mass], np.zeros(3), inertia, np.zeros(3)]))
    if form.name == "standard":
        return x, 2 * size
    # 1/m of a light target has no plausible size.
    radius = size[1] / size[0]
    return x, 1e6 * np.concatenate([[1 / known.mass], 3 * [radius], 6 * [known.mass * radius**2]])


def _with_prior(
    prior: TargetPrior,
    form: Parameterization,
    logs: Sequence[Gaussian],
    nominal: NDArray[np.float64],
    scale: NDArray[np.float64],
    count: int,
) -> tuple[Gaussian, LeastSquaresSolution, bool]:
    """Return the prior about the joint estimate, this estimate, and whether it converged."""
    x = prior.moved(form, nominal)
    for _ in range(_MOST_ROUNDS):
        rows = prior.rows(form, x, scale)
        told = Gaussian.of_rows({TARGET: 10}, np.column_stack([rows.A, rows.b]))
        # What only the prior determines is determined, however vague the prior is.
        sizes = np.linalg.svd(rows.A * scale, compute_uv=False)
        largest = max(KNOWN, 1.5 / float(sizes[sizes > 0].min()))
        total = reduce(Gaussian.add, [*logs, told])
        solution = solution_of(total, x, scale, largest=largest, row_count=count)
        step, x = solution.values - x, solution.values
        if np.linalg.norm(total.R @ step) < 0.01:
            return told, solution, True
    return told, solution, False


def _against(k: int, parts: Sequence[Gaussian]) -> tuple[float, int, float]:
    """Return χ², freedom and probability of the differences of one part to all others."""
    others = [part for i, part in enumerate(parts) if i != k]
    return disagreement([parts[k], reduce(Gaussian.add, others)]) if others else (0.0, 0, 1.0)


def _summed(logs: Sequence[Part]) -> Identification:
    """Return an identification with the counts of all logs; of several, without what is of one."""
    found = [log.found for log in logs]
    if len(found) == 1:
        return found[0]
    return replace(
        found[0],
        sample_count=sum(each.sample_count for each in found),
        whiteness=least_white(each.whiteness for each in found if each.whiteness),
        residuals={},
        momentum=max((each.momentum for each in found), key=("zero", "known", "unknown").index),
        misfit=1.0,
        momentum_estimate=None,
        contradicts_zero=None,
    )


def _of_each(logs: Sequence[Part], what: str) -> list[str]:
    """Return the doubts or warnings of each log, with its name unless all have the same warning."""
    told = [(log.name, text) for log in logs for text in getattr(log.found, what)]
    number = Counter(text for _, text in told)
    useless = [log.name for log in logs if not log.found.solution.rank]
    return [
        f"{name} determines nothing about the target, and was not used"
        for name in useless
        if what == "warnings" and len(logs) > 1
    ] + list(
        dict.fromkeys(
            text
            if len(logs) == 1 or (what == "warnings" and number[text] == len(logs))
            else f"{name}: {text}"
            for name, text in told
        )
    )


def _difference(
    k: int,
    parts: Sequence[Gaussian],
    found: Identification,
    nominal: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> str:
    """Return the parameter in which one part differs most from all others, in words."""
    others = reduce(Gaussian.add, [part for i, part in enumerate(parts) if i != k])
    pair = [
        replace(found, solution=solution_of(each, nominal, scale, largest=np.inf))
        for each in (parts[k], others)
    ]
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


def _dominated(found: Identification, alone: Identification) -> tuple[str, ...]:
    """Return the parameters of which the prior determines more than the logs do."""
    both, own = np.diag(found.covariance), np.diag(alone.covariance)
    with np.errstate(invalid="ignore"):
        is_open = np.isfinite(both) & ~(both > (1 - DOMINATED) * own)
    return tuple(name for name, flag in zip(PARAMETER_NAMES, is_open, strict=True) if flag)
