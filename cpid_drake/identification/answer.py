"""What a fit says, in a result's terms: the same of all samples and online."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.evidence import NAMED, ModelComparison, Question
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import BIAS, NO_BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.identification.budget import error_budget, size_checks
from cpid_drake.identification.checks import (
    Check,
    Observed,
    fit_checks,
    momentum_words,
    noise_warnings,
)
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.effect_estimates import EffectEstimate
from cpid_drake.identification.result import Identification
from cpid_drake.identification.walk_check import walk_checks


def answer_of(
    fit: Fit,
    question: Question,
    momentum: TotalMomentum | None,
    observed: Observed,
    *,
    logs: Sequence[LogState] = (),
    joints: Sequence[str] | None,
    estimator: str,
) -> tuple[Identification, ChosenFit]:
    """Return what a fit says, and the fit with what is held in it.

    Args:
        fit: the fit.
        question: what is asked about the momentum of its logs, which is `momentum` if it is given.
        momentum: see `identify.identify`.
        observed: of all samples.
        logs: whose noise and gaps are judged; default: those of the fit.
        joints: names of the joints, for the error budget; None for no budget.
        estimator: name of the estimator.

    """
    model, names, values = fit.model, [log.name for log in fit.logs], fit.values
    # Posterior: the average over the sets of momenta that are not zero, by their probability.
    compared = question.answer(fit.gaussian, values)
    average = compared.gaussian
    gaussian = average.moved(np.concatenate([values[name] for name in average.places]))
    chosen = ChosenFit(fit, question.held(values, compared.best))
    target = known_target(model, values[PSI], gaussian, count=observed.used.total())
    effects = effects_of(model, values, gaussian, *names)
    # Checks and warnings: what each assumption means for the samples.
    noise, slow = dict[str, float](), dict[str, tuple[float, float]]()
    warnings, checks = list[str](), list[Check]()
    is_free = momentum is not None and momentum.is_unknown
    for log in logs or fit.logs:
        of_log = f" of {log.name}" if len(names) > 1 else ""
        where = f"{log.name}: " if len(names) > 1 else ""
        noise |= {name + of_log: factor for name, factor in log.noise_factors.items()}
        for name, process in {**log.processes, **log.smoothness.processes}.items():
            slow[name + of_log] = process.slow / max(process.total, 1.0), process.tau
        warnings += gap_warnings(log, where)
    warnings += [*noise_warnings(noise, slow), *change_warnings(observed.changes)]
    for name in names:
        key = model.unknown(MOMENTUM).key(name)
        is_wrong = question.is_given and key in compared.best
        likely = 1.0 if is_wrong else compared.probability.get(key, 0.0)
        is_free = is_free or likely >= NAMED
        where = f"{name}: " if len(names) > 1 else ""
        texts, failed = momentum_words(likely, is_given=momentum is not None, where=where)
        warnings, checks = [*warnings, *texts], [*checks, *failed]
    warnings += [f"{e.describe()}: it failed" for e in effects if e.failed_valve]
    fails = tuple(fit_checks(fit.converged, noise, observed, len(names)))
    sizes = size_checks(model, values, gaussian, effects, joints)
    [first, *others] = names
    result = Identification.of_solution(
        relative_parameterization(model.mass),
        target,
        sensors=model.suite,
        sample_count=observed.used.total(),
        estimator=estimator,
        rejected=observed.rejected,
        momentum_changes=observed.changes,
        warnings=tuple(warnings),
        checks=(*checks, *sizes, *walk_checks(fit), *fails),
        momentum="unknown" if is_free else (momentum or TotalMomentum.zero()).name,
        noise=noise,
        effects=effects,
        **({} if others else momentum_of(model, values, gaussian, first, compared)),
    )
    # Budget: what the variance of each identifiable parameter comes from.
    is_known = np.isfinite(np.diag(result.covariance))
    if joints is not None and fit.converged and is_known.any():
        result = replace(result, budget=error_budget(chosen, is_known, joints))
    return result, chosen


def change_warnings(times: Sequence[float]) -> tuple[str, ...]:
    """Return the warning about changes of the momentum at some times [s]."""
    if not times:
        return ()
    count = "once" if len(times) == 1 else f"{len(times)} times"
    text = f"the momentum changed {count}, last at {max(times):.3f} s"
    return (f"{text}; it was estimated again from then on",)


def gap_warnings(log: LogState, where: str = "") -> tuple[str, ...]:
    """Return the warning about a log's gaps; `where` comes before it."""
    ends = enumerate(log.links)
    gaps = [(log.blocks[k].end, log.blocks[k + 1].start) for k, link in ends if link.gap]
    if not gaps:
        return ()
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0])
    text = "there is a gap" if len(gaps) == 1 else f"there are {len(gaps)} gaps, the longest"
    return (
        f"{where}{text} from {start:.3f} s to {end:.3f} s in the samples of the joints: no sample "
        "inside is used, and attitude, position and momentum are estimated again behind it",
    )


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
    """Return the estimates of constant errors; of those that walk, the last value."""
    effects = []
    for key, (log, unknown) in model.unknowns_of(logs).items():
        error = model.of_log(log).constants.errors.get(unknown.name)
        has_none = error is None or (error.kind == BIAS and error.sigma <= NO_BIAS)
        if error is not None and not has_none and key in gaussian.places:
            own = gaussian.marginal([key])
            value, sigma = values[key] + own.solve(), np.sqrt(np.diag(own.covariance()))
            where = log if unknown.scope == "log" and len(logs) > 1 else ""
            owner = {"log": where, "hardware": unknown.hardware}
            effects.append(EffectEstimate.of(error, value, sigma, **owner))
    return tuple(effects)


def momentum_of(
    model: Model,
    values: Values,
    gaussian: Gaussian,
    log: str,
    compared: ModelComparison,
) -> dict[str, Any]:
    """Return a result's fields of L at the start of a log, and v_WScm if positions are measured.

    There are none if the momentum is known. One that acts has the values of its comparison.
    """
    key = f"{MOMENTUM}|{log}"
    if key in compared.values:
        value, covariance = compared.values[key], compared.covariance[key]
    elif key in gaussian.places:
        own = gaussian.marginal([key])
        value, covariance = values[key] + own.solve(), own.covariance()
    else:
        return {}
    count = 6 if "position" in model.suite.present() else 3
    free = [2, 3, 4][: count // 2]  # of (L, v) on a table
    entries = np.array(free if model.tree.normal_B is not None else range(count))
    return {
        "momentum_estimate": value[entries],
        "momentum_covariance": covariance[np.ix_(entries, entries)],
    }
