"""What a fit says, in a result's terms: the same of all samples and online."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.evidence import NAMED, ModelComparison, Question
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.identification.budget import error_budget, size_checks
from cpid_drake.identification.checks import Check, fit_checks, momentum_words, noise_warnings
from cpid_drake.identification.effects import EffectEstimate
from cpid_drake.identification.result import Identification


@dataclass(frozen=True, eq=False)
class Observed:
    """What the residuals of all samples show.

    Attributes:
        tests: whiteness of the residuals of each sensor (of log).
        counts: numbers of outliers, and of all samples, by log and sensor.
        changes: times at which the momentum changed [s].

    """

    tests: Mapping[str, Whiteness]
    counts: Mapping[tuple[str, str], tuple[int, int]]
    changes: tuple[float, ...] = ()

    @property
    def used(self) -> Counter[str]:
        """Number of samples that are no outliers, by log."""
        used = Counter[str]()
        for (log, _), (far, count) in self.counts.items():
            used[log] += count - far
        return used

    @property
    def rejected(self) -> dict[str, int]:
        """Number of outliers by sensor."""
        rejected = Counter[str]()
        for (_, sensor), (far, _) in self.counts.items():
            rejected[sensor] += far
        return {name: count for name, count in rejected.items() if count}

    @property
    def outlier_share(self) -> float:
        """Largest share of outliers in a sensor's samples."""
        return max(far / max(count, 1) for far, count in self.counts.values())


def answer_of(
    found: Fit,
    question: Question,
    momentum: TotalMomentum | None,
    observed: Observed,
    *,
    joints: Sequence[str] | None,
    estimator: str,
) -> tuple[Identification, Values]:
    """Return what a fit says, and what is held in it.

    Args:
        found: the fit.
        question: what is asked about the momentum.
        momentum: the total momentum of all logs; None for zero or unknown.
        observed: of all samples.
        joints: names of the joints, for the error budget; None for no budget.
        estimator: name of the estimator.

    """
    model, names = found.model, [log.name for log in found.logs]
    where = {name: f"{name}: " if len(names) > 1 else "" for name in names}
    given = question.given
    question = question.without_contradicted(found.gaussian, found.values, model)
    compared = question.answer(found.gaussian, found.values)
    average = compared.gaussian
    gaussian = average.moved(np.concatenate([found.values[name] for name in average.places]))
    checks, is_free = list[Check](), momentum is not None and momentum.is_unknown
    noise = {
        name if len(names) == 1 else f"{name} of {log.name}": factor
        for log in found.logs
        for name, factor in log.noise_factors.items()
    }
    spectra = {
        name if len(names) == 1 else f"{name} of {log.name}": spectrum
        for log in found.logs
        for name, spectrum in {**log.spectra, **log.smoothness.spectra}.items()
    }
    changes, gaps = (
        observed.changes,
        [text for log in found.logs for text in gap_warnings(log, where[log.name])],
    )
    warnings = (*gaps, *noise_warnings(noise, spectra), *change_warnings(changes))
    for name in names:
        key = model.unknown(MOMENTUM).key(name)
        is_wrong = key in given and key not in question.given
        likely = 1.0 if is_wrong else compared.probability.get(key, 0.0)
        is_free = is_free or likely >= NAMED
        is_given = momentum is not None
        said, failed = momentum_words(likely, is_given=is_given, where=where[name])
        warnings, checks = (*warnings, *said), [*checks, *failed]
    effects = effects_of(model, found.values, gaussian, *names)
    said = tuple(f"{e.describe()}: it failed" for e in effects if e.failed_valve)
    sizes = size_checks(model, found.values, gaussian, effects, joints)
    tests, outliers = observed.tests, observed.outlier_share
    fails = fit_checks(found.converged, outliers, noise, tests, len(changes), len(names))
    [first, *others] = names
    own = {} if others else momentum_of(model, found.values, gaussian, first, compared)
    count = observed.used.total()
    result = Identification.of_solution(
        relative_parameterization(model.mass),
        known_target(model, found.values[PSI], gaussian, count=count),
        sensors=model.suite,
        sample_count=count,
        estimator=estimator,
        rejected=observed.rejected,
        momentum_changes=changes,
        warnings=(*warnings, *said),
        checks=(*checks, *sizes, *fails),
        momentum="unknown" if is_free else (momentum or TotalMomentum.zero()).name,
        noise=noise,
        effects=effects,
        **own,
    )
    held = question.held(found.values, compared.best)
    is_known = np.isfinite(np.diag(result.covariance))
    if joints is not None and found.converged and is_known.any():
        result = replace(result, budget=error_budget(found, held, is_known, joints))
    return result, held


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
    found = []
    for key, (log, unknown) in model.unknowns_of(logs).items():
        error = model.of_log(log).constants.errors.get(unknown.name)
        if error is not None and error.kind != BIAS and key in gaussian.places:
            own = gaussian.marginal([key])
            value, sigma = values[key] + own.solve(), np.sqrt(np.diag(own.covariance()))
            where = log if unknown.scope == "log" and len(logs) > 1 else ""
            owner = {"log": where, "hardware": unknown.hardware}
            found.append(EffectEstimate.of(error, value, sigma, **owner))
    return tuple(found)


def momentum_of(
    model: Model,
    values: Values,
    gaussian: Gaussian,
    log: str,
    compared: ModelComparison | None = None,
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
