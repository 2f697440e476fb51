"""The fit of all samples: log → model → fit → comparison → identification, for one log or many."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import Fit, about, prior_of
from cpid_drake.estimation.fit import fit as fit_logs
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import target_estimate
from cpid_drake.estimation.residuals import with_blocks
from cpid_drake.estimation.sweep import BOUNDARY, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.files.errors import prefix_errors
from cpid_drake.identification.answer import answer_of, target_only
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.changing_forces import with_changing_forces
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.exact_check import exact_checks
from cpid_drake.identification.log_sensors import model_of, open_model_of
from cpid_drake.identification.observed import Observed
from cpid_drake.identification.oscillation_check import oscillation_check
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import History, Identification
from cpid_drake.identification.together import with_sources
from cpid_drake.identification.torque_check import torque_check, torque_gains

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
    forced, gains, changing = with_changing_forces(fit, progress)
    model = forced.model

    # Changes of momentum: a link between two blocks opens where p(change | y) says so.
    question = Question.of(model, logs, arguments.momentum)
    changed = fit_with_events(forced, question, BoundedFits(progress=progress))
    torque = torque_check(gains if changed is forced else torque_gains(changed))

    # Comparison: of all sets of momenta L ≠ 0, the most probable; then h is linear about its x.
    progress("comparing")
    held = ChosenFit.of(changed, question).held
    fit = about(changed, held)  # weights and noise stay
    chosen = ChosenFit.of(fit, question)

    # Answer: p(ψ | y) with the doubts about this set, its checks, and the budget of its variance.
    sums = [with_blocks({}, log, rolled) for log, rolled in zip(fit.logs, fit.rolled, strict=True)]
    changes = [time for log in fit.logs for time in log.changes]
    observed = Observed.of(model, fit.logs, sums, changes)
    result = answer_of(chosen, observed, TRAJECTORY_FIT, arguments.spacecraft.joint_names)

    # What only all samples together tell: their halves, errors held exact, history, sources.
    opened = partial(open_model_of, arguments.spacecraft.tree, logs, arguments.known_bodies)
    result = replace(
        result,
        checks=(
            *result.checks,
            torque,
            *oscillation_check(fit),
            *chosen.part_checks(),
            *exact_checks(chosen, opened),
        ),
        warnings=(*warnings, *([changing] if changing else []), *result.warnings),
        history=partial(_over_time, chosen) if len(logs) == 1 else None,
    )
    if len(logs) == 1 and arguments.prior is None:
        return result
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
            alone = log.with_noise(processes=own.noise.processes)
            alone = replace(alone, slow_at_end=own.slow_at_end)
            weights, slow = zip(*((each.weights, each.slow) for each in own.states))
            alone = alone.with_each(weights=weights, slow=slow)
        swept = sweep(model, alone, rolled, values, forward_only=True)
        sources[log.name] = chosen.given(swept.gaussian)
    if prior is not None:
        sources[prior.name] = fit.model.rows[0].minus(values[PSI])
    return with_sources(
        result,
        chosen.given(prior_of(model, fit.logs, values)),
        sources,
        PSI,
        lambda gaussian: target_estimate(model, values[PSI], gaussian),
        counts,
        prior,
    )


def _over_time(chosen: ChosenFit) -> History:
    """Return times and estimates of one log, without checks: what earlier samples say."""
    [log], [rolled], values = chosen.fit.logs, chosen.fit.rolled, chosen.fit.values
    model, estimates = chosen.fit.model, []
    ends = range(len(log.blocks) - 1)[:: -(-len(log.blocks) // MOST_ESTIMATES)]
    stops = sweep(model, log, rolled, values, forward_only=True, stops=ends).stops
    prior = prior_of(model, [log], values)
    counts = np.cumsum([sum(map(len, block.samples.samples.values())) for block in log.blocks])
    for k in ends:
        target = stops[k].marginal(name for name in stops[k].places if name != BOUNDARY)
        target, count = chosen.given(target.add(prior)), int(counts[k])
        estimate = target_only(model, values, target, sample_count=count, estimator=TRAJECTORY_FIT)
        estimates.append((log.blocks[k].end, estimate))
    return estimates
