"""The fit of all samples: log → model → fit → comparison → identification, for one log or many."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import prefix_errors
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import NAMED, Comparison, Question, without_contradicted
from cpid_drake.estimation.fit import Fit, about, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.sweep import EXACT, sweep
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.budget import error_budget, size_checks
from cpid_drake.identification.checked_log import CheckedLog, Known, suite_of
from cpid_drake.identification.checks import (
    Check,
    fit_checks,
    momentum_words,
    noise_warnings,
)
from cpid_drake.identification.effects import EffectEstimate
from cpid_drake.identification.halves import part_checks
from cpid_drake.identification.leaning import leaning
from cpid_drake.identification.over_time import over_time
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.identification.together import with_sources
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.suite import SensorSuite

NAME = "trajectory_fit"
"""The estimator's name."""


def estimate(
    known: Known,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Fit one target, and all that is not known besides, to all samples of some logs.

    See `estimators.Estimator`.
    """
    suite, warnings = suite_of(known.sensors, *logs.values())
    has_thrust = any(log.measurements.has_thrust for log in logs.values())
    tree, bodies = known.spacecraft.tree, known.known_bodies
    model = Model.of(tree, suite, bodies, has_thrust=has_thrust)
    where = {name: f"{name}: " if len(logs) > 1 else "" for name in logs}
    states = []
    for name, log in logs.items():
        with prefix_errors(where[name].removesuffix(": ")):
            states.append(LogState.of(model, log.measurements, name))
    progress("fitting")
    question = Question.of(model, logs, known.momentum)
    found = _fit(model, states, known.prior, progress)
    asked = without_contradicted(found.gaussian, found.values, question, model)
    found, beside = fit_with_events(found, asked, progress)
    changes = sorted(time for log in found.logs for time in log.changes)
    given = question.given  # is compared again beside the changes
    question = without_contradicted(found.gaussian, found.values, question, model)
    progress("comparing")
    compared = question.answer(found.gaussian, found.values)
    found = about(found, question.held(found.values, compared.best))
    compared = question.answer(found.gaussian, found.values)
    average = compared.gaussian
    gaussian = average.moved(np.concatenate([found.values[name] for name in average.places]))
    checks, is_free = list[Check](), known.momentum is not None and known.momentum.is_unknown
    noise = {
        name if len(logs) == 1 else f"{name} of {log.name}": factor
        for log in found.logs
        for name, factor in log.noise.items()
    }
    gaps = [text for log in found.logs for text in gap_warnings(log, where[log.name])]
    warnings = (*warnings, *gaps, *noise_warnings(noise), *change_warnings(changes))
    for name in logs:
        key = model.unknown(MOMENTUM).key(name)
        is_wrong = key in given and key not in question.given
        likely = 1.0 if is_wrong else compared.probability.get(key, 0.0)
        is_free = is_free or likely >= NAMED
        is_given = known.momentum is not None
        said, failed = momentum_words(likely, is_given=is_given, where=where[name])
        warnings, checks = (*warnings, *said), [*checks, *failed]
    effects = effects_of(model, found.values, gaussian, *logs)
    said = tuple(f"{e.describe()}: it failed" for e in effects if e.failed_valve)
    held = question.held(found.values, compared.best)
    sizes = size_checks(model, found.values, gaussian, effects)
    parts = part_checks(found, held)
    series, counts = _residuals(found)
    rejected, used = Counter[str](), Counter[str]()
    for (source, sensor), (far, count) in counts.items():
        rejected[sensor] += far
        used[source] += count - far
    tests = {name: whiteness(each.value) for name, each in series.items()}
    unexplained = max(far / max(count, 1) for far, count in counts.values())
    fails = tuple(
        fit_checks(found.converged, unexplained, noise, tests, len(changes), len(logs), beside)
    )
    [first, *others] = logs
    own = {} if others else momentum_of(model, found.values, gaussian, first, compared)
    result = Identification.of_solution(
        relative_parameterization(model.mass),
        known_target(model, found.values[PSI], gaussian, count=used.total()),
        sensors=model.suite,
        sample_count=used.total(),
        estimator=NAME,
        residuals=series if len(logs) == 1 else {},
        rejected={name: count for name, count in rejected.items() if count},
        momentum_changes=tuple(changes),
        warnings=(*warnings, *said),
        checks=(*checks, *sizes, *parts, *fails),
        momentum="unknown" if is_free else (known.momentum or TotalMomentum.zero()).name,
        noise=noise,
        effects=effects,
        **own,
    )
    is_known = np.isfinite(np.diag(result.covariance))
    if found.converged and is_known.any():
        names = known.spacecraft.joint_names
        result = replace(result, budget=error_budget(found, held, is_known, names))
    if model.known_bodies is None and found.converged and result.solution is not None:
        result = replace(result, leaning=leaning(found, result.solution, held))
    if len(logs) == 1:
        result = replace(result, history=partial(over_time, found, held, NAME))
    if len(logs) == 1 and known.prior is None:
        return result
    return _separated(result, found, held, known.prior, used)


def change_warnings(times: Sequence[float]) -> tuple[str, ...]:
    """Return the warning about changes of the momentum at some times [s]."""
    if not times:
        return ()
    count = "once" if len(times) == 1 else f"{len(times)} times"
    text = f"the momentum changed {count}, last at {max(times):.3f} s"
    return (f"{text}; it was estimated again from then on",)


def gap_warnings(log: LogState, where: str = "") -> tuple[str, ...]:
    """Return the warning about a log's gaps; `where` comes before it."""
    gaps = [(log.blocks[k].end, log.blocks[k + 1].start) for k, gap in enumerate(log.gaps) if gap]
    if not gaps:
        return ()
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0])
    text = "there is a gap" if len(gaps) == 1 else f"there are {len(gaps)} gaps, the longest"
    return (
        f"{where}{text} from {start:.3f} s to {end:.3f} s in the samples of the joints: no sample "
        "inside is used, and attitude, position and momentum are estimated again behind it",
    )


def _fit(
    model: Model,
    logs: Sequence[LogState],
    prior: TargetPrior | None,
    progress: Callable[[str], object],
) -> Fit:
    """Return the fit; the prior's rows are linear about the target that logs and prior give."""
    if prior is None:
        return fit(model, logs, progress=progress)
    found = fit(replace(model, rows=(prior.of_psi(model),)), logs, progress=progress)
    rows = (prior.of_psi(model, found.values[PSI]),)
    return fit(replace(model, rows=rows), found.logs, values=found.values, progress=progress)


def _separated(
    result: Identification,
    found: Fit,
    held: Values,
    prior: TargetPrior | None,
    counts: Mapping[str, int],
) -> Identification:
    """Return an identification with the test whether logs and prior have the same target."""
    model = replace(found.model, rows=())

    def conditioned(gaussian: Gaussian) -> Gaussian:
        return gaussian.condition({n: v for n, v in held.items() if n in gaussian.places})

    sources = {}
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        alone = log
        if len(found.logs) > 1:  # a difference between logs must not look like noise
            by_itself = fit(model, [log], values=found.values).logs[0]
            alone = replace(log, noise=by_itself.noise, weights=by_itself.weights)
        swept = sweep(model, alone, rolled, found.values, forward_only=True)
        sources[log.name] = conditioned(swept.gaussian)
    if prior is not None:
        sources[prior.name] = found.model.rows[0].moved(found.values[PSI])
    return with_sources(
        result,
        conditioned(prior_of(model, found.logs, found.values)),
        sources,
        PSI,
        lambda gaussian: known_target(model, found.values[PSI], gaussian),
        counts,
        prior,
    )


def _residuals(found: Fit) -> tuple[dict[str, Samples], dict[tuple[str, str], tuple[int, int]]]:
    """Return residuals by sensor (of log), and the numbers of samples far off and of all."""
    series, counts = {}, {}
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        for name in found.model.suite.present():
            key = name if len(found.logs) == 1 else f"{name} of {log.name}"
            times, values, far, count = [np.empty(0)], [], 0, 0
            for block, rest, weights in zip(log.blocks, rolled.residuals, log.weights, strict=True):
                samples = block.samples[name]
                near = weights.get(name, np.ones(len(samples))) == 1.0
                far, count = far + int(np.sum(~near)), count + len(samples)
                if name in rest:
                    times.append(samples.time[near])
                    values.append(rest[name][near])
            counts[log.name, name] = far, count
            if values:
                series[key] = Samples(np.concatenate(times), np.concatenate(values))
    return series, counts


def cramer_rao_bound(
    tree: KinematicTree,
    psi: NDArray[np.float64],
    measurements: Iterable[Log] | Log,
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
        measurements: ideal samples of the sensors.
        sensors: the sensors' errors.
        momentum: the total momentum, marked as unknown if it is to be estimated; default: zero.
        known_bodies: uncertainty of the known bodies, which are estimated too.

    Raises:
        InputError: no attitude samples, or no motion can be predicted.

    """
    logs = [measurements] if isinstance(measurements, Log) else list(measurements)
    has_thrust = any(log.has_thrust for log in logs)
    model = Model.of(tree, sensors, known_bodies, has_thrust=has_thrust)
    log = LogState.of(model, logs)
    R = np.diag(1 / (EXACT * model.plausible))
    held = Gaussian.of_rows({PSI: 10}, np.column_stack([R, R @ psi]))
    fitted = fit(replace(model, rows=(held,)), [log])
    [log], [rolled], values = fitted.logs, fitted.rolled, fitted.values
    log = replace(log, noise={}, weights=tuple({} for _ in log.blocks))  # as declared
    total = prior_of(model, [log], values).add(sweep(model, log, rolled, values).gaussian)
    known = at_momentum(total, values, momentum or TotalMomentum.zero(), log.name)
    known = known.moved(known.solve())  # the vague prior prefers another target than the true one
    form, solution = relative_parameterization(model.mass), known_target(model, values[PSI], known)
    found = Identification.of_solution(form, solution, sample_count=0, estimator=NAME)
    J, P = (np.nan_to_num(x) for x in (form.jacobian(solution.estimate), solution.covariance))
    return np.where(np.isfinite(found.covariance), J @ P @ J.T, np.nan)


# -- what a Gaussian of x − values, from all logs and priors, says in a result's terms ------------


def at_momentum(gaussian: Gaussian, values: Values, momentum: TotalMomentum, log: str) -> Gaussian:
    """Return what is known if a log has this momentum; the same if it is unknown."""
    if momentum.is_unknown:
        return gaussian
    key = f"{MOMENTUM}|{log}"
    return gaussian.condition(
        {key: np.concatenate([momentum.L_WScm_W, momentum.v_WScm_W]) - values[key]}
    )


def effects_of(
    model: Model, values: Values, gaussian: Gaussian, *logs: str
) -> tuple[EffectEstimate, ...]:
    """Return the estimates of constant errors but biases; of those that walk, the last value."""
    errors, found = model.constants.errors, []
    shown = {name for name, error in errors.items() if error.kind != BIAS}
    for unknown in model.table:
        for log in logs if unknown.scope == "log" else logs[:1]:
            key = unknown.key(log)
            if unknown.name in shown and key in gaussian.places:
                own = gaussian.marginal([key])
                value, sigma = values[key] + own.solve(), np.sqrt(np.diag(own.covariance()))
                where = log if unknown.scope == "log" and len(logs) > 1 else ""
                found.append(EffectEstimate.of(errors[unknown.name], value, sigma, log=where))
    return tuple(found)


def momentum_of(
    model: Model, values: Values, gaussian: Gaussian, log: str, compared: Comparison | None = None
) -> dict[str, Any]:
    """Return a result's fields of L at the start of a log, and v_WScm if positions are measured.

    There are none if the momentum is known. One that acts has the values of its comparison.
    """
    key = f"{MOMENTUM}|{log}"
    if compared is not None and key in compared.values:
        value, covariance = compared.values[key], compared.covariance[key]
    elif key in gaussian.places:
        found = gaussian.marginal([key])
        value, covariance = values[key] + found.solve(), found.covariance()
    else:
        return {}
    count = 6 if "position" in model.suite.present() else 3
    free = [2, 3, 4][: count // 2]  # of (L, v) on a table
    entries = np.array(free if model.tree.normal_B is not None else range(count))
    return {
        "momentum_estimate": value[entries],
        "momentum_covariance": covariance[np.ix_(entries, entries)],
    }
