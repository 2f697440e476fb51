"""The fit online, block after block, as an estimator and as an identification at any time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import prior_of
from cpid_drake.estimation.following import joined
from cpid_drake.estimation.linearity import change_beyond_linear
from cpid_drake.estimation.online import NAME as LOG
from cpid_drake.estimation.online import OnlineState, run
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.white_torque import gain_of
from cpid_drake.files.errors import InputError
from cpid_drake.identification.answer import answer_of, target_only
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.checks import CONVERGENCE, Check
from cpid_drake.identification.chosen_fit import ChosenFit, momentum_name
from cpid_drake.identification.log_sensors import model_of
from cpid_drake.identification.observed import Observed
from cpid_drake.identification.result import Identification
from cpid_drake.identification.torque_check import torque_check
from cpid_drake.identification.words import NO_FIT, NOT_LINEAR, blocks_refused

RECURSIVE_FIT = "recursive_fit"
"""The estimator's name."""


def question_of(model: Model, momentum: TotalMomentum | None) -> Question:
    """Return what is asked online: whether the momentum is as given, or zero."""
    return Question.of(model, [LOG], momentum)


def identification_of_state(
    model: Model, state: OnlineState, joints: Sequence[str] | None = None
) -> Identification:
    """Return the identification after the last block.

    Args:
        model: the unknowns.
        state: after the last block.
        joints: names of the joints, for the error budget; default: no budget.

    """
    if state.last is None:
        return _before_a_fit(model, state)
    fit = replace(state.last, converged=state.last.converged and not state.unsettled)
    observed = Observed.of(model, [joined(state.fits)], [state.all_sums()], state.events)
    result = answer_of(ChosenFit.of(fit, state.question), observed, RECURSIVE_FIT, joints)
    warnings = [blocks_refused(state.refused)] if state.refused else []
    change = change_beyond_linear(fit)
    checks = [Check("linearity", NOT_LINEAR.format(100 * change))] if change else []
    checks.append(torque_check({LOG: gain_of(state.torque_gains)}))
    return replace(result, warnings=(*result.warnings, *warnings), checks=(*result.checks, *checks))


def _before_a_fit(model: Model, state: OnlineState) -> Identification:
    """Return the identification from samples of which there is no fit yet."""
    values = model.start([LOG])
    waiting = sum(block.length for block in state.waiting)
    return target_only(
        model,
        values,
        prior_of(model, [], values),
        sample_count=0,
        estimator=RECURSIVE_FIT,
        momentum=momentum_name(state.question),
        momentum_changes=(),
        checks=(Check(CONVERGENCE, NO_FIT.format(waiting)),) if waiting else (),
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
    result = identification_of_state(model, state, craft.joint_names)
    return replace(result, warnings=(*warnings, *result.warnings))
