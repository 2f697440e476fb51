"""The fit online, block after block, as an estimator and as an identification at any time."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.evidence import Question, without_contradicted
from cpid_drake.estimation.fit import prior_of
from cpid_drake.estimation.online import OnlineState, change_beyond_linear, run
from cpid_drake.estimation.online_block import NAME as LOG
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
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
    momentum_of,
)
from cpid_drake.identification.result import Identification

NAME = "recursive_fit"
"""The estimator's name."""

NOT_STARTED = (
    "the target was not known well enough before the end to solve the blocks one after the other; "
    "the result is a fit of all samples together"
)
"""The warning if all blocks were fitted together."""

NOT_LINEAR = (
    "the inertia changed by {:.1g} % since the blocks are solved one after the other: they are not "
    "linear about the target; use the trajectory fit"
)
"""The failed check if the first blocks were linearized about another target."""


def identification_of_state(
    model: Model, state: OnlineState, momentum: TotalMomentum | None
) -> Identification:
    """Return what is known after the last block.

    Args:
        model: the unknowns.
        state: after the last block.
        momentum: the total momentum at the start; None for zero if the samples agree with this,
            else unknown. It is unknown after a change before the target was known.

    """
    known, is_wrong, change = state.known, False, 0.0
    assumed = TotalMomentum.unknown() if state.is_free else momentum or TotalMomentum.zero()
    if known is None:
        values, noise = model.start([LOG]), {}
        gaussian = prior_of(model, [], values)
    else:
        values, noise, gaussian = known.values, known.log.noise, known.unknowns(model)
        change = change_beyond_linear(model, known, gaussian)
        given = np.concatenate([assumed.L_WScm_W, assumed.v_WScm_W])
        question = Question({}, {} if assumed.is_unknown else {f"{MOMENTUM}|{LOG}": given})
        is_wrong = without_contradicted(gaussian, values, question, model).given != question.given
        if not is_wrong:
            gaussian = at_momentum(gaussian, values, assumed, LOG)
        elif momentum is None:
            assumed = TotalMomentum.unknown()
    said, failed = momentum_words(float(is_wrong), is_given=momentum is not None)
    effects = effects_of(model, values, gaussian, LOG)
    tests = {name: sums.whiteness for name, sums in state.lags.items()}
    unexplained = state.bridged / state.length if state.length else 0.0
    used = {name: state.used.get(name, 0) for name in model.suite.present()}
    return Identification.of_solution(
        relative_parameterization(model.mass),
        known_target(model, values[PSI], gaussian),
        sensors=model.suite,
        sample_count=sum(used.values()),
        estimator=NAME,
        rejected={name: count for name, count in state.rejected.items() if count},
        momentum_changes=tuple(sorted(state.events)),
        warnings=(*noise_warnings(noise), *change_warnings(state.events), *said),
        checks=(
            *failed,
            *((Check("linearity", NOT_LINEAR.format(100 * change)),) if change else ()),
            *size_checks(model, values, gaussian, effects),
            *fit_checks(known is None or known.converged, unexplained, noise, tests),
            *rejection_checks(state.rejected, used),
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
    if len(logs) > 1 or known.prior is not None:
        raise InputError(f"{NAME} identifies from one log without a prior; use the trajectory fit")
    [log] = logs.values()
    suite, warnings = suite_of(known.sensors, log)
    model = Model(known.spacecraft.tree, suite, known.known_bodies)
    progress("fitting")
    state = run(model, log.measurements.blocks())
    found = identification_of_state(model, state, known.momentum)
    if state.window:
        warnings = (*warnings, NOT_STARTED)
    return replace(found, warnings=(*warnings, *found.warnings))
