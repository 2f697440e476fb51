"""Trajectory fit: maximum likelihood from all samples of all sensors of a log of any length.

The recursive fit goes through the log first. Then passes through the log solve the blocks again,
each about the target of the pass before, until the target remains: all blocks are then linearized
about the same target, as in a fit of the whole log at once. The time of a pass is proportional to
the length of the log, and the memory does not depend on it.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.block_state import BlockFit, BlockState
from cpid_drake.estimation.faults import explain
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.recursive_fit import LINEAR, RecursiveFit
from cpid_drake.estimation.recursive_state import RecursiveState, counted
from cpid_drake.estimation.window_minimum import psi_step, step_size
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.thinning import EvenSelection

MOST_PASSES = 6
"""Largest number of passes after the recursive fit."""

MOST_LOST = 0.5
"""Share of a log that is left out, above which no further pass is tried."""

STEP_TOLERANCE = 0.1
"""Change of the target by a pass, in units of σ, at which the passes end.

The result includes this change. Another pass would change it by less than 0.001 σ.
"""

MOST_RESIDUALS = 6_000
"""Number of residuals of one sensor that are kept."""


class Residuals:
    """What a fit leaves of the samples of each sensor, in memory that does not grow with the log.

    Attributes:
        selections: by sensor: an even selection of times [s] and residuals (M, d) in σ.

    """

    def __init__(self) -> None:
        self.selections: dict[str, EvenSelection] = {}
        self._beginnings: dict[str, list[NDArray[np.float64]]] = {}

    def add(self, fit: BlockFit) -> None:
        """Add a block."""
        for name, rest in fit.residuals.items():
            selection = self.selections.setdefault(name, EvenSelection(MOST_RESIDUALS))
            if selection.count < MOST_RESIDUALS:
                self._beginnings.setdefault(name, []).append(rest)
            selection.add(Samples(fit.times[name], rest))

    def beginning(self, name: str) -> NDArray[np.float64]:
        """Return the first residuals (M, d) of a sensor, all successive."""
        return np.concatenate(self._beginnings[name])


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """The target that fits a log best.

    Attributes:
        known: what is known at the end; None if nothing is, because the joints did not move.
        recursive: the state with the numbers of samples and of changes of momentum.
        residuals: of the base's sensors.
        converged: whether the last pass changed the target by much less than σ.

    """

    known: BlockState | None
    recursive: RecursiveState
    residuals: Residuals
    converged: bool


def fit_trajectory(estimator: RecursiveFit, stream: Iterable[Measurements]) -> TrajectoryFit:
    """Fit the target to all samples of a stream.

    Args:
        estimator: the recursive fit.
        stream: chunks of screened samples; it is read several times.

    Raises:
        InputError: too few samples, or nothing explains them.

    """
    state = estimator.run(stream)
    known, converged = state.known, False
    if known is None and state.window:
        return TrajectoryFit(None, state, Residuals(), converged=True)
    if known is None:
        raise InputError(
            "no attitude samples, or too few samples, while the joints move: none to start from"
        )
    # Passes converge where a likely window does not: they change ψ and the bodies' errors together.
    if not state.is_explained and state.sweep is not None and not state.sweep.is_likely:
        residuals = Residuals()
        for fit in state.sweep.fits:
            residuals.add(fit)
        size = step_size(known, psi_step(known, state.prior))
        return TrajectoryFit(known, state, residuals, converged=size < STEP_TOLERANCE)
    estimator = estimator.as_in(state)
    psi = known.nominal.psi + psi_step(known, state.prior)
    constants = known.best_constants(psi)
    estimator, psi = estimator.about(known, psi)
    for k in range(MOST_PASSES):
        residuals, misfit = Residuals(), state.expected_misfit
        known, state = pass_about(estimator, stream, psi, residuals, misfit, constants)
        step = psi_step(known, estimator.prior)
        found = known.best_constants(psi + step)
        is_linear = estimator.solver.constants.agree(constants, found)
        is_linear = is_linear and known.best_errors()[1] < LINEAR
        if is_linear and step_size(known, step) < STEP_TOLERANCE:
            converged = True
            break
        if k and state.bridged_share(known.time) > MOST_LOST:
            break
        constants = found
        estimator, psi = estimator.about(known, psi + step)
    return TrajectoryFit(known, state, residuals, converged)


def pass_about(
    estimator: RecursiveFit,
    stream: Iterable[Measurements],
    psi: NDArray[np.float64],
    residuals: Residuals,
    misfit: float = 1.0,
    constants: NDArray[np.float64] | None = None,
) -> tuple[BlockState, RecursiveState]:
    """Solve all blocks, linearized about one target.

    Args:
        estimator: the recursive fit.
        stream: chunks of screened samples.
        psi: (10,) relative unknowns of the target.
        residuals: the residuals of all blocks are added to it.
        misfit: expected χ² per degree of freedom.
        constants: constant errors about which the blocks are linearized, too; see `initial_state`.
            Default: from block to block about the best values so far.

    Returns:
        What is known at the end, and the counts.

    Raises:
        InputError: as `fit_trajectory`.

    """
    is_about = constants is not None
    solver = replace(estimator.solver, misfit=misfit, is_about_constants=is_about)
    prior = estimator.prior
    counts, known = replace(estimator.start(), expected_misfit=misfit), None
    for block in blocks_of(BlockQueue.of(solver.suite), stream):
        if known is None:
            try:
                known = initial_state(solver, prior, psi, block, constants)
            except InputError:  # the log begins without attitude
                continue
        found = explain(solver, prior, known, block)
        known, counts = found.state, counted(counts, block, found)
        for fit in found.fits:
            residuals.add(fit)
    if known is None:
        raise InputError("no attitude samples while the joints are known: none to start from")
    return known, counts
