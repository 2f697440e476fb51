"""One target from several logs, and from a prior: the joint estimate, and whether all agree.

Each log is identified on its own first, with its own start, momentum, biases and effects, and its
answer passes the gate. The estimates are then combined in all combinations of the unknowns that
they determine. The equations of the fits are not linear, so each log is linearized again about the
joint estimate until that does not change. Doubts about one log are doubts about the joint estimate.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, Parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.block_state import KNOWN_SHARE
from cpid_drake.estimation.combination import (
    Agreement,
    SourceRows,
    agreement,
    agreement_of_one,
    joint_solution,
    with_shared_errors,
)
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.estimation.least_squares import KNOWN, LeastSquaresSolution
from cpid_drake.estimation.likelihood.priors import psi_scale, vague_prior
from cpid_drake.estimation.whiteness import least_white
from cpid_drake.identification.problem import Estimator, Problem
from cpid_drake.identification.result import Identification, JointEstimate, SeparateEstimate
from cpid_drake.identification.source_rows import rows_of
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.identification.trust import gated

CONTRADICTED = 1e-4
"""Probability of the differences between logs, or to the prior, below which they are a doubt."""

SCATTERED = 0.05
"""Probability of the differences between logs below which they widen the intervals."""

HOPELESS = 1e-12
"""Probability of the differences between logs below which no joint estimate explains the logs."""

MOST_ROUNDS = 10
"""Largest number of linearizations about the joint estimate."""

STEP_TOLERANCE = 0.05
"""Change of the joint estimate from round to round, in units of σ, at which the rounds end."""

DOMINATED = 0.5
"""Share of the variance of a parameter that the prior removes from which it dominates."""

ROUNDING = 1e-8
"""Least σ of a combination of unknowns, as a share of its plausible size: less is rounding."""

_WORSE = 1.2  # ratio of misfits from which a log does not fit the joint estimate
_MORE_UNEXPLAINED = 0.05


@dataclass(frozen=True, eq=False)
class IdentifiedLog:
    """A log with its own estimate.

    Attributes:
        name: its name in messages.
        record: the estimator.
        problem: the estimator's inputs.
        found: the estimate from this log alone, after the gate.

    """

    name: str
    record: Estimator
    problem: Problem
    found: Identification

    def about(self, x: NDArray[np.float64]) -> Identification:
        """Return the estimate linearized about the unknowns x (10,) if that makes a difference."""
        if self.record.estimate_about is None or not self.found.solution.rank:
            return self.found
        problem = self.problem
        if problem.momentum.name != self.found.momentum:
            problem = replace(problem, momentum=TotalMomentum.named(self.found.momentum))
        if problem.sensors is None:
            problem = replace(problem, sensors=self.found.sensors)
        return self.record.estimate_about(problem, x, self.found.misfit)


@dataclass(frozen=True, eq=False)
class _Combined:
    """The rows of all logs and of the prior about the joint unknowns x (10,)."""

    form: Parameterization
    x: NDArray[np.float64]
    scale: NDArray[np.float64]
    logs: tuple[SourceRows, ...]
    prior: tuple[SourceRows, ...] = ()

    @property
    def sources(self) -> tuple[SourceRows, ...]:
        return (*self.logs, *self.prior)

    def estimate(
        self, sources: Sequence[SourceRows], logs: Sequence[Identification], row_count: int
    ) -> LeastSquaresSolution:
        """Return the joint estimate, with the errors that the logs share."""
        gains = [log.shared for log in logs] + [None] * (len(sources) - len(logs))
        found = self.solution(sources, row_count=row_count)
        return with_shared_errors(found, sources, gains)

    def solution(
        self, sources: Sequence[SourceRows], largest: float = KNOWN, row_count: int = 0
    ) -> LeastSquaresSolution:
        for rows in self.prior if len(sources) > len(self.logs) else ():
            sizes = np.linalg.svd(rows.A * self.scale, compute_uv=False)
            largest = max(largest, 1.5 / sizes[sizes > 0].min())
        return joint_solution(sources, self.x, self.scale, largest=largest, row_count=row_count)

    def step(self) -> tuple[NDArray[np.float64], float]:
        """Return the change of x to the solution along well-known combinations, and its σ."""
        step = self.solution(self.sources, KNOWN_SHARE).values - self.x
        return step, float(np.linalg.norm(np.concatenate([s.A @ step for s in self.sources])))

    def of_each(self) -> list[Agreement]:
        """Return the tests whether each source agrees with all others."""
        count = len(self.sources)
        return [agreement_of_one(k, self.sources, self.x, self.scale) for k in range(count)]


def identify_jointly(
    logs: Sequence[IdentifiedLog],
    prior: TargetPrior | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> Identification:
    """Return the joint estimate of several logs of one target, and of a prior.

    Args:
        logs: the logs, identified with the same estimator and the same unknowns.
        prior: what is known besides; None for nothing.
        progress: called before every round with a short description of it.

    Raises:
        InputError: the logs have different unknowns, or the prior has others than the logs.

    """
    first = logs[0].found
    if any(log.found.parameterization.entries != first.parameterization.entries for log in logs):
        raise InputError("the logs were identified with different rows: name the rows")
    combined, converged, estimates = _combined(logs, prior, progress)
    joint = _tested(combined, logs, prior)
    weakened = replace(combined, logs=tuple(r.weakened(joint.widening) for r in combined.logs))
    count = sum(log.found.solution.row_count for log in logs)
    alone = weakened.estimate(weakened.logs, estimates, count)
    solution = weakened.estimate(weakened.sources, estimates, count) if prior else alone
    found = replace(_summed(logs), solution=solution, converged=converged)
    doubts = [*_of_logs(logs), *_of_agreement(combined, logs, joint, estimates)]
    warnings = _warnings_of(logs)
    if joint.widening > 1:
        warnings.append(
            f"the logs differ by more than their errors explain (probability "
            f"{joint.probability:.2g}); the intervals are wider by a factor of {joint.widening:.2g}"
        )
    if prior is not None:
        joint = replace(joint, dominated=_dominated(found, alone))
        warnings.append(_of_prior(prior, joint.dominated))
        doubts += [f"{prior.name}: {doubt}" for doubt in prior.doubts]
        doubts += _of_contradiction(combined, prior.name, joint)
    found = replace(found, joint=joint, warnings=tuple(dict.fromkeys(warnings)))
    rejected = sum((Counter(log.found.rejected) for log in logs), Counter[str]())
    return replace(gated(found, tuple(doubts)), rejected=dict(rejected))


def _summed(logs: Sequence[IdentifiedLog]) -> Identification:
    """Return an identification with the counts of all logs, which have passed the gate.

    What belongs to one log only is left out if there are several.
    """
    first, one = logs[0].found, len(logs) == 1
    return replace(
        first,
        sample_count=sum(log.found.sample_count for log in logs),
        whiteness=least_white(log.found.whiteness for log in logs if log.found.whiteness),
        residuals=first.residuals if one else {},
        rejected={},
        momentum_changes=first.momentum_changes if one else None,
        warnings=(),
        doubts=(),
        momentum=max((log.found.momentum for log in logs), key=("zero", "known", "unknown").index),
        misfit=1.0,
        unexplained=0.0,
        momentum_estimate=first.momentum_estimate if one else None,
        contradicts_zero=None,
        effects=first.effects if one else (),
        shared=None,
    )


def _tested(
    combined: _Combined, logs: Sequence[IdentifiedLog], prior: TargetPrior | None
) -> JointEstimate:
    """Return the separate estimates, and whether they agree."""
    whole = agreement(combined.logs, combined.x, combined.scale)
    with_prior = [test.probability for test in combined.of_each()]
    of_logs = [test.probability for test in replace(combined, prior=()).of_each()]
    probability = min(whole.probability, len(logs) * min(of_logs)) if len(logs) > 1 else 1.0
    widening = 1.0
    if probability < SCATTERED and whole.freedom:
        widening = max(float(np.sqrt(whole.chi_squared / whole.freedom)), 1.0)
    separate = tuple(
        SeparateEstimate(
            log.name,
            log.found.parameters,
            log.found.intervals,
            log.found.solution.rank,
            log.found.sample_count,
            own,
            log.found.doubts,
        )
        for log, own in zip(logs, of_logs if len(logs) > 1 else with_prior)
    )
    joint = JointEstimate(separate, None, whole.chi_squared, whole.freedom, probability, widening)
    if prior is None:
        return joint
    rank = len(combined.prior[0].b)
    estimate = SeparateEstimate(
        prior.name, prior.parameters, prior.intervals, rank, 0, with_prior[-1], prior.doubts
    )
    return replace(joint, prior=estimate)


def _combined(
    logs: Sequence[IdentifiedLog], prior: TargetPrior | None, progress: Callable[[str], None]
) -> tuple[_Combined, bool, list[Identification]]:
    """Return the rows of all sources, whether they converged, and the logs' last estimates."""
    form = logs[0].found.parameterization
    x, scale = _plausible(logs[0].problem, form)
    if prior is not None:
        x = prior.moved(form, x)
    estimates = [log.found for log in logs]
    is_linear = logs[0].record.estimate_about is None

    def at(x: NDArray[np.float64]) -> _Combined:
        rows = tuple(rows_of(found).limited(scale, ROUNDING) for found in estimates)
        told = (prior.rows(form, x, scale).limited(scale, ROUNDING),) if prior else ()
        return _Combined(form, x, scale, rows, told)

    combined = at(x)
    is_complete = all(found.is_observable for found in estimates)
    if is_complete and agreement(combined.logs, x, scale).probability < HOPELESS:
        return at(x + combined.step()[0]), True, estimates
    for k in range(MOST_ROUNDS):
        step, size = combined.step()
        if k and size < STEP_TOLERANCE:
            return combined, True, estimates
        x = x + step
        progress(f"joint estimate, round {k + 1}")
        try:
            estimates = estimates if is_linear else [log.about(x) for log in logs]
        except (InputError, np.linalg.LinAlgError):
            return combined, False, estimates
        combined = at(x)
    return combined, False, estimates


def _plausible(
    problem: Problem, form: Parameterization
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a plausible target's unknowns (10,), and their plausible sizes."""
    tree = problem.spacecraft.tree
    still = np.zeros((1, len(problem.spacecraft.joint_names)))
    known = relative_dynamics(tree, still, still)
    vague = vague_prior(known.mass, known.I_K[0])
    size = psi_scale(known.mass, known.I_K[0])
    if form.name == "relative":
        return vague.psi, size
    mass = vague.psi[0]
    inertia = np.full(3, vague.psi[4])
    x = form.from_parameters(np.concatenate([[mass], np.zeros(3), inertia, np.zeros(3)]))
    if form.name == "standard":
        return x, 2 * size
    radius = size[1] / size[0]
    return x, np.concatenate([[1 / known.mass], 3 * [radius], 6 * [known.mass * radius**2]])


def _of_logs(logs: Sequence[IdentifiedLog]) -> list[str]:
    """Return the doubts about each log."""
    if len(logs) == 1:
        return list(logs[0].found.doubts)
    return [f"{log.name}: {doubt}" for log in logs for doubt in log.found.doubts]


def _warnings_of(logs: Sequence[IdentifiedLog]) -> list[str]:
    """Return the warnings about each log; those about all logs without a name."""
    if len(logs) == 1:
        return list(logs[0].found.warnings)
    useless = [
        f"{log.name} determines nothing about the target, and was not used"
        for log in logs
        if not log.found.solution.rank
    ]
    count = Counter(text for log in logs for text in log.found.warnings)
    return useless + [
        text if count[text] == len(logs) else f"{log.name}: {text}"
        for log in logs
        for text in log.found.warnings
    ]


def _of_agreement(
    combined: _Combined,
    logs: Sequence[IdentifiedLog],
    joint: JointEstimate,
    estimates: Sequence[Identification],
) -> list[str]:
    """Return the doubt that the logs do not have the same target."""
    if len(logs) < 2:
        return []
    worse = [
        log.name
        for log, found in zip(logs, estimates)
        if found.misfit > _WORSE * log.found.misfit
        or found.unexplained > log.found.unexplained + _MORE_UNEXPLAINED
    ]
    if joint.probability >= CONTRADICTED and not worse:
        return []
    if joint.probability >= CONTRADICTED:
        return [
            "the logs do not agree: the joint estimate does not explain "
            f"{' and '.join(worse)}, which own estimates explain"
        ]
    text = f"the logs do not have the same target (probability {joint.probability:.1g})"
    of_logs = replace(combined, prior=())
    k = int(np.argmax([test.excess for test in of_logs.of_each()]))
    difference = _largest_difference(of_logs, k)
    if len(logs) == 2:
        return [f"{text}: {logs[0].name} and {logs[1].name} contradict each other{difference}"]
    return [f"{text}: {logs[k].name} disagrees most with the others{difference}"]


def _of_contradiction(combined: _Combined, name: str, joint: JointEstimate) -> list[str]:
    """Return the doubt that the prior and the logs do not have the same target."""
    probability = 1.0 if joint.prior is None else joint.prior.probability
    if probability >= CONTRADICTED:
        return []
    what = "the log" if len(combined.logs) == 1 else "the logs"
    return [
        f"{name} and {what} contradict each other (probability {probability:.1g})"
        f"{_largest_difference(combined, len(combined.logs))}"
    ]


def _largest_difference(combined: _Combined, number: int) -> str:
    """Return the parameter in which one source differs most from all others, in words."""
    own = combined.sources[number]
    others = [rows for k, rows in enumerate(combined.sources) if k != number]
    values, sigmas = [], []
    for sources in ([own], others):
        solution = joint_solution(sources, combined.x, combined.scale, largest=np.inf)
        values.append(combined.form.to_parameters(solution.estimate))
        sigmas.append(np.sqrt(np.diag(_covariance(combined.form, solution))))
    difference = values[0] - values[1]
    ratio = np.abs(difference) / np.hypot(*sigmas)
    if not np.isfinite(ratio).any():
        return ""
    i = int(np.nanargmax(ratio))
    return (
        f", most in {PARAMETER_NAMES[i]}: {values[0][i]:.4g} ± {quantile_95() * sigmas[0][i]:.2g} "
        f"against {values[1][i]:.4g} ± {quantile_95() * sigmas[1][i]:.2g}"
    )


def _covariance(form: Parameterization, solution: LeastSquaresSolution) -> NDArray[np.float64]:
    """Return the covariance (10, 10) of π; NaN where not determined."""
    found = Identification(form, solution, 0, "")
    return found.covariance


def _dominated(found: Identification, alone: LeastSquaresSolution) -> tuple[str, ...]:
    """Return the parameters of which the prior determines more than the logs do."""
    both = np.diag(found.covariance)
    own = np.diag(_covariance(found.parameterization, alone))
    with np.errstate(invalid="ignore"):
        is_open = np.isfinite(both) & ~(both > (1 - DOMINATED) * own)
    return tuple(name for name, flag in zip(PARAMETER_NAMES, is_open) if flag)


def _of_prior(prior: TargetPrior, dominated: Sequence[str]) -> str:
    if not dominated:
        return f"{prior.name} was used; the samples determine every parameter more than it does"
    return f"{prior.name} was used, and determines {', '.join(dominated)} more than the samples do"
