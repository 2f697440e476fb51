"""What a fit says, as an identification: one path for the fit of all samples and for that online.

Fit → momenta that are held → posterior of the target, with the doubts about them → checks and
warnings → error budget.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import BIAS, NO_BIAS
from cpid_drake.estimation.posterior import estimate_of, target_estimate
from cpid_drake.estimation.residuals import near_residuals
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.identification.budget import error_budget, size_checks
from cpid_drake.identification.checks import Check, fit_checks, momentum_words
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.effect_estimates import EffectEstimate
from cpid_drake.identification.observed import Observed
from cpid_drake.identification.result import Identification
from cpid_drake.identification.walk_check import walk_checks
from cpid_drake.identification.words import observed_warnings


def answer_of(
    chosen: ChosenFit, observed: Observed, estimator: str, joints: Sequence[str] | None = None
) -> Identification:
    """Return what a fit says.

    Args:
        chosen: the fit, with what is held in it.
        observed: of all samples.
        estimator: name of the estimator.
        joints: names of the joints, for the error budget; default: no budget.

    """
    fit, gaussian = chosen.fit, chosen.compared.gaussian
    model, values, names = fit.model, fit.values, [log.name for log in fit.logs]
    effects = _effects(model, values, gaussian, names)
    of_momentum, checks = list[str](), list[Check]()
    for name in names:
        is_given, where = chosen.question.is_given, f"{name}: " if len(names) > 1 else ""
        texts, failed = momentum_words(chosen.probability[name], is_given=is_given, where=where)
        of_momentum, checks = [*of_momentum, *texts], [*checks, *failed]
    valves = [f"{each.describe()}: it failed" for each in effects if each.failed_valve]
    result = target_only(
        model,
        values,
        gaussian,
        sample_count=observed.used.total(),
        estimator=estimator,
        rejected=observed.rejected,
        momentum=chosen.momentum,
        momentum_changes=observed.changes,
        noise=observed.noise,
        effects=effects,
        warnings=(*observed_warnings(observed), *of_momentum, *valves),
        checks=(
            *checks,
            *size_checks(model, values, gaussian, effects, joints),
            *walk_checks(fit),
            *fit_checks(fit.converged, observed),
        ),
        **(_of_one_log(chosen) if len(names) == 1 else {}),
    )
    # Budget: what the variance of each identifiable parameter comes from.
    is_known = np.isfinite(np.diag(result.covariance))
    if joints is None or not (fit.converged and is_known.any()):
        return result
    return replace(result, budget=error_budget(chosen, is_known, joints))


def target_only(
    model: Model, values: Values, gaussian: Gaussian, *, sample_count: int, **others: Any
) -> Identification:
    """Return what is known of the target about its values, as an identification.

    Args:
        model: the unknowns.
        values: of all unknowns.
        gaussian: of all unknowns about these values, with the prior of the target.
        sample_count: number of the samples.
        others: further attributes of the identification.

    """
    solution = target_estimate(model, values[PSI], gaussian, count=sample_count)
    form, suite = relative_parameterization(model.mass), model.suite
    return Identification.of_solution(
        form, solution, sensors=suite, sample_count=sample_count, **others
    )


def _effects(
    model: Model, values: Values, gaussian: Gaussian, logs: Sequence[str]
) -> tuple[EffectEstimate, ...]:
    """Return the estimates of constant errors; of those that walk, the last value."""
    effects = []
    for key, (log, unknown) in model.unknowns_of(logs).items():
        error = model.of_log(log).constants.errors.get(unknown.name)
        has_none = error is None or (error.kind == BIAS and error.sigma <= NO_BIAS)
        if error is not None and not has_none and key in gaussian.places:
            value, covariance = estimate_of(key, values, gaussian)
            sigma = np.sqrt(np.diag(covariance))
            where = log if unknown.scope == "log" and len(logs) > 1 else ""
            owner = {"log": where, "hardware": unknown.hardware}
            effects.append(EffectEstimate.of(error, value, sigma, **owner))
    return tuple(effects)


def _of_one_log(chosen: ChosenFit) -> dict[str, Any]:
    """Return the residuals of the only log, and L at its start; v_WScm if positions are measured.

    There is no momentum if it is known. One that acts has the values of its comparison.
    """
    fit, compared, gaussian = chosen.fit, chosen.compared, chosen.compared.gaussian
    [log], [rolled], model = fit.logs, fit.rolled, fit.model
    series = {name: near_residuals(log, rolled, name) for name in model.suite.present()}
    fields: dict[str, Any] = {"residuals": {n: each for n, each in series.items() if len(each)}}
    key = model.unknown(MOMENTUM).key(log.name)
    if key in compared.values:
        value, covariance = compared.values[key], compared.covariance[key]
    elif key in gaussian.places:
        value, covariance = estimate_of(key, fit.values, gaussian)
    else:
        return fields
    count = 6 if "position" in model.suite.present() else 3
    free = [2, 3, 4][: count // 2]  # of (L, v) on a table
    entries = np.array(free if model.tree.normal_B is not None else range(count))
    return fields | {
        "momentum_estimate": value[entries],
        "momentum_covariance": covariance[np.ix_(entries, entries)],
    }
