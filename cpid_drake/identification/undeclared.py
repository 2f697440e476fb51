"""Errors and forces that the sensors' file does not declare, but that the samples show.

All constant errors of a table with plausible sizes are estimated together with the target. The
smallest set of them that explains the samples is the proposal (`estimation.effect_selection`), if
it predicts samples better that were not used (`held_out`). An error that is not proposed may act
all the same: the intervals of a trusted answer include it with its probability.
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import vector_to_tensor
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.effect_selection import EffectSelection, Submodel, model_average
from cpid_drake.estimation.least_squares import LeastSquaresSolution, widened
from cpid_drake.estimation.likelihood.constants import OF_GRASP, Constants
from cpid_drake.estimation.trajectory_fit import MOST_LOST
from cpid_drake.identification.effects import EffectEstimate, UndeclaredErrors
from cpid_drake.identification.error_fit import LogPart, fit_errors
from cpid_drake.identification.held_out import held_out
from cpid_drake.identification.joint import IdentifiedLog
from cpid_drake.identification.result import Identification
from cpid_drake.identification.seen_noise import LARGER_NOISE, with_seen_noise
from cpid_drake.sensing.disturbances import Disturbances
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite

LEAST_GAIN = 7.0
"""Gain of the log marginal likelihood from which an error is proposed: odds of about 1000 to 1."""

SHIFT = 1.0
"""Change of the target, in units of σ, from which an undeclared error is a doubt."""

PLAUSIBLE = {
    "delay_ms": 30.0,
    "mounting_arcsec": 360.0,
    "scale_ppm": 1000.0,
    "misalignment_arcsec": 200.0,
    "lever_arm_mm": 30.0,
    "zero_mrad": 2.0,
}
"""σ of each kind of error of a sensor that is looked for, in the units of its field."""

ACCELERATION, TORQUE = 1e-3, 1e-2
"""σ of the acceleration [m/s²] and of the torque [N·m] that are looked for."""

ODDS = 0.01
"""Odds of each undeclared error before the first sample; at `LEAST_GAIN` they are 11 to 1."""

SUSPECTED = 0.05
"""Probability from which an undeclared error widens the intervals."""

NOT_LOOKED_FOR = "errors that the sensors do not declare were not looked for"
"""The beginning of the warning about a check that could not run."""

FLEXIBLE_GRASP = (
    "the grasp seems to be flexible, and its modes are too slow for an estimate of the compliance: "
    "make it stiffer, or move more slowly"
)
"""The doubt about a log that only a flexible grasp explains, in part."""

FEW = 2
"""Number of errors; more are a less likely cause than another target in one of several logs."""

_FAR = 1.5
"""Ratio of the gains from which one error explains much more than the others."""

WRIST = 5.0
"""Natural frequency of a target on a flexible grasp whose compliance is the plausible σ [Hz]."""

THRUST_SCALE = 0.1
"""σ of the error of the scale of logged thrust that is looked for."""


def undeclared_errors(
    logs: Sequence[IdentifiedLog], found: LeastSquaresSolution
) -> UndeclaredErrors | None:
    """Return the undeclared errors that logs of one target show; None if this cannot be said.

    Errors of the sensors are common to all logs; each log has external forces of its own. On a
    table, the combinations of the target's unknowns that do not act on the motion keep their prior.

    Args:
        logs: the logs, with their sensors and their own identifications by a fit.
        found: ψ from all logs; all that can act on the motion is determined.

    """
    psi = found.values
    plain = [_part(log) for log in logs]
    has_thrust = any(log.problem.log.has_thrust for log in logs)
    suites = [with_plausible(_sensors(part), psi, has_thrust=has_thrust) for part in plain]
    everything = [
        LogPart(replace(part.problem, sensors=suite), part.name)
        for part, suite in zip(plain, suites)
    ]
    joint_count = len(logs[0].problem.spacecraft.joint_names)
    declared = Constants.of(_sensors(plain[0]), joint_count).errors
    candidates = [n for n in Constants.of(suites[0], joint_count).errors if n not in declared]
    try:
        fit = fit_errors(everything, psi, candidates)
        selection = fit.selection
        nothing, best = selection.submodel(()), selection.best(LEAST_GAIN)
        alone = {name: selection.submodel([name]) for name in selection.candidates}
        others = [*alone.values(), *([best] if len(best.free) > 1 else [])]
        average = model_average(nothing, others, ODDS, SUSPECTED)
    except (InputError, ValueError, np.linalg.LinAlgError):
        return None
    change = best.psi - nothing.psi
    squared = float(change @ found.information @ change)
    effects = tuple(_estimates(selection, best))
    gains = {n: each.log_likelihood - nothing.log_likelihood for n, each in alone.items()}
    fields = _declarations(suites[0], effects)
    is_used, prediction = fit.lost <= MOST_LOST, None
    if effects and is_used:
        proposed = [
            replace(
                part,
                problem=replace(part.problem, sensors=_with_declared(_sensors(part), fields)),
                misfit=of_log.misfit,
            )
            for part, of_log in zip(plain, fit.logs)
        ]
        prediction = held_out(proposed, plain, (best.psi, psi))
    return UndeclaredErrors(
        effects,
        best.log_likelihood - nothing.log_likelihood,
        float(np.sqrt(max(squared, 0.0))),
        fields,
        is_used and all(of_log.misfit == 1.0 for of_log in fit.logs),
        tuple(sorted(gains.items(), key=lambda each: -each[1])),
        prediction,
        average,
    )


def with_undeclared(
    logs: Sequence[IdentifiedLog], found: Identification, solution: LeastSquaresSolution
) -> Identification:
    """Return an identification that mentions undeclared errors which its samples show.

    An error that changes the target is a doubt; it comes first if it explains the samples. An error
    that hardly changes the target is a warning. The intervals include errors that may act. If
    several logs need many errors, another target in one of them is a likelier cause, and is named
    before. Errors that do not predict the end of the log better are not proposed as the cause, but
    the samples contradict the sensors all the same.

    Args:
        logs: the logs with their own identifications; only the beginning of a long log is used.
        found: the identification from all logs, with its doubts. If there is one log whose samples
            contradict the given momentum, the log's own identification has an unknown one.
        solution: ψ of several logs together, or of the only one, in the frame C of the problems.

    """
    about = found if len(logs) > 1 else logs[0].found
    problems = [log.problem for log in logs]
    if any(
        problem.states is not None or problem.sensors is None or not log.record.estimates_errors
        for log, problem in zip(logs, problems)
    ):
        return found  # exact states, which may not be connected, or an estimator without errors
    undeclared, reason = None, ""
    if any(LARGER_NOISE in doubt for doubt in found.doubts):
        reason = LARGER_NOISE
    elif not about.is_complete:
        reason = "the samples do not determine all that can act on the motion"
    elif any(problem.known_bodies for problem in problems):
        reason = "the spacecraft is uncertain (--known-bodies)"
    else:
        undeclared = undeclared_errors(logs, solution)
        reason = "the fit with such errors fails"
    if undeclared is None:
        return replace(found, warnings=(*found.warnings, f"{NOT_LOOKED_FOR}, because {reason}"))
    found = replace(found, undeclared=undeclared)
    known = _named(logs, found, undeclared)
    is_same_frame = found.solution is solution  # else the log is that of an oblique table
    return known if known.doubts or not is_same_frame else _with_suspected(known, undeclared)


def _named(
    logs: Sequence[IdentifiedLog], found: Identification, undeclared: UndeclaredErrors
) -> Identification:
    """Return an identification with what there is to say about errors that explain the samples."""
    if not undeclared.effects:
        return found
    if undeclared.is_proposed:
        text = (
            f"the samples show what the sensors do not declare: {undeclared.describe()}; add it to "
            f"the file of the sensors ({'; '.join(undeclared.declaration)}), or to a copy of the "
            "preset's file, which `cpid list` shows"
        )
    else:
        text = (
            "the samples show what the sensors do not declare, and the cause is not known: "
            f"{undeclared.describe()}, which would explain them, does not predict the end of the "
            "log better"
        )
    if undeclared.shift < SHIFT and not found.doubts:
        return replace(found, warnings=(*found.warnings, f"{text}; it changes the target little"))
    if not undeclared.is_explained or not (undeclared.is_proposed or not found.doubts):
        if found.doubts and _shows_flexible_grasp(undeclared):
            return replace(found, doubts=(FLEXIBLE_GRASP, *found.doubts))
        return found  # other causes are more likely
    if len(logs) > 1 and len(undeclared.effects) > FEW:
        return replace(found, doubts=(*found.doubts, text))
    return replace(found, doubts=(text, *found.doubts))


def _with_suspected(found: Identification, undeclared: UndeclaredErrors) -> Identification:
    """Return an identification whose intervals include errors that may act."""
    average = undeclared.average
    if average is None or not average.probabilities:
        return found
    found = replace(found, solution=widened(found.solution, average.spread))
    named = [f"{name} (probability {share:.2g})" for name, share in undeclared.suspected.items()]
    if not named:
        return found
    text = (
        f"the samples may show an error that the sensors do not declare: {' or '.join(named)}; "
        "the intervals include it"
    )
    return replace(found, warnings=(*found.warnings, text))


def _shows_flexible_grasp(undeclared: UndeclaredErrors) -> bool:
    """Return whether a compliance alone explains much more of the samples than any other error."""
    (first, gain), *_ = undeclared.alone
    others = max(gain for name, gain in undeclared.alone if name not in OF_GRASP)
    return first in OF_GRASP and gain > max(LEAST_GAIN, _FAR * others)


def _part(log: IdentifiedLog) -> LogPart:
    """Return the beginning of a log, with the noise and the momentum that its samples show."""
    problem = log.problem
    if problem.log.is_long:
        problem = problem.with_measurements(problem.log.head)
    problem = with_seen_noise(problem).problem
    if log.found.momentum == "unknown":  # because the samples demand it
        problem = replace(problem, momentum=TotalMomentum.unknown(problem.momentum))
    return LogPart(problem, log.name, log.found.misfit**2)


def _sensors(part: LogPart) -> SensorSuite:
    assert part.problem.sensors is not None
    return part.problem.sensors


def with_plausible(
    sensors: SensorSuite, psi: NDArray[np.float64] | None = None, *, has_thrust: bool = False
) -> SensorSuite:
    """Return sensors in which every constant error has a plausible σ, if it had none.

    Args:
        sensors: the sensors.
        psi: (10,) relative unknowns of the target, which give the size of plausible compliances of
            the grasp; None for a rigid grasp.
        has_thrust: whether thrusters fired, whose log may have an error of its scale.

    """
    result = copy(sensors)
    for name, errors in sensors.present().items():
        own = {
            each.name: PLAUSIBLE[each.name]
            for each in fields(errors)
            if each.name in PLAUSIBLE and not getattr(errors, each.name)
        }
        if name == "joint_rates":  # they have no errors of their own
            own = {}
        setattr(result, name, replace(errors, **own))
    old = sensors.disturbances or Disturbances()
    masses = np.zeros(2) if psi is None else (np.diag(vector_to_tensor(psi[4:])).max(), psi[0])
    turn, shift = (1e6 / (m * (2 * np.pi * WRIST) ** 2) if m > 0 else 0.0 for m in masses)
    result.disturbances = replace(
        old,
        acceleration=old.acceleration or ACCELERATION,
        torque=old.torque or TORQUE,
        thrust_scale=old.thrust_scale or (THRUST_SCALE if has_thrust else 0.0),
        compliance_urad=old.compliance_urad or float(turn),
        translational_compliance_um=old.translational_compliance_um or float(shift),
    )
    return result


def _estimates(selection: EffectSelection, best: Submodel) -> Iterator[EffectEstimate]:
    """Yield the estimates of the free candidates, those that matter most first."""
    for name in best.free:
        unknown = selection.unknowns[name]
        error, place = unknown.error, unknown.place
        unit = error.sigma / error.scale
        value, sigma = unit * best.constants[place], unit * best.sigma[place]
        yield EffectEstimate(error.name, error.unit, value, sigma, unit, unknown.log)


def _declarations(
    everything: SensorSuite, effects: tuple[EffectEstimate, ...]
) -> tuple[tuple[str, str, float], ...]:
    """Return what to add to the sensors' file; σ is plausible, and as large as each estimate."""
    sizes: dict[tuple[str, str], float] = {}
    for effect in effects:
        section, _, kind = effect.name.rpartition(".")
        source = everything[section] if section in SENSORS else everything.disturbances
        assert source is not None
        field = next(each.name for each in fields(source) if each.name.startswith(kind))
        size = max(effect.prior_sigma, float(np.abs(effect.value).max()))
        if effect.unit == "%":  # the file has the share itself
            size /= 100
        place = section or "disturbances", field
        sizes[place] = max(float(f"{size:.1e}"), sizes.get(place, 0.0))
    return tuple((*place, size) for place, size in sizes.items())


def _with_declared(sensors: SensorSuite, declared: Iterable[tuple[str, str, float]]) -> SensorSuite:
    """Return sensors that declare some errors more, as `_declarations` returns them."""
    result = copy(sensors)
    for section, field, sigma in declared:
        source = getattr(result, section) or Disturbances()
        setattr(result, section, replace(source, **{field: sigma}))
    return result
