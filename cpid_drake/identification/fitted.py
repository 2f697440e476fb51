"""The fit of all samples: log → model → fit → comparison → identification, for one log or many."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import prefix_errors
from cpid_drake.estimation.events import Event, fit_with_events
from cpid_drake.estimation.evidence import NAMED, Comparison, Question
from cpid_drake.estimation.fit import Fit, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.estimation.whiteness import least_white, whiteness
from cpid_drake.identification.checks import noise_warnings
from cpid_drake.identification.comparison import (
    contradicted,
    larger_than_declared,
    undeclared_errors,
    with_plausible,
    words,
)
from cpid_drake.identification.estimate import at_momentum, effects_of, momentum_of, solution_of
from cpid_drake.identification.problem import (
    ESTIMATED,
    MAY_MOVE,
    NOT_ZERO,
    SUSPECTED,
    Estimator,
    Problem,
)
from cpid_drake.identification.result import Check, MomentumEstimate
from cpid_drake.identification.solved import ResidualSeries, SolvedIdentification
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.identification.together import with_sources
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.suite import SensorSuite

NAME = "trajectory_fit"
"""The estimator's name."""

_HELD = 1e-9
"""σ of a target that is held while the rest is fitted, in plausible sizes."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A fit, and what the comparison of its candidates says.

    Attributes:
        found: the fit, with all candidates free.
        rows: what is known besides the samples.
        question: what was compared.
        compared: the comparison.
        events: changes of the momentum.
        contradicted: logs whose given momentum the samples contradict; it is unknown then.

    """

    found: Fit
    rows: tuple[Gaussian, ...]
    question: Question
    compared: Comparison
    events: tuple[Event, ...]
    contradicted: tuple[str, ...]

    @property
    def gaussian(self) -> Gaussian:
        """The average of all that is no candidate, about the fit's values."""
        average = self.compared.gaussian
        return average.moved(np.concatenate([self.found.values[name] for name in average.places]))


def fit_target(
    problems: Mapping[str, Problem],
    momentum: TotalMomentum | None,
    prior: TargetPrior | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> SolvedIdentification:
    """Fit one target, and all that is not known besides, to all samples of some logs.

    Args:
        problems: of the same spacecraft and sensors, by the names of the logs.
        momentum: the total momentum of every log; None to compare zero with an unknown one.
        prior: what is known of the target; None for nothing.
        progress: called before every step with a short description of it.

    Raises:
        InputError: a log has too few samples, or no motion can be predicted.

    """
    problem, suite, warnings = next(iter(problems.values())).with_sensors()
    has_thrust = any(each.log.has_thrust for each in problems.values())
    candidates = with_plausible(suite, has_thrust=has_thrust)
    model = Model(problem.spacecraft.tree, candidates, problem.known_bodies)
    declared = Constants.of(suite, model.joint_count).errors
    logs = []
    for name, each in problems.items():
        with prefix_errors(name if len(problems) > 1 else ""):
            logs.append(LogState.of(model, each.log.measurements, name))
    progress("fitting")
    answer = _answer(model, logs, Question.of(model, declared, list(problems), momentum), prior)
    found, compared, gaussian = answer.found, answer.compared, answer.gaussian
    progress("comparing")
    series = _residuals(found)
    tests = {name: whiteness(each.value) for name, each in series.items()}
    names = [log.name for log in logs]
    likely = max(compared.probability.get(f"{MOMENTUM}|{name}", 0.0) for name in names)
    is_free = likely >= NAMED or (momentum is not None and momentum.is_unknown)
    is_free = is_free or len(answer.contradicted) == len(names)
    noise = {name: f for log in found.logs for name, f in _factors(log, names).items()}
    warnings = (*warnings, *noise_warnings(noise), *_of_events(answer))
    if likely >= NAMED:
        warnings = (*warnings, ESTIMATED)
    elif likely > SUSPECTED:
        warnings = (*warnings, MAY_MOVE.format(f"{likely:.2g}"))
    undeclared = undeclared_errors(found, answer.question, compared, answer.rows)
    effects = tuple(
        effect for name in names for effect in effects_of(model, found.values, gaussian, name)
    )
    more_warnings, checks = words(undeclared)
    both = (*effects, *undeclared.effects)
    wrong = (f"{n}: {NOT_ZERO}" if len(names) > 1 else NOT_ZERO for n in answer.contradicted)
    checks = (
        *(Check("momentum", sentence) for sentence in wrong),
        *checks,
        *larger_than_declared(model, found.values, gaussian, both, compared),
    )
    left_out, used = _counts(found)
    result = SolvedIdentification(
        relative_parameterization(model.mass),
        solution_of(model, found.values, gaussian, residual_sum=found.cost, row_count=used),
        sample_count=used,
        estimator=NAME,
        sensors=suite,
        converged=found.converged,
        whiteness=least_white(tests.values()),
        tests=tests if len(logs) == 1 else {},
        residuals=series if len(logs) == 1 else {},
        rejected={name: count for name, (count, _) in left_out.items() if count},
        momentum_changes=tuple(sorted(event.time for event in answer.events)),
        warnings=(*warnings, *more_warnings),
        checks=checks,
        momentum="unknown" if is_free else _name(momentum),
        noise=noise,
        unexplained=max((count / max(n, 1) for count, n in left_out.values()), default=0.0),
        momentum_estimate=_momentum(answer, gaussian, names[0]) if len(logs) == 1 else None,
        effects=effects,
        undeclared=undeclared,
    )
    if len(logs) == 1 and prior is None:
        return result
    return _tested(result, answer, prior)


def _tested(
    result: SolvedIdentification, answer: Answer, prior: TargetPrior | None
) -> SolvedIdentification:
    """Return an identification with the test whether logs and prior have the same target."""
    found, question = answer.found, answer.question
    values = dict.fromkeys((n for n in question.candidates if n not in answer.compared.best), 0.0)
    known = {n: v - found.values[n] for n, v in (values | question.given).items()}

    def conditioned(gaussian: Gaussian) -> Gaussian:
        return gaussian.condition({n: v for n, v in known.items() if n in gaussian.places})

    own, logs = {}, {}
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        alone = log
        if len(found.logs) > 1:  # a difference between logs must not look like noise
            by_itself = fit(found.model, [log], values=found.values).logs[0]
            alone = replace(log, noise=by_itself.noise, weights=by_itself.weights)
        own[log.name] = conditioned(sweep(found.model, alone, rolled, found.values).gaussian)
        where = f"{log.name}: "
        failures = tuple(
            text.removeprefix(where) for text in result.failures if text.startswith(where)
        )
        logs[log.name] = _counts(replace(found, logs=[alone]))[1], failures
    if prior is not None:
        own[prior.name] = answer.rows[0].moved(found.values[PSI])
    return with_sources(
        result,
        conditioned(prior_of(found.model, found.logs, found.values, ())),
        own,
        PSI,
        lambda gaussian: solution_of(found.model, found.values, gaussian),
        logs,
        prior,
    )


def _answer(
    model: Model, logs: Sequence[LogState], question: Question, prior: TargetPrior | None
) -> Answer:
    """Return the fit and the comparison; a prior is linear about the target that both give."""
    form = relative_parameterization(model.mass)
    rows: tuple[Gaussian, ...] = ()
    values = None
    for _ in range(1 if prior is None else 2):
        if prior is not None:
            vague = next(unknown.mean for unknown in model.table if unknown.name == PSI)
            psi = vague if values is None else values[PSI]
            at = prior.moved(form, psi) if values is None else psi
            rows = (prior.gaussian(PSI, form, at, model.plausible),)
        found = fit(model, logs, rows=rows, values=values)
        values, logs = found.values, found.logs
    sigma = model.unknown(MOMENTUM).sigma
    wrong = contradicted(found.gaussian, found.values, question, sigma)
    found, events = fit_with_events(model, found, _without(question, wrong), rows)
    wrong = contradicted(found.gaussian, found.values, question, sigma)  # beside the changes
    question = _without(question, wrong)
    compared = question.answer(found.gaussian, found.values)
    logs_of = tuple(name.partition("|")[2] for name in wrong)
    return Answer(found, rows, question, compared, tuple(events), logs_of)


def _without(question: Question, wrong: Sequence[str]) -> Question:
    """Return the question without given values that are wrong."""
    given = {name: value for name, value in question.given.items() if name not in wrong}
    return replace(question, given=given)


def _name(momentum: TotalMomentum | None) -> str:
    return "zero" if momentum is None else momentum.name


def _momentum(answer: Answer, gaussian: Gaussian, log: str) -> MomentumEstimate | None:
    """Return the momentum at the start of a log; None if it is zero or given."""
    found, key = answer.found, f"{MOMENTUM}|{log}"
    if key in answer.compared.values:
        value, sigma = answer.compared.values[key], answer.compared.sigma[key]
        count = 6 if "position" in found.model.suite.present() else 3
        return MomentumEstimate(value[:count], np.diag(sigma[:count] ** 2))
    return momentum_of(found.model, found.values, gaussian, log)


def _residuals(found: Fit) -> dict[str, ResidualSeries]:
    """Return the residuals of every sensor, without samples that are far off."""
    times: dict[str, list[NDArray[np.float64]]] = {}
    values: dict[str, list[NDArray[np.float64]]] = {}
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        for block, rest, weights in zip(log.blocks, rolled.residuals, log.weights, strict=True):
            for name, value in rest.items():
                near = weights.get(name, np.ones(len(value))) == 1.0
                times.setdefault(name, []).append(block.samples[name].time[near])
                values.setdefault(name, []).append(value[near])
    return {
        name: ResidualSeries(np.concatenate(times[name]), np.concatenate(values[name]), "σ")
        for name in times
    }


def _counts(found: Fit) -> tuple[dict[str, tuple[int, int]], int]:
    """Return by sensor the samples that are far off and all samples; and all that are used."""
    counts: dict[str, tuple[int, int]] = {}
    used = 0
    for log in found.logs:
        for block, weights in zip(log.blocks, log.weights, strict=True):
            for name in found.model.suite.present():
                n, far = len(block.samples[name]), int((weights.get(name, np.ones(0)) < 1).sum())
                before = counts.get(name, (0, 0))
                counts[name] = before[0] + far, before[1] + n
                used += n - far
    return counts, used


def _factors(log: LogState, names: Sequence[str]) -> dict[str, float]:
    """Return the noise factors of a log, by sensor, and by log if there are several."""
    where = f" of {log.name}" if len(names) > 1 else ""
    return {f"{name}{where}": factor for name, factor in log.noise.items()}


def _of_events(answer: Answer) -> tuple[str, ...]:
    """Return the warning about changes of the momentum."""
    if not answer.events:
        return ()
    n, last = len(answer.events), max(event.time for event in answer.events)
    times = "once" if n == 1 else f"{n} times"
    return (
        f"the momentum changed {times}, last at {last:.3f} s; it was estimated again from then on",
    )


def needs_of_fit(family: RowFamily | None, momentum: TotalMomentum) -> tuple[tuple[str, ...], ...]:
    """Return the sensors that the fit needs: at least one sensor of each entry."""
    return (("encoders",), ("attitude",))


def cramer_rao_bound(
    tree: KinematicTree,
    psi: NDArray[np.float64],
    measurements: Iterable[Measurements] | Measurements,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
) -> NDArray[np.float64]:
    """Return the Cramér-Rao bound (10, 10) on the covariance of the parameters π.

    Rows and columns of parameters that the measurements do not determine are NaN. Attitude and
    position at the start, gyro bias, an unknown momentum and all errors of the joint motion are
    estimated as well. The bound holds for unbiased estimators.

    Args:
        tree: the known bodies.
        psi: (10,) relative unknowns of the target.
        measurements: ideal samples of the sensors, or a stream of them.
        sensors: the sensors' errors.
        momentum: the total momentum, marked as unknown if it is to be estimated; default: zero.
        known_bodies: uncertainty of the known bodies, which are estimated too.

    Raises:
        InputError: no attitude samples, or no motion can be predicted.

    """
    model = Model(tree, sensors, known_bodies)
    log = LogState.of(model, measurements)
    R = np.diag(1 / (_HELD * model.plausible))
    held = Gaussian.of_rows({PSI: 10}, np.column_stack([R, R @ psi]))
    found = fit(model, [log], rows=[held], values={PSI: np.asarray(psi)})
    [log], [rolled], values = found.logs, found.rolled, found.values
    log = replace(log, noise={}, weights=tuple({} for _ in log.blocks))  # as declared
    total = prior_of(model, [log], values, ()).add(sweep(model, log, rolled, values).gaussian)
    known = at_momentum(total, values, momentum or TotalMomentum.zero(), log.name)
    known = known.moved(known.solve())  # the vague prior prefers another target than the true one
    parameterization = relative_parameterization(model.mass)
    solution = solution_of(model, values, known)
    return SolvedIdentification(
        parameterization, solution, sample_count=0, estimator=NAME
    ).covariance


TRAJECTORY_FIT = Estimator(
    name=NAME,
    label="trajectory fit (maximum likelihood)",
    good_for="the best estimate from noisy sensors, after the motion; finds firings of thrusters",
    estimate=fit_target,
    needs=needs_of_fit,
    prefers_sensors=True,
    uses_added_sensors=True,
    uses_thrust=True,
    uses_known_bodies=True,
    reports=8,
)
