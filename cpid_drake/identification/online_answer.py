"""The fit online, block after block, as an estimator and as an identification at any time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import prior_of
from cpid_drake.estimation.following import joined
from cpid_drake.estimation.linearity import change_beyond_linear
from cpid_drake.estimation.online import NAME as LOG
from cpid_drake.estimation.online import OnlineState, run
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.residuals import near_residuals
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.files.errors import InputError
from cpid_drake.identification.answer import answer_of
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.checks import CONVERGENCE, Check, Observed
from cpid_drake.identification.log_sensors import model_of
from cpid_drake.identification.result import Identification

RECURSIVE_FIT = "recursive_fit"
"""The estimator's name."""

NOT_LINEAR = (
    "the inertia changed by {:.1g} % since the blocks are solved one after the other: they are not "
    "linear about the target; use the trajectory fit"
)
"""The failed check if the first blocks were linearized about another target."""


REFUSED = "the samples of {} are not used: no fit explains them"
"""The warning about blocks that are left out."""

NO_FIT = "no fit of the {:.3g} s of samples so far explains them"
"""The failed check while no fit is found."""


def question_of(model: Model, momentum: TotalMomentum | None) -> Question:
    """Return what is asked online: whether the momentum is as given, or zero."""
    return Question.of(model, [LOG], momentum)


def identification_of_state(
    model: Model,
    state: OnlineState,
    momentum: TotalMomentum | None,
    joints: Sequence[str] | None = None,
) -> Identification:
    """Return the identification after the last block.

    Args:
        model: the unknowns.
        state: after the last block.
        momentum: see `identify.identify`.
        joints: names of the joints, for the error budget; default: no budget.

    """
    if state.last is None:
        values = model.start([LOG])
        nothing = known_target(model, values[PSI], prior_of(model, [], values))
        form, assumed = relative_parameterization(model.mass), momentum or TotalMomentum.zero()
        waiting = sum(block.length for block in state.waiting)
        failed = [Check(CONVERGENCE, NO_FIT.format(waiting))] if waiting else []
        return Identification.of_solution(
            form,
            nothing,
            sensors=model.suite,
            sample_count=0,
            estimator=RECURSIVE_FIT,
            momentum=assumed.name,
            momentum_changes=(),
            checks=tuple(failed),
        )
    everything = state.observed()
    tests = {name: sums.whiteness for name, sums in everything.lags.items()}
    used, far = everything.used, everything.rejected
    counts = {
        (LOG, n): (far.get(n, 0), far.get(n, 0) + used.get(n, 0)) for n in model.suite.present()
    }
    observed = Observed(tests, counts, tuple(sorted(state.events)))
    given, window = (state.question, momentum, observed), [joined(state.fits)]
    fit = replace(state.last, converged=state.last.converged and not state.unsettled)
    result, _ = answer_of(fit, *given, logs=window, joints=joints, estimator=RECURSIVE_FIT)
    [log], [rolled] = fit.logs, fit.rolled
    last = {name: near_residuals(log, rolled, name) for name in model.suite.present()}
    warnings, checks = list(result.warnings), list(result.checks)
    if state.refused:
        warnings.append(
            REFUSED.format("a block" if state.refused == 1 else f"{state.refused} blocks")
        )
    if change := change_beyond_linear(fit):
        checks.append(Check("linearity", NOT_LINEAR.format(100 * change)))
    return replace(
        result,
        residuals={name: each for name, each in last.items() if len(each)},
        warnings=tuple(warnings),
        checks=tuple(checks),
    )


def estimate(
    arguments: Arguments,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Run the fit online over all samples, in order of time.

    See `estimators.Estimator`.
    """
    if len(logs) > 1:
        raise InputError(f"{RECURSIVE_FIT} identifies from one log; use the trajectory fit")
    [log], craft = logs.values(), arguments.spacecraft
    model, warnings = model_of(craft.tree, logs, arguments.known_bodies)
    if arguments.prior is not None:
        model = replace(model, rows=(arguments.prior.of_psi(model),))
    progress("fitting")
    state = OnlineState(question=question_of(model, arguments.momentum))
    state = run(model, log.measurements.blocks(), state)
    result = identification_of_state(model, state, arguments.momentum, craft.joint_names)
    return replace(result, warnings=(*warnings, *result.warnings))
