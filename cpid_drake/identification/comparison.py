"""Which errors act that nobody has declared: candidates, their comparison, and what follows.

Every constant error of a sensor that has no declared σ is a candidate, and so are steady forces and
the momentum of a log. A fit with all of them free is compared with itself without each of them
(`estimation.evidence`): the target is the average. The same comparison of the first two thirds of
every log proposes errors, and the last third judges them: what chose a model cannot confirm it.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.digits import significant
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.evidence import NAMED, SIZES, Comparison, Question
from cpid_drake.estimation.fit import Fit, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import OF_THRUST, ConstantError, constant_errors
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import BODIES, PSI, Model
from cpid_drake.identification.checks import IMPROBABLE, Check, halves_check
from cpid_drake.identification.effects import LEARNED, EffectEstimate
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import SENSORS, Gyro
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import Thrusters

PLAUSIBLE = {
    "delay_ms": 30.0,
    "mounting_arcsec": 360.0,
    "scale_ppm": 1000.0,
    "misalignment_arcsec": 200.0,
    "lever_arm_mm": 30.0,
    "zero_mrad": 2.0,
    "drift_mrad_per_s": 0.02,
    "acceleration": 1e-3,
    "torque": 1e-2,
    "wheel": 1e-2,
    "thrust_scale": 0.1,
}
"""σ of each kind of error that is looked for, in the units of its field in a sensors' file: of a
sensor's errors; of an acceleration, a torque, the angular momentum of a wheel in the base that
nobody knows of, and the scale of logged thrust."""

PLAUSIBLE_BODIES = BodyUncertainty(mass=0.01, com=0.005, inertia=0.01)
"""The same of the bodies of a spacecraft whose uncertainty nobody declares."""

BODIES_ACT = (
    "the samples show that the spacecraft's bodies are not as in its model; the intervals include "
    "errors of 1 % of mass and inertia and of 5 mm of each centre of mass: say what is known of "
    "them with --known-bodies mass=0.01,com=0.005,inertia=0.01"
)
"""The warning if errors of the bodies explain a log better than those of sensors."""

THRUST_DELAY = 100.0
"""The same of the delay of thrusters [ms]: small valves open that late."""

COMMON_SHARE = 0.05
"""The same of the error that the forces of all valves share: a regulator holds its pressure so."""

UNDECLARED = "undeclared errors"
"""Name of the check that errors which nobody declares predict the end of the logs."""

FITTED = 2 / 3
"""Share of a log that proposes errors; the rest judges them."""


def with_thrust_errors(
    suite: SensorSuite, tree: KinematicTree
) -> tuple[SensorSuite, tuple[str, ...]]:
    """Return a suite in which thrusters err, and a warning if none of their errors is declared.

    No force is exact: its noise in a second is assumed as large as its constant error.

    Args:
        suite: the sensors.
        tree: the known bodies; the target is taken to be as heavy.

    """
    if suite.thrusters is None:
        return suite, ()
    forces, valves, said = suite.disturbances or Disturbances(), suite.thrusters.valves, []
    share = PLAUSIBLE["thrust_scale"]
    if not any(error.kind in OF_THRUST for error in constant_errors(suite, 0)):
        erring = {n: replace(v, force_sigma=share * v.force) for n, v in valves.items()}
        suite = replace(suite, thrusters=Thrusters(erring, THRUST_DELAY, share, COMMON_SHARE))
        shared = f"loss: {share:g}, common_force: {COMMON_SHARE:g}"
        said.append(f"thrusters: {{delay_ms: {THRUST_DELAY:g}, {shared}}}")
        said.append(f"of each valve a force_sigma of {share:.0%} of its force")
    if not (forces.acceleration_noise or forces.torque_noise):
        known, force = tree.at_rest, share * np.mean([v.force for v in valves.values()])
        radius = np.sqrt(np.trace(known.I_BBcm) / 2 / known.mass)
        a, t = (float(f"{x:.1e}") for x in (force / known.mass / 2, force * radius))
        suite = replace(suite, disturbances=replace(forces, acceleration_noise=a, torque_noise=t))
        said.append(f"disturbances: {{acceleration_noise: {a:g}, torque_noise: {t:g}}}")
    if not said:
        return suite, ()
    text = "the sensors' file does not declare how the forces err; these errors are assumed: "
    return suite, (text + "; ".join(said),)


def undeclared_floor(model: Model) -> tuple[str, ...]:
    """Return the warning about the noise of a floor that a suite takes for zero."""
    forces = model.suite.disturbances or Disturbances()
    if model.tree.normal_B is None or forces.acceleration_noise or forces.torque_noise:
        return ()
    text = "the disturbances of the sensors' file have neither acceleration_noise nor torque_noise"
    return (f"{text}: what a floor causes looks like noise",)


def with_plausible(
    sensors: SensorSuite, *, has_thrust: bool = False, joints_move: bool = True
) -> SensorSuite:
    """Return sensors in which every constant error has a plausible σ, if it had none.

    Args:
        sensors: the sensors.
        has_thrust: whether thrusters fired, whose log may have an error of its scale.
        joints_move: whether encoders have anything to measure.

    """
    result, forces = copy(sensors), sensors.disturbances or Disturbances()
    no_delay = {"attitude"} if sensors.thrusters and sensors.thrusters.delay_ms else set()
    if forces.torque_noise:  # a torque in every sample of a gyro takes what its delay does
        no_delay |= {name for name, each in sensors.present().items() if isinstance(each, Gyro)}
    for name, errors in sensors.present().items():
        own = _undeclared(errors)
        if name == "joint_rates" or (name == "encoders" and not joints_move):
            own = {}  # they have no errors of their own, or none that anything shows
        if name in no_delay:  # all sensors late is the thrust early: attitude is the clock
            own.pop("delay_ms", None)
        setattr(result, name, replace(errors, **own))
    own = _undeclared(forces)
    if not has_thrust or sensors.thrusters is not None:  # valves have their own errors
        own.pop("thrust_scale", None)
    result.disturbances = replace(forces, **own)
    return result


def _undeclared(errors: Any) -> dict[str, Any]:
    """Return a plausible σ of each error of a sensor or of forces that has no σ."""
    names = [each.name for each in fields(errors)]
    return {n: sigma for n, sigma in PLAUSIBLE.items() if n in names and not getattr(errors, n)}


def with_bodies(
    found: Fit,
    question: Question,
    progress: Callable[[str], object] = lambda step: None,
) -> Fit | None:
    """Return a fit in which the bodies are uncertain, if their errors explain the samples better.

    It is made only if the samples show an error that nobody declares. As for these, the first two
    thirds of the logs must show errors of the bodies, and the rest must confirm them.
    """
    errors = set(found.model.constants.errors)
    named = question.answer(found.gaussian, found.values).named
    if not errors & {name.partition("|")[0] for name in named}:
        return None
    model = replace(found.model, known_bodies=PLAUSIBLE_BODIES)
    start = model.start([log.name for log in found.logs])
    other = fit(model, found.logs, values=start | found.values, progress=progress)
    candidates = question.candidates | {BODIES: model.unknown(BODIES).sigma}
    asked = replace(question, candidates=candidates)
    if BODIES not in asked.answer(other.gaussian, other.values).named:
        return None
    gain = _held_out(other, asked, [BODIES])
    return None if gain is not None and gain <= 0 else other


def undeclared_errors(
    found: Fit, question: Question, compared: Comparison
) -> tuple[tuple[EffectEstimate, ...], tuple[str, ...], tuple[Check, ...]]:
    """Return the errors that act although nobody has declared them, warnings and checks.

    Args:
        found: a fit with all candidates free.
        question: what is compared.
        compared: the comparison by all samples.

    """
    errors = {
        unknown.key(log.name): found.model.constants.errors[unknown.name]
        for unknown in found.model.table
        if unknown.name in found.model.constants.errors
        for log in found.logs
        if unknown.key(log.name) in question.candidates
    }
    is_one = len(found.logs) == 1
    named = [name for name in compared.named if name in errors]
    effects = tuple(
        _effect(found.model.suite, errors[name], compared, name, is_one)
        for name in named
        if name in compared.values
    )
    warnings, checks = [], list[Check]()
    gain = _held_out(found, question, named) if effects else None
    text = "the samples show what the sensors do not declare: "
    text += "; ".join(effect.describe() for effect in effects)
    if effects and (gain is None or gain > 0):
        declared = "; ".join(dict.fromkeys(effect.declaration for effect in effects))
        warnings.append(f"{text}; the result includes it; add to the sensors' file: {declared}")
    if gain is not None:
        text += "; the cause is not known, because this does not predict the end of the log better"
        checks.append(Check.of(UNDECLARED, text, gain, 0.0, gain > 0))
    likely = [
        f"{_shown(name, is_one)} (probability {compared.probability[name]:.2g})"
        for name in errors
        if name not in named and compared.probability[name] > 1 - NAMED
    ]
    if likely:
        warnings.append(
            "the samples may show an error that the sensors do not declare: "
            f"{' or '.join(likely)}; the intervals include it"
        )
    return effects, tuple(warnings), tuple(checks)


def size_checks(
    model: Model, values: Values, gaussian: Gaussian, effects: Sequence[EffectEstimate]
) -> tuple[Check, ...]:
    """Return the check of errors that are too large for their declared or plausible σ.

    If the declared covariance 1 (in units of σ) is right, estimates with the covariance P have the
    covariance 1 − P. Combinations that the samples do not determine well, errors that walk, and
    what may fail are left out. An error that nobody declares may have the largest of the compared
    sizes.

    Args:
        model, values, gaussian: all unknowns, their values, and what is known about these values.
        effects: the constant errors, and those that act although nobody has declared them.

    """
    steady = {u.name for u in model.table if not (u.walk or u.may_fail)}
    steady &= {*model.constants.errors, BODIES}
    known = gaussian.marginal([n for n in gaussian.places if n.partition("|")[0] in steady])
    value = np.concatenate([np.empty(0), *(values[name] for name in known.places)])
    left, axes = np.linalg.eigh(known.covariance())
    parts = [(axes.T @ (value + known.solve()), left)]
    acting = [e for e in effects if e.declaration and e.name in steady]
    parts += [
        (e.value / e.prior_sigma / SIZES.max(), (e.sigma / e.prior_sigma) ** 2) for e in acting
    ]
    x, left = (np.concatenate(each) for each in zip(*parts, strict=True))
    seen = left < LEARNED**2
    freedom = int(seen.sum())
    if not freedom:
        return ()
    chi_squared = float(np.sum(x[seen] ** 2 / (1 - left[seen])))
    sentence = (
        "the errors of the sensors or the bodies, or the forces, are about "
        f"{significant(np.sqrt(chi_squared / freedom))} times as large as their declared sigma"
    )
    if effects:
        largest = max(effects, key=lambda each: float(np.abs(each.value).max()) / each.prior_sigma)
        declared = f"{significant(largest.prior_sigma, 3)} {largest.unit}"
        sentence += f", such as: {largest.describe()}, with a sigma of {declared}"
    sentence += "; declare what the hardware can have, or look for another cause"
    return (Check.of("declared sizes", sentence, chi_squared, float(chdtri(freedom, IMPROBABLE))),)


def _effect(
    suite: SensorSuite, error: ConstantError, compared: Comparison, name: str, is_one: bool
) -> EffectEstimate:
    """Return an error that acts; its declaration is plausible, and as large as the estimate."""
    value, sigma, log = compared.values[name], compared.sigma[name], name.partition("|")[2]
    found = EffectEstimate.of(error, value, sigma, log="" if is_one else log)
    source = suite[error.sensor] if error.sensor in SENSORS else suite.disturbances
    assert source is not None
    field = next(each.name for each in fields(source) if each.name.startswith(error.kind))
    size = max(found.prior_sigma, float(np.abs(found.value).max()))
    size = size / 100 if found.unit == "%" else size  # the file has the share itself
    text = f"{error.sensor or 'disturbances'}: {{{field}: {float(f'{size:.1e}'):g}}}"
    return replace(found, declaration=text)


def _shown(name: str, is_one: bool) -> str:
    """Return the name of an error of a log, for people."""
    error, _, log = name.partition("|")
    return f"{error} of {log}" if log and not is_one else error


def part_checks(found: Fit, question: Question, compared: Comparison) -> tuple[Check, ...]:
    """Return the check that the first halves of the logs have the target of the whole logs.

    What acts by the most probable set acts in both, and has the same values; before the samples it
    may be as large as by the comparison. All else is held: an average over sets is not nested.
    """
    acting, wide = [name for name in compared.best if name in question.candidates], found.model
    for name in acting:
        unknown = wide.unknown(name.partition("|")[0])
        sigma = max(1.0, compared.sizes[name]) * unknown.sigma
        wide = wide.with_prior(unknown.name, unknown.mean, sigma)
    found = replace(found, model=wide)
    beginning, whole = _beginning(found, 1 / 2), found.gaussian
    if beginning is None:
        return ()
    if acting:
        whole = prior_of(wide, found.logs, found.values)
        for log, rolled in zip(found.logs, found.rolled, strict=True):
            whole = whole.add(sweep(wide, log, rolled, found.values, forward_only=True).gaussian)
    held = held_by(found, question, compared)
    psi = found.values[PSI]
    first = known_target(found.model, psi, beginning.condition(held)).known
    whole = whole.condition(held).marginal([PSI]).moved(-psi)
    cause = "the grasp slips, or a joint, a clock or a force is not as modelled"
    return (halves_check(first, whole, cause),)


def held_by(found: Fit, question: Question, compared: Comparison) -> Values:
    """Return the unknowns that are held, with their values less those of the fit."""
    values = {n: np.zeros(1) for n in question.candidates if n not in compared.best}
    return {n: v - found.values[n] for n, v in (values | question.given).items()}


def _beginning(found: Fit, share: float) -> Gaussian | None:
    """Return what the first part of every log tells; None if a log is too short."""
    beginning = prior_of(found.model, found.logs, found.values)
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        start, end = log.blocks[0].start, log.blocks[-1].end
        k = sum(block.end <= start + share * (end - start) for block in log.blocks)
        if not 0 < k < len(log.blocks):
            return None
        swept = sweep(found.model, *_first(found, log, rolled, k), forward_only=True)
        beginning = beginning.add(swept.gaussian)
    return beginning


def _held_out(found: Fit, question: Question, named: Sequence[str]) -> float | None:
    """Return how well errors that the first part of every log proposes predict the rest."""
    beginning = _beginning(found, FITTED)
    if beginning is None:
        return None
    if any(log.open for log in found.logs):  # all samples have chosen these changes, with errors
        return 0.0
    proposed = [n for n in question.answer(beginning, found.values).named if n in named]
    whole, first = (_evidence(g, found, question, proposed) for g in (found.gaussian, beginning))
    return whole - first


def _first(
    found: Fit, log: LogState, rolled: Rolled, k: int
) -> tuple[LogState, Rolled, dict[str, NDArray[np.float64]]]:
    """Return the first k blocks of a log, their prediction, and the values at their end."""
    values, later = dict(found.values), np.sum(log.walks[k:], axis=0)
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
