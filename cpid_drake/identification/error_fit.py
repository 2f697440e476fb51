"""One target and the constant errors of the sensors, fitted to one or several logs together."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.effect_selection import EffectSelection, LogFit
from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.estimation.recursive_state import RecursiveState
from cpid_drake.estimation.trajectory_fit import MOST_LOST, Residuals, pass_about
from cpid_drake.identification.fit_setup import estimator_of
from cpid_drake.identification.problem import Problem

_MOST_PASSES = 4
_CLOSE = 0.1
"""Change of the target in units of σ at which the passes end."""


@dataclass(frozen=True, eq=False)
class LogPart:
    """A log, or a part of it, as an input of a fit.

    Attributes:
        problem: the problem, with the sensors whose errors are free.
        name: name of the log; empty for the only one.
        misfit: expected χ² per degree of freedom.

    """

    problem: Problem
    name: str = ""
    misfit: float = 1.0


@dataclass(frozen=True, eq=False)
class ErrorFit:
    """The fit of a target and of constant errors to all logs.

    Attributes:
        estimators: the recursive fit for each log.
        logs: the fits of the logs about the joint estimate.
        selection: the joint estimate, and what it says about fewer errors.
        psi: (10,) the target.
        constants: all errors in units of their σ; see `EffectSelection.unknowns`.
        lost: largest share of a log, or of a sensor's samples, that is left out because nothing
            explains it.

    """

    estimators: tuple[RecursiveFit, ...]
    logs: tuple[LogFit, ...]
    selection: EffectSelection
    psi: NDArray[np.float64]
    constants: NDArray[np.float64]
    lost: float = 0.0


def fit_errors(
    parts: Sequence[LogPart], psi: NDArray[np.float64], candidates: Iterable[str] = ()
) -> ErrorFit:
    """Fit one target and all errors that the sensors declare to some logs.

    Args:
        parts: the logs.
        psi: (10,) a target near the solution.
        candidates: names of errors that a selection may set to zero.

    Raises:
        InputError: a log has too few samples.
        numpy.linalg.LinAlgError: the samples contradict each other.

    """
    estimators = []
    for part in parts:
        assert part.problem.sensors is not None
        estimator = estimator_of(part.problem, part.problem.sensors)
        wide = replace(estimator.start(), prior=estimator.prior.covering(psi))
        estimators.append(estimator.as_in(wide))
    plausible = estimators[0].prior.plausible
    about = [np.zeros(estimator.solver.constants.size) for estimator in estimators]
    for k in range(_MOST_PASSES):
        fits, lost = [], 0.0
        for part, estimator, constants in zip(parts, estimators, about):
            stream, rest = part.problem.stream, Residuals()
            with np.errstate(over="ignore", invalid="ignore"):  # nothing may explain the samples
                known, state = pass_about(
                    estimator, stream, psi, rest, part.misfit, constants if k else None
                )
            if not np.isfinite(known.root).all():
                raise np.linalg.LinAlgError("nothing explains the samples")
            fits.append(LogFit(estimator.solver, known, state.misfit, part.name))
            lost = max(lost, _lost(known, state))
        selection = EffectSelection(fits, candidates)
        errors, better = selection.estimate_about(psi, plausible)
        of_logs = [selection.of_log(k, errors) for k in range(len(parts))]
        step = selection.target_rows.A @ (better - psi)
        psi, old, about = better, about, of_logs
        is_linear = all(
            estimator.solver.constants.agree(a, b)
            for estimator, a, b in zip(estimators, old, about)
        )
        if is_linear and np.linalg.norm(step) < _CLOSE:
            break
        if k and lost > MOST_LOST:  # the first pass is about errors of zero
            break
    return ErrorFit(tuple(estimators), tuple(fits), selection, psi, errors, lost)


def _lost(known: BlockState, state: RecursiveState) -> float:
    """Return the largest share of a log, or of a sensor's samples, that was left out."""
    shares = [state.bridged_share(known.time)]
    shares += [state.left_out.get(name, 0) / max(n, 1) for name, n in state.processed.items()]
    return max(shares)
