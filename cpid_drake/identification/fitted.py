"""The fit of all samples: log → model → fit → comparison → identification, for one log or many."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import Fit, about, prior_of
from cpid_drake.estimation.fit import fit as fit_logs
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.residuals import near_residuals
from cpid_drake.estimation.sweep import BOUNDARY, EXACT, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.files.errors import prefix_errors
from cpid_drake.identification.answer import answer_of, at_momentum
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.changing_forces import with_changing_forces
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.checks import Observed
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.exact_check import exact_checks
from cpid_drake.identification.log_sensors import model_of, open_model_of
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import History, Identification
from cpid_drake.identification.together import with_sources
from cpid_drake.identification.torque_check import torque_check, torque_gain
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.suite import SensorSuite

TRAJECTORY_FIT = "trajectory_fit"
"""The estimator's name."""

MOST_ESTIMATES = 50
"""Number of estimates over time of a log, at most."""


def estimate(
    arguments: Arguments,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Fit one target, and all that is not known besides, to all samples of some logs.

    See `estimators.Estimator`.
    """
    # Model: the unknowns x = (target ψ, bodies, sensors, …, each log's motion) and their priors.
    model, warnings = model_of(arguments.spacecraft.tree, logs, arguments.known_bodies)
    states = []
    for name, log in logs.items():
        with prefix_errors(log.label):
            states.append(LogState.of(model, log.measurements, name))

    # Fit: the x of the least χ² = Σ |y − h(x)|² / σ² over samples and priors.
    progress("fitting")
    fit = _fit(model, states, arguments.prior, progress)
    fit, changing = with_changing_forces(fit, progress)
    model = fit.model

    # Changes of momentum: a link between two blocks opens where p(change | y) says so.
    question = Question.of(model, logs, arguments.momentum)
    fit = fit_with_events(fit, question, BoundedFits(progress=progress))
    torque = torque_check(torque_gain(fit))

    # Comparison: of all sets of momenta L ≠ 0, the most probable; then h is linear about its x.
    progress("comparing")
    best = question.answer(fit.gaussian, fit.values).best
    fit = about(fit, question.held(fit.values, best))

    # Answer: p(ψ | y) averaged over these sets, its checks, and the budget of its variance.
    series, observed = _observed(fit)
    result, chosen = answer_of(
        fit,
        question,
        arguments.momentum,
        observed,
        joints=arguments.spacecraft.joint_names,
        estimator=TRAJECTORY_FIT,
    )
    opened = partial(open_model_of, arguments.spacecraft.tree, logs, arguments.known_bodies)
    result = replace(
        result,
        checks=(*result.checks, torque, *chosen.part_checks(), *exact_checks(chosen, opened)),
        warnings=(*warnings, *([changing] if changing else []), *result.warnings),
    )
    if len(logs) == 1:
        result = replace(result, residuals=series, history=partial(_over_time, chosen))
    if len(logs) == 1 and arguments.prior is None:
        return result

    # Sources: whether each log, and the prior, has the target ψ of all.
    return _separated(result, chosen, arguments.prior, observed.used)


def _fit(
    model: Model,
    logs: Sequence[LogState],
    prior: TargetPrior | None,
    progress: Callable[[str], object],
) -> Fit:
    """Return the fit; the prior's rows are linear about the target that logs and prior give."""
    if prior is None:
        return fit_logs(model, logs, progress=progress)
    first = fit_logs(replace(model, rows=(prior.of_psi(model),)), logs, progress=progress)
    rows = (prior.of_psi(model, first.values[PSI]),)
    model = replace(model, rows=rows)
    return fit_logs(model, first.logs, values=first.values, progress=progress)


def _separated(
    result: Identification, chosen: ChosenFit, prior: TargetPrior | None, counts: Mapping[str, int]
) -> Identification:
    """Return an identification with the test whether logs and prior have the same target."""
    fit, sources = chosen.fit, {}
    model, values = replace(fit.model, rows=()), fit.values
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        alone = log
        if len(fit.logs) > 1:  # a difference between logs must not look like noise
            [own] = fit_logs(model, [log], values=values).logs
            alone = replace(log, processes=own.processes, slow_at_end=own.slow_at_end)
            weights, slow = zip(*((each.weights, each.slow) for each in own.states))
            alone = alone.with_each(weights=weights, slow=slow)
        swept = sweep(model, alone, rolled, values, forward_only=True)
        sources[log.name] = chosen.given(swept.gaussian)
    if prior is not None:
        sources[prior.name] = fit.model.rows[0].moved(values[PSI])
    return with_sources(
        result,
        chosen.given(prior_of(model, fit.logs, values)),
        sources,
        PSI,
        lambda gaussian: known_target(model, values[PSI], gaussian),
        counts,
        prior,
    )


def _over_time(chosen: ChosenFit) -> History:
    """Return times and estimates of one log, without checks: what earlier samples say."""
    [log], [rolled], values = chosen.fit.logs, chosen.fit.rolled, chosen.fit.values
    model, estimates = chosen.fit.model, []
    ends = range(len(log.blocks) - 1)[:: -(-len(log.blocks) // MOST_ESTIMATES)]
    stops = sweep(model, log, rolled, values, forward_only=True, stops=ends).stops
    prior, form = prior_of(model, [log], values), relative_parameterization(model.mass)
    counts = np.cumsum([sum(map(len, block.samples.samples.values())) for block in log.blocks])
    for k in ends:
        target = stops[k].marginal(name for name in stops[k].places if name != BOUNDARY)
        target, count = chosen.given(target.add(prior)), int(counts[k])
        estimate = Identification.of_solution(
            form,
            known_target(model, values[PSI], target, count=count),
            sensors=model.suite,
            sample_count=count,
            estimator=TRAJECTORY_FIT,
        )
        estimates.append((log.blocks[k].end, estimate))
    return estimates


def _observed(fit: Fit) -> tuple[dict[str, Samples], Observed]:
    """Return residuals by sensor (of log), and what they tell."""
    series, white, counts = dict[str, Samples](), dict[str, Array](), {}
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        for name in fit.model.of_log(log.name).suite.present():
            key = name if len(fit.logs) == 1 else f"{name} of {log.name}"
            whites, far, count = [], 0, 0
            parts = zip(log.states, rolled.residuals, strict=True)
            for k, (state, rest) in enumerate(parts):
                samples = state.block.samples[name]
                near = state.weights.get(name, np.ones(len(samples))) == 1.0
                far, count = far + int(np.sum(~near)), count + len(samples)
                if name in rest:
                    whites.append(log.whitened(k, name, rest[name])[near])
            counts[log.name, name] = far, count
            if whites:
                series[key] = near_residuals(log, rolled, name)
                white[key] = np.concatenate(whites)
    tests = {name: whiteness(each) for name, each in white.items()}
    changes = tuple(sorted(time for log in fit.logs for time in log.changes))
    return series, Observed(tests, counts, changes)


def cramer_rao_bound(
    tree: KinematicTree,
    psi: Array,
    measurements: Iterable[Log] | Log,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
) -> Array:
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
    fit = fit_logs(replace(model, rows=(held,)), [log])
    [log], [rolled], values = fit.logs, fit.rolled, fit.values
    log = log.with_processes({})  # as declared
    log = log.with_each(weights=({} for _ in log.blocks))
    total = prior_of(model, [log], values).add(sweep(model, log, rolled, values).gaussian)
    target = at_momentum(total, values, momentum or TotalMomentum.zero(), log.name)
    target = target.moved(
        target.solve()
    )  # the vague prior prefers another target than the true one
    form, solution = relative_parameterization(model.mass), known_target(model, values[PSI], target)
    bound = Identification.of_solution(form, solution, sample_count=0, estimator=TRAJECTORY_FIT)
    J, P = (np.nan_to_num(x) for x in (form.jacobian(solution.estimate), solution.covariance))
    return np.where(np.isfinite(bound.covariance), J @ P @ J.T, np.nan)
