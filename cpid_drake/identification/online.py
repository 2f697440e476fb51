"""The fit online, block after block, as an estimator and as an identification at any time."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import prior_of
from cpid_drake.estimation.online import NAME as LOG
from cpid_drake.estimation.online import OnlineState, change_beyond_linear, run
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.budget import size_checks
from cpid_drake.identification.checked_log import CheckedLog, Known, suite_of
from cpid_drake.identification.checks import (
    Check,
    fit_checks,
    momentum_words,
    noise_warnings,
    rejection_checks,
)
from cpid_drake.identification.fitted import (
    at_momentum,
    change_warnings,
    effects_of,
    gap_warnings,
    momentum_of,
)
from cpid_drake.identification.result import Identification

NAME = "recursive_fit"
"""The estimator's name."""

NOT_LINEAR = (
    "the inertia changed by {:.1g} % since the blocks are solved one after the other: they are not "
    "linear about the target; use the trajectory fit"
)
"""The failed check if the first blocks were linearized about another target."""


def question_of(model: Model, momentum: TotalMomentum | None) -> Question:
    """Return what is compared online: changes, and whether the momentum is as given, or zero."""
    return Question.of(model, [LOG], momentum)


def identification_of_state(
    model: Model, state: OnlineState, momentum: TotalMomentum | None
) -> Identification:
    """Return what is known after the last block.

    Args:
        model: the unknowns.
        state: after the last block.
        momentum: the total momentum at the start; None for zero if the samples agree with this,
            else unknown.

    """
    found, is_wrong, change = state.found, False, 0.0
    assumed, warnings = momentum or TotalMomentum.zero(), tuple[str, ...]()
    noise = dict[str, float]()
    if found is None:
        values = model.start([LOG])
        gaussian = prior_of(model, [], values)
    else:
        values, gaussian, noise = found.values, found.gaussian, found.logs[0].noise
        change, warnings = change_beyond_linear(found), gap_warnings(found.logs[0])
        question = question_of(model, assumed)
        is_wrong = question.without_contradicted(gaussian, values, model).given != question.given
        if not is_wrong:
            gaussian = at_momentum(gaussian, values, assumed, LOG)
        elif momentum is None:
            assumed = TotalMomentum.unknown()
    said, failed = momentum_words(float(is_wrong), is_given=momentum is not None)
    effects = effects_of(model, values, gaussian, LOG)
    everything = state.observed()
    tests = {name: sums.whiteness for name, sums in everything.lags.items()}
    used = {name: everything.used.get(name, 0) for name in model.suite.present()}
    far = everything.rejected
    unexplained = max(far.get(name, 0) / max(far.get(name, 0) + n, 1) for name, n in used.items())
    return Identification.of_solution(
        relative_parameterization(model.mass),
        known_target(model, values[PSI], gaussian),
        sensors=model.suite,
        sample_count=sum(used.values()),
        estimator=NAME,
        rejected={name: count for name, count in everything.rejected.items() if count},
        momentum_changes=tuple(sorted(state.events)),
        warnings=(*warnings, *noise_warnings(noise), *change_warnings(state.events), *said),
        checks=(
            *failed,
            *((Check("linearity", NOT_LINEAR.format(100 * change)),) if change else ()),
            *size_checks(model, values, gaussian, effects),
            *fit_checks(found is None or found.converged, unexplained, noise, tests),
            *rejection_checks(everything.rejected, used),
        ),
        momentum=assumed.name,
        noise=noise,
        effects=effects,
        **momentum_of(model, values, gaussian, LOG),
    )


def estimate(
    known: Known,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Run the fit online over all samples, in order of time.

    See `estimators.Estimator`.
    """
    if len(logs) > 1:
        raise InputError(f"{NAME} identifies from one log; use the trajectory fit")
    [log] = logs.values()
    suite, warnings = suite_of(known.sensors, log)
    model = Model(known.spacecraft.tree, suite, known.known_bodies)
    if known.prior is not None:
        model = replace(model, rows=(known.prior.of_psi(model),))
    progress("fitting")
    state = OnlineState(question=question_of(model, known.momentum))
    state = run(model, log.measurements.blocks(), state)
    found = identification_of_state(model, state, known.momentum)
    return replace(found, warnings=(*warnings, *found.warnings))
