"""Which errors act that nobody has declared: candidates, their comparison, and what follows.

Every constant error of a sensor that has no declared σ is a candidate, and so are steady forces and
the momentum of a log. A fit with all of them free is compared with itself without each of them
(`estimation.evidence`): the target is the average. The same comparison of the first two thirds of
every log proposes errors, and the last third judges them: what chose a model cannot confirm it.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.estimation.evidence import NAMED, Comparison, Question
from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import ConstantError
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import MOMENTUM, Model
from cpid_drake.identification.checks import SUSPECTED, Check
from cpid_drake.identification.effects import LEARNED, EffectEstimate, UndeclaredErrors
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite

PLAUSIBLE = {
    "delay_ms": 30.0,
    "mounting_arcsec": 360.0,
    "scale_ppm": 1000.0,
    "misalignment_arcsec": 200.0,
    "lever_arm_mm": 30.0,
    "zero_mrad": 2.0,
}
"""σ of each kind of error of a sensor that is looked for, in the units of its field."""

FORCES = {"acceleration": 1e-3, "torque": 1e-2, "thrust_scale": 0.1}
"""The same of an acceleration [m/s²], a torque [N·m] and the scale of logged thrust."""

FAR_TOO_LARGE = 1e-6
"""Probability of so large errors below which a check fails: a declared σ is a rough number."""

FITTED = 2 / 3
"""Share of a log that proposes errors; the rest judges them."""


def contradicted(
    gaussian: Gaussian, values: Values, question: Question, model: Model
) -> tuple[str, ...]:
    """Return the names of the given momenta that the samples contradict.

    Args:
        gaussian: of all unknowns about their values.
        values: of the unknowns.
        question: with what is given.
        model: with the σ of a momentum that is not given.

    """
    if not question.given:
        return ()
    about = {name: value - question.given.get(name, 0.0) for name, value in values.items()}
    sigma = model.unknown(MOMENTUM).sigma
    candidates = question.candidates | dict.fromkeys(question.given, sigma)
    compared = Question(candidates, {}).answer(gaussian, about)
    return tuple(name for name in question.given if compared.probability[name] >= NAMED)


def with_plausible(
    sensors: SensorSuite, *, has_thrust: bool = False, has_joints: bool = True
) -> SensorSuite:
    """Return sensors in which every constant error has a plausible σ, if it had none.

    Args:
        sensors: the sensors.
        has_thrust: whether thrusters fired, whose log may have an error of its scale.
        has_joints: whether encoders have anything to measure.

    """
    result = copy(sensors)
    for name, errors in sensors.present().items():
        own = {
            each.name: PLAUSIBLE[each.name]
            for each in fields(errors)
            if each.name in PLAUSIBLE and not getattr(errors, each.name)
        }
        if name == "joint_rates" or (name == "encoders" and not has_joints):
            own = {}  # they have no errors of their own
        setattr(result, name, replace(errors, **own))
    old, forces = sensors.disturbances or Disturbances(), dict(FORCES)
    if not has_thrust or sensors.thrusters is not None:  # valves have their own errors
        del forces["thrust_scale"]
    larger: dict[str, Any] = {n: getattr(old, n) or sigma for n, sigma in forces.items()}
    result.disturbances = replace(old, **larger)
    return result


def undeclared_errors(
    found: Fit, question: Question, compared: Comparison, rows: Sequence[Gaussian]
) -> UndeclaredErrors:
    """Return the errors that act although nobody has declared them.

    Args:
        found: a fit with all candidates free.
        question: what is compared.
        compared: the comparison by all samples.
        rows: what is known besides the samples.

    """
    errors = {n: e for n, e in _errors(found).items() if n in question.candidates}
    named, is_one = [name for name in compared.named if name in errors], len(found.logs) == 1
    effects = tuple(
        EffectEstimate.of(
            errors[name],
            compared.values[name],
            compared.sigma[name],
            "" if is_one else name.partition("|")[2],
        )
        for name in named
        if name in compared.values
    )
    alone = ((_shown(name, is_one), compared.alone[name]) for name in errors)
    others = {n: p for n, p in compared.probability.items() if p and n in errors and n not in named}
    return UndeclaredErrors(
        effects,
        {_shown(name, is_one): p for name, p in others.items()},
        _declarations(found.model.suite, effects),
        tuple(sorted(alone, key=lambda each: -each[1])),
        _held_out(found, question, named, rows) if named else None,
    )


def words(undeclared: UndeclaredErrors) -> tuple[tuple[str, ...], tuple[Check, ...]]:
    """Return the warnings and failed checks that follow from errors nobody has declared."""
    warnings, checks = [], []
    acting = "; ".join(effect.describe() for effect in undeclared.effects)
    text = f"the samples show what the sensors do not declare: {acting}"
    if undeclared.is_proposed:
        declared = "; ".join(undeclared.declaration)
        warnings.append(f"{text}; the result includes it; add to the sensors' file: {declared}")
    elif undeclared.effects:
        text += "; the cause is not known, because this does not predict the end of the log better"
        checks.append(Check("undeclared errors", text, undeclared.held_out))
    likely = {name: p for name, p in undeclared.suspected.items() if p > SUSPECTED}
    if likely:
        named = [f"{name} (probability {p:.2g})" for name, p in likely.items()]
        warnings.append(
            "the samples may show an error that the sensors do not declare: "
            f"{' or '.join(named)}; the intervals include it"
        )
    return tuple(warnings), tuple(checks)


def larger_than_declared(
    model: Model,
    values: Values,
    gaussian: Gaussian,
    effects: Sequence[EffectEstimate],
    compared: Comparison | None = None,
) -> tuple[Check, ...]:
    """Return the check of errors that are too large for their declared or plausible σ.

    Before the first sample the errors m, in units of their σ, have the covariance 1, after the last
    one V. The estimate of m therefore has the covariance 1 − V. Combinations that the samples do
    not determine well, errors that walk, and what may fail are left out.

    Args:
        model: the unknowns.
        values: of all unknowns.
        gaussian: of the declared errors, about the values.
        effects: the estimates of declared errors and of those that act.
        compared: the comparison of candidates; None without any.

    """
    errors = model.constants.errors
    table = {unknown.name: unknown for unknown in model.table}
    steady = {name for name in errors if not (table[name].walk or table[name].may_fail)}
    names = [name for name in gaussian.places if name.partition("|")[0] in steady]
    both = gaussian.marginal(names)
    m = np.concatenate([np.empty(0), *(values[name] for name in names)]) + both.solve()
    sizes, axes = np.linalg.eigh(np.eye(both.size) - both.covariance())
    seen = sizes > 1 - LEARNED**2
    chi_squared, freedom = float(np.sum((axes[:, seen].T @ m) ** 2 / sizes[seen])), int(seen.sum())
    for name, value in ({} if compared is None else compared.values).items():
        if compared is not None and name.partition("|")[0] in errors:
            m, size = value / compared.sizes[name], (compared.sigma[name] / compared.sizes[name])
            seen = size < LEARNED
            chi_squared += float(np.sum(m[seen] ** 2 / (1 - size[seen] ** 2)))
            freedom += int(seen.sum())
    if not freedom:
        return ()
    limit, name = float(chdtri(freedom, FAR_TOO_LARGE)), "declared sizes"
    if chi_squared <= limit:
        return (Check(name, "", chi_squared, limit, passed=True),)
    largest = max(effects, key=lambda each: float(np.abs(each.value).max()) / each.prior_sigma)
    sentence = (
        "the errors of the sensors, or the forces, are about "
        f"{np.sqrt(chi_squared / freedom):.2g} times as large as their declared sigma, such as: "
        f"{largest.describe()}, with a sigma of {largest.prior_sigma:.3g} {largest.unit}; declare "
        "what the hardware can have, or look for another cause"
    )
    return (Check(name, sentence, chi_squared, limit),)


def _errors(found: Fit) -> dict[str, ConstantError]:
    """Return all constant errors of all logs, by the names of the unknowns."""
    errors = found.model.constants.errors
    return {
        unknown.key(log.name): errors[unknown.name]
        for unknown in found.model.table
        if unknown.name in errors
        for log in found.logs
    }


def _shown(name: str, is_one: bool) -> str:
    """Return the name of an error of a log, for people."""
    error, _, log = name.partition("|")
    return f"{error} of {log}" if log and not is_one else error


def _held_out(
    found: Fit, question: Question, named: Sequence[str], rows: Sequence[Gaussian]
) -> float | None:
    """Return how well errors that the first part of every log proposes predict the rest."""
    beginning, has_changes = prior_of(found.model, found.logs, found.values, rows), False
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        start, end = log.blocks[0].start, log.blocks[-1].end
        k = sum(block.end <= start + FITTED * (end - start) for block in log.blocks)
        if not 0 < k < len(log.blocks):
            return None
        has_changes = has_changes or max(log.links, default=-1) >= k - 1
        beginning = beginning.add(sweep(found.model, *_first(found, log, rolled, k)).gaussian)
    if has_changes:  # the rest's own samples have chosen them
        return 0.0
    proposed = [n for n in question.answer(beginning, found.values).named if n in named]
    whole, first = (_evidence(g, found, question, proposed) for g in (found.gaussian, beginning))
    return whole - first


def _first(
    found: Fit, log: LogState, rolled: Rolled, k: int
) -> tuple[LogState, Rolled, dict[str, NDArray[np.float64]]]:
    """Return the first k blocks of a log, their prediction, and the values at their end."""
    values, later = dict(found.values), np.sum(log.walks[k - 1 :], axis=0)
    for unknown in found.model.walking:
        step, later = np.split(later, [unknown.size])
        values[unknown.key(log.name)] = values[unknown.key(log.name)] - step
    return log.part(0, k), rolled.part(0, k), values


def _evidence(gaussian: Gaussian, found: Fit, question: Question, free: Sequence[str]) -> float:
    """Return the log evidence of some free candidates against none."""
    values = found.values
    x = np.concatenate([values[name] for name in gaussian.places])
    whole = gaussian.moved(-x).condition(question.given)
    others = {n: 0.0 for n in question.candidates if n not in free and n in whole.places}
    with_free = whole.condition(others)
    return (
        with_free.log_evidence - whole.condition(others | {name: 0.0 for name in free}).log_evidence
    )


def _declarations(everything: SensorSuite, effects: tuple[EffectEstimate, ...]) -> tuple[str, ...]:
    """Return what to add to the sensors' file; σ is plausible, and as large as each estimate."""
    sections: dict[str, dict[str, float]] = {}
    for effect in effects:
        section, _, kind = effect.name.rpartition(".")
        source = everything[section] if section in SENSORS else everything.disturbances
        assert source is not None
        field = next(each.name for each in fields(source) if each.name.startswith(kind))
        size = max(effect.prior_sigma, float(np.abs(effect.value).max()))
        if effect.unit == "%":  # the file has the share itself
            size /= 100
        sizes = sections.setdefault(section or "disturbances", {})
        sizes[field] = max(float(f"{size:.1e}"), sizes.get(field, 0.0))
    return tuple(
        f"{section}: {{{', '.join(f'{field}: {size:g}' for field, size in sizes.items())}}}"
        for section, sizes in sections.items()
    )
