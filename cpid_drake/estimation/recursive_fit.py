"""Recursive fit: the likelihood solved online, block after block.

At first, sensor errors look like effects of the target. Therefore the first blocks are stored, and
all of them are fitted together at growing intervals (`window_fit`), until the target is known well
enough to linearize each block once. From then on, every block is solved when it is complete, and
only what is known at its end is kept. The state is a value: every function returns a new one.

If the spacecraft is not known exactly, the fits are linear about the best errors of its bodies:
after a turn, the effect of an error is far from proportional to it. The target then refers to the
mass of the known bodies with these errors, until `referred` changes that.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, BlockQueue
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.blocks import BlockSolver, with_bodies
from cpid_drake.estimation.faults import Explained, explain
from cpid_drake.estimation.likelihood.constants import NEAR_ZERO
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.recursive_state import NEXT_FIT, RecursiveState, counted
from cpid_drake.estimation.window_fit import WELL_KNOWN, fit_window, inertia_uncertainty
from cpid_drake.estimation.window_minimum import WindowFit
from cpid_drake.estimation.window_sweep import Work, WorkLimitError, explained_sweep
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.suite import SensorSuite

LONGEST_WINDOW = 60
"""Largest number of blocks that are fitted together."""

LINEAR = 1.0
"""Distance of the best errors of the known bodies from those about which a fit is linear, below
which it has converged; see `BlockState.best_errors`."""

_SEARCHED_BLOCKS = 4  # a longer first window is not searched for a change of momentum
_SETTLED_BLOCKS = 12  # of a window after which errors of the known bodies change little
_REST_BLOCKS = 5  # blocks that are kept while the joints do not move
_SUSPECT_BLOCKS = 10  # an unlikely window of more blocks loses its older half
_HOPELESS = 20.0  # χ² per degree of freedom that no later block of a window can explain
_FEWEST_HOPELESS = 3  # blocks of a window that may be hopeless
_TRIES = 2  # hopeless windows after which longer ones with the same beginning are not fitted
_PATIENCE = 2  # beginnings that may be given up before blocks pass without a fit
_MOST_IDLE = 300  # blocks that pass without a fit after many hopeless windows
_MOST_FITS = 10  # of one window, with other priors and about other zeros of the joints
_MOST_LOST = 2  # of these fits in a row that are hopeless
_SHORTER = 0.9  # ratio of a step of the known bodies' errors to the one before
_FINER = 1  # sizes by which splines of the joints are finer for a large target
_REST = 1e-3  # motion of a joint that counts as rest [rad or m]


def referred(
    psi: NDArray[np.float64], solver: BlockSolver, other: BlockSolver
) -> NDArray[np.float64]:
    """Return ψ (10,) of the same target, relative to the mass of another solver's known bodies."""
    target = relative_parameterization(solver.tree.mass).to_parameters(psi)
    return relative_parameterization(other.tree.mass).from_parameters(target)


def _new_update(estimator: "RecursiveFit") -> "RecursiveFit":
    """Return the estimator for one update, whose work is counted from zero."""
    result = copy(estimator)
    result.work = Work(estimator.work.most)
    return result


class RecursiveFit:
    """The recursive estimator for one spacecraft and its sensors; it contains no state.

    Args:
        tree: the known spacecraft.
        suite: its sensors.
        prior: what is known before the first sample.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.
        most_work: largest number of block solutions in one call of `process` or `finish` by which
            the stored blocks are fitted together; None for no limit. A fit that would need more is
            given up, and counted; the estimate remains that of the fit before.

    """

    def __init__(
        self,
        tree: KinematicTree,
        suite: SensorSuite,
        prior: Prior,
        known_bodies: BodyUncertainty | None = None,
        most_work: int | None = None,
    ) -> None:
        self.work = Work(most_work)
        self.nominal = self.solver = BlockSolver(tree, suite, known_bodies)
        self.prior = prior

    def as_in(self, state: RecursiveState) -> "RecursiveFit":
        """Return the estimator with the prior's width and the joints' splines of a state."""
        result = copy(self)
        result.prior = self.prior.as_wide_as(state.prior)
        result.solver = self.solver_of(state)
        return result

    def about(
        self, known: BlockState, psi: NDArray[np.float64], share: float = 1.0
    ) -> tuple["RecursiveFit", NDArray[np.float64]]:
        """Return the estimator that is linear about the best errors of the known bodies, and its ψ.

        Args:
            known: what is known of the errors, and of a target with ψ.
            psi: (10,) relative unknowns, which refer to the mass of the present known bodies.
            share: share of the change of the errors that is made.

        """
        errors, _ = known.best_errors()
        if errors is None:
            return self, psi
        if self.solver.errors is not None:
            errors = share * errors + (1 - share) * self.solver.errors
        result = copy(self)
        result.solver = with_bodies(replace(self.nominal, finer=self.solver.finer), errors)
        return result, referred(psi, self.solver, result.solver)

    def start(self) -> RecursiveState:
        """Return the state before the first sample."""
        return RecursiveState(BlockQueue.of(self.solver.suite), self.prior)

    def process(
        self, state: RecursiveState, measurements: Measurements, until: float
    ) -> RecursiveState:
        """Return the state after more samples.

        Args:
            state: before.
            measurements: screened samples, later than those before.
            until: time up to which all samples have been given [s].

        """
        queue, blocks = state.queue.added(measurements, until)
        state = replace(state, queue=queue)
        update = _new_update(self)
        for block in blocks:
            state = update._take(state, block)
        return state

    def finish(self, state: RecursiveState) -> RecursiveState:
        """Return the state after the incomplete block; samples that follow begin another one."""
        update = _new_update(self)
        for block in state.queue.finished():
            queue = replace(state.queue, edge=block.end, waiting=None)
            state = update._take(replace(state, queue=queue), block)
        moved = bool(state.window) and has_moved(state.window, update.solver.suite)
        if state.initializing and moved and state.hopeless < _TRIES and state.has_grown:
            state = update._fit(state, is_last=True)
        if state.known is None and state.rough is not None:
            return replace(state, sweep=state.rough, is_explained=False)
        if state.known is None and state.window and moved:
            try:
                fit = fit_window(
                    update.solver_of(state),
                    state.prior,
                    state.window,
                    state.prior.psi,
                    plain=True,
                    work=update.work,
                )
            except (InputError, np.linalg.LinAlgError):
                return state
            except WorkLimitError:
                return replace(state, unfinished=state.unfinished + 1)
            state = replace(state, sweep=fit.sweep, is_explained=False)
        return state

    def run(self, chunks: Iterable[Measurements]) -> RecursiveState:
        """Return the state after all samples of successive chunks."""
        state = self.start()
        for chunk in chunks:
            state = self.process(state, chunk, chunk.last_time)
        return self.finish(state)

    def _take(self, state: RecursiveState, block: Block) -> RecursiveState:
        if state.block is not None:
            prior = state.prior
            solver = replace(self.solver_of(state), misfit=state.expected_misfit)
            found = explain(solver, prior, state.block, block, prior.plausible)
            return counted(replace(state, block=found.state), block, found)
        window = (*state.window, block)
        state = replace(state, rough=None)
        if state.idle or not has_moved(window, self.solver.suite):
            return replace(state, window=window[-_REST_BLOCKS:], idle=max(state.idle - 1, 0))
        state = replace(state, window=window)
        if state.hopeless >= _TRIES:
            return state if len(window) <= _SUSPECT_BLOCKS else self._restarted(state)
        if state.length < state.next_fit - 1e-6:
            return state
        return self._fit(state)

    def _fit(self, state: RecursiveState, *, is_last: bool = False) -> RecursiveState:
        """Fit the window, and decide whether blocks can be solved one after the other from now."""
        window = state.window
        state = replace(state, next_fit=state.length * NEXT_FIT)
        psi = state.prior.psi if state.sweep is None else state.sweep.state.nominal.psi
        first = state.explained if state.changed < 0 else min(state.explained, state.changed - 1)
        suspects = range(max(first, 0), len(window))  # the block before may be the right one
        if not state.explained:  # a search in all blocks is for a short window
            is_searched = len(window) <= _SEARCHED_BLOCKS and not state.hopeless
            suspects = range(len(window) if is_searched else 0)
        try:
            fit, state = self._suited(state, psi, suspects, is_last)
        except (InputError, np.linalg.LinAlgError):
            return self._without_first(state)
        except WorkLimitError:
            state = replace(state, unfinished=state.unfinished + 1)
            if len(window) <= LONGEST_WINDOW:
                return state
            half = window[len(window) // 2 :]
            return replace(state, window=half, next_fit=0.0, explained=0, changed=-1)
        sweep = fit.sweep
        if not fit.converged:
            is_hopeless = len(window) >= _FEWEST_HOPELESS and sweep.misfit > _HOPELESS
            hopeless = state.hopeless + 1 if is_hopeless else 0
            rough = sweep if fit.changed < 0 else None
            state = replace(
                state, sweep=None, rough=rough, explained=0, changed=-1, hopeless=hopeless
            )
            return state if len(window) <= _SUSPECT_BLOCKS else self._restarted(state)
        misfit = 1.0 if sweep.is_likely else sweep.misfit
        state = replace(state, sweep=sweep, explained=len(window), expected_misfit=misfit)
        state = replace(state, changed=fit.changed, hopeless=0, given_up=0)
        is_known = self._is_well_known(state, sweep.state)
        if not is_known and len(window) <= LONGEST_WINDOW:
            return state
        if sweep.bridged:
            at = sweep.state.nominal
            solver = self.solver_of(state)
            sweep = explained_sweep(solver, state.prior, window, at.psi, at.constants)
        whole = Explained(sweep.state, sweep.fits, sweep.bridged, sweep.left_out)
        block = self.solver_of(state).settled(sweep.state, state.prior.plausible)
        state = replace(state, block=block, window=(), sweep=None, is_explained=True)
        for one in window:
            state = counted(state, one, Explained(block))
        return counted(state, None, whole)

    def _is_well_known(self, state: RecursiveState, known: BlockState) -> bool:
        """Return whether later blocks change the target so little that they are linear about it.

        The known bodies' errors keep a target uncertain for ever. After some blocks their best
        values change little, too.
        """
        if known.track is None:  # the joints are lost after a block that is skipped
            return False
        if len(state.window) >= _SETTLED_BLOCKS:
            known = known.with_exact_bodies()
        return inertia_uncertainty(known, self.solver_of(state)) < WELL_KNOWN

    def _is_fitted_again(
        self, state: RecursiveState, fit: WindowFit, found: NDArray[np.float64]
    ) -> bool:
        """Return whether a longer window will be fitted about the constant errors of a likely fit.

        Args:
            state: with the present window.
            fit: its fit.
            found: (k,) the best constant errors, near those about which the fit is linear.

        """
        change = self.solver.constants.change_of_zeros(fit.sweep.about, found)
        is_good = fit.converged and fit.sweep.is_likely and change < NEAR_ZERO
        is_growing = is_good and len(state.window) < LONGEST_WINDOW
        return is_growing and not self._is_well_known(state, fit.sweep.state)

    def _suited(
        self,
        state: RecursiveState,
        psi: NDArray[np.float64],
        suspects: Sequence[int],
        is_last: bool,
    ) -> tuple[WindowFit, RecursiveState]:
        """Fit the window with a prior, splines and zeros of the joints that suit it.

        The vague prior is too narrow for a target that is much larger than the spacecraft. Such a
        target hardly moves. The base moves instead, and its gyro feels errors of the joints'
        splines that the encoders do not see. The model is linear in the joints' zeros, and in the
        errors of the known bodies; a fit whose best errors differ from those has not converged.
        Zeros that are near change it by a small part of its σ; if a longer window will be fitted,
        that fit uses them.
        """
        estimator = self.as_in(state)
        constants = self.solver.constants
        about = np.zeros(constants.size)
        if state.sweep is not None:
            about = state.sweep.state.best_constants(psi)
        again, lost, before = False, 0, np.inf
        for _ in range(_MOST_FITS):
            fit = fit_window(
                estimator.solver,
                state.prior,
                state.window,
                psi,
                changed=state.changed,
                suspects=suspects,
                constants=about,
                again=again,
                work=self.work,
            )
            psi, found = fit.psi, fit.sweep.state.best_constants(fit.psi)
            about, again = found, not state.prior.excludes(psi)
            _, distance = fit.sweep.state.best_errors()
            is_linear = distance < LINEAR
            if not again:
                state = replace(state, prior=state.prior.covering(psi), finer=_FINER)
                estimator.solver = replace(estimator.solver, finer=_FINER)
            elif is_linear and (
                constants.agree(fit.sweep.about, found)
                or (not is_last and self._is_fitted_again(state, fit, found))
            ):
                break
            is_lost = again and not fit.converged and fit.sweep.misfit > _HOPELESS
            lost = lost + 1 if is_lost else 0
            if lost >= _MOST_LOST:
                break
            if not is_linear:  # steps that do not become shorter go to and fro
                share = 1.0 if distance < _SHORTER * before else 0.5
                estimator, psi = estimator.about(fit.sweep.state, psi, share)
                before = distance
        return replace(fit, converged=fit.converged and is_linear), state

    def solver_of(self, state: RecursiveState) -> BlockSolver:
        """Return the solver with the joints' splines and the known bodies of a state."""
        known = state.known
        errors = None if known is None else known.errors
        return with_bodies(replace(self.nominal, finer=state.finer), errors)

    def _restarted(self, state: RecursiveState) -> RecursiveState:
        """Return a state with the later half of the window, before which momentum has changed."""
        prior = replace(state.prior, momentum=TotalMomentum.unknown(state.prior.momentum))
        half = state.window[len(state.window) // 2 :]
        state = replace(state, changes=state.changes + 1, change_time=half[0].start)
        if state.hopeless >= _TRIES:
            again = max(state.given_up - _PATIENCE, 0)
            idle = min(_SUSPECT_BLOCKS * (2**again - 1), _MOST_IDLE)
            state = replace(state, hopeless=0, given_up=state.given_up + 1, idle=idle)
        return replace(state, window=half, prior=prior, next_fit=0.0, explained=0, changed=-1)

    def _without_first(self, state: RecursiveState) -> RecursiveState:
        """Return a state without the first block, which has too few samples to start from."""
        return replace(state, window=state.window[1:], next_fit=0.0)


def has_moved(window: tuple[Block, ...], suite: SensorSuite) -> bool:
    """Return whether a joint has moved at a rate that was not constant."""
    encoders = [block.samples.encoders for block in window]
    times = np.concatenate([samples.time for samples in encoders])
    values = np.concatenate([samples.value for samples in encoders])
    if len(times) < 3:
        return False
    share = ((times - times[0]) / (times[-1] - times[0]))[:, None]
    chord = values[0] + share * (values[-1] - values[0])
    noise = float(suite.sigmas("encoders")[0])
    return bool(
        np.median(np.sort(np.abs(values - chord), axis=0)[-5:], axis=0).max() > _REST + 20 * noise
    )
