"""The fit of all samples: log → model → fit → comparison → identification, for one log or many."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import Fit, about, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.sweep import EXACT, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.files.errors import prefix_errors
from cpid_drake.identification.answer import Observed, answer_of, at_momentum
from cpid_drake.identification.checked_log import Arguments, CheckedLog, suites_of
from cpid_drake.identification.halves import part_checks
from cpid_drake.identification.model_sensitivity import base_sensitivity
from cpid_drake.identification.over_time import over_time
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.identification.together import with_sources
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.suite import SensorSuite

NAME = "trajectory_fit"
"""The estimator's name."""


def estimate(
    arguments: Arguments,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Fit one target, and all that is not known besides, to all samples of some logs.

    See `estimators.Estimator`.
    """
    suites, warnings = suites_of(logs)
    has_thrust = any(log.measurements.has_thrust for log in logs.values())
    tree, bodies = arguments.spacecraft.tree, arguments.known_bodies
    model = Model.of(tree, suites, bodies, has_thrust=has_thrust)
    where = {name: f"{name}: " if len(logs) > 1 else "" for name in logs}
    states = []
    for name, log in logs.items():
        with prefix_errors(where[name].removesuffix(": ")):
            states.append(LogState.of(model, log.measurements, name))
    progress("fitting")
    question = Question.of(model, logs, arguments.momentum)
    found = _fit(model, states, arguments.prior, progress)
    asked = question.without_contradicted(found.gaussian, found.values, model)
    found = fit_with_events(found, asked, progress)
    progress("comparing")
    asked = question.without_contradicted(found.gaussian, found.values, model)
    best = asked.answer(found.gaussian, found.values).best
    found = about(found, asked.held(found.values, best))
    series, observed = _observed(found)
    names = arguments.spacecraft.joint_names
    result, held = answer_of(
        found, question, arguments.momentum, observed, joints=names, estimator=NAME
    )
    result = replace(
        result,
        checks=(*result.checks, *part_checks(found, held)),
        residuals=series if len(logs) == 1 else {},
        warnings=(*warnings, *result.warnings),
    )
    if model.known_bodies is None and found.converged and result.solution is not None:
        result = replace(result, sensitivity=base_sensitivity(found, result.solution, held))
    if len(logs) == 1:
        result = replace(result, history=partial(over_time, found, held, NAME))
    if len(logs) == 1 and arguments.prior is None:
        return result
    return _separated(result, found, held, arguments.prior, observed.used)


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
            alone = replace(
                log, spectra=by_itself.spectra, noise=by_itself.noise, weights=by_itself.weights
            )
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


def _observed(found: Fit) -> tuple[dict[str, Samples], Observed]:
    """Return residuals by sensor (of log), and what they tell."""
    series, white, counts = dict[str, Samples](), dict[str, NDArray[np.float64]](), {}
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        for name in found.model.of_log(log.name).suite.present():
            key = name if len(found.logs) == 1 else f"{name} of {log.name}"
            times, values, whites, far, count = [np.empty(0)], [], [], 0, 0
            parts = zip(log.blocks, rolled.residuals, log.weights, strict=True)
            for k, (block, rest, weights) in enumerate(parts):
                samples = block.samples[name]
                near = weights.get(name, np.ones(len(samples))) == 1.0
                far, count = far + int(np.sum(~near)), count + len(samples)
                if name in rest:
                    times.append(samples.time[near])
                    values.append(rest[name][near])
                    whites.append(log.whitened(k, name, rest[name])[near])
            counts[log.name, name] = far, count
            if values:
                series[key] = Samples(np.concatenate(times), np.concatenate(values))
                white[key] = np.concatenate(whites)
    tests = {name: whiteness(each) for name, each in white.items()}
    changes = tuple(sorted(time for log in found.logs for time in log.changes))
    return series, Observed(tests, counts, changes)


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
        tree: the spacecraft's bodies.
        psi: (10,) relative unknowns of the target.
        measurements: ideal samples of the sensors.
        sensors: the sensors' errors.
        momentum: the total momentum, marked as unknown if it is to be estimated; default: zero.
        known_bodies: uncertainty of the spacecraft's bodies, which are estimated too.

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
    log = replace(log, noise={}, spectra={}, weights=tuple({} for _ in log.blocks))  # as declared
    total = prior_of(model, [log], values).add(sweep(model, log, rolled, values).gaussian)
    known = at_momentum(total, values, momentum or TotalMomentum.zero(), log.name)
    known = known.moved(known.solve())  # the vague prior prefers another target than the true one
    form, solution = relative_parameterization(model.mass), known_target(model, values[PSI], known)
    found = Identification.of_solution(form, solution, sample_count=0, estimator=NAME)
    J, P = (np.nan_to_num(x) for x in (form.jacobian(solution.estimate), solution.covariance))
    return np.where(np.isfinite(found.covariance), J @ P @ J.T, np.nan)
