"""The fit online: the fit of the last blocks, and a Gaussian of what is behind them.

Every block is added to a window of blocks, which `fit` and `fit_with_events` solve as they solve a
whole log. What leaves the window is marginalized, linear about its values then: see `Past`. A fit
of a whole log is one with a window that never ends. A block about which no fit is found is a gap.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.elimination import linked
from cpid_drake.estimation.events import fit_with_events, is_explained, most_changes
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.following import ahead_of, followed, joined
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.linearity import is_linear, linear_at
from cpid_drake.estimation.links import farthest
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.residuals import ResidualSums, with_blocks
from cpid_drake.estimation.roll import Rolled, first_table, linearize
from cpid_drake.estimation.start import state_of
from cpid_drake.estimation.sweep import known_at_start, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.unknowns_prior import prior_of
from cpid_drake.estimation.white_torque import NO_GAINS, gains_of_change
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log

NAME = "online"
"""Name of the log of an online fit."""

WINDOW = 4
"""Default length of the window, in blocks."""

LONGEST = 8
"""As many blocks stay while a fit is not linear about the target of the one before."""

MOST_LINEARIZATIONS = 300
"""Default of the most linearizations of blocks for one more block.

Half of them are enough for most blocks in which something changes."""

MOST_SWEEPS = 8
"""Most sweeps of a window with one more block: more do not help if something changed."""


@dataclass(frozen=True, eq=False)
class OnlineState:
    """The state of the online fit.

    Attributes:
        window: number of blocks that are solved anew with every new one; infinite for all.
        question: what is compared with changes of the momentum; see `fit_with_events`.
        most: the most linearizations of blocks for one more; if it needs more, it is not used.
        waiting: blocks that no fit explains yet.
        last: the fit of the last blocks; None before the first.
        earlier: those of blocks before them in the window; see `following`.
        ahead: what is known ahead of them; None if one more is solved together with the window.
        settled: times at which the momentum changed [s], before the window.
        sums: over the samples of every sensor, before the window.
        unsettled: number of blocks that left the window when its fit had not converged.
        refused: number of blocks that no fit explains, and that are not used.
        torque_gains: (n,) by how much −2 log(evidence) falls with each of `intensities`, by the
            changes that are no more in question.

    """

    window: float = WINDOW
    question: Question = field(default_factory=Question)
    most: float = MOST_LINEARIZATIONS
    waiting: tuple[Block, ...] = ()
    last: Fit | None = None
    earlier: tuple[Fit, ...] = ()
    ahead: Past | None = None
    settled: tuple[float, ...] = ()
    sums: Mapping[str, ResidualSums] = field(default_factory=dict)
    unsettled: int = 0
    refused: int = 0
    torque_gains: Array = field(default_factory=lambda: NO_GAINS)

    @property
    def events(self) -> tuple[float, ...]:
        """Times at which the momentum changed [s]."""
        return (*self.settled, *(time for fit in self.fits for time in fit.logs[0].changes))

    @property
    def is_conserved(self) -> bool:
        """Whether the momentum changed no more often than is probable."""
        return len(self.settled) <= most_changes(1)

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The fits of the window."""
        return () if self.last is None else (*self.earlier, self.last)

    def all_sums(self) -> Mapping[str, ResidualSums]:
        """Return the sums over the samples of every sensor, those of the window included."""
        sums = self.sums
        for each in self.fits:
            sums = with_blocks(sums, each.logs[0], each.rolled[0])
        return sums


def step(model: Model, state: OnlineState, block: Block) -> OnlineState:
    """Return the state after one more block.

    The work is bounded: a fit of the window, and four where the momentum changed, which have
    `OnlineState.most` linearizations together.

    Args:
        model: the unknowns.
        state: before the block.
        block: the samples that follow.

    """
    blocks = (*state.waiting, block)
    if len(blocks) == 1 and (more := _one_more(state, block)):
        return more
    fits = BoundedFits(np.inf if np.isinf(state.window) else state.most)
    try:
        solved = _fitted(model, state, blocks, fits)
        if state.is_conserved:
            solved = fit_with_events(solved, state.question, fits)
    except (InputError, np.linalg.LinAlgError):
        solved = None
    if solved is None or not (solved.converged or is_explained(solved)):
        return _without_fit(state, blocks)
    ahead = ahead_of(solved, solved.ends[0]) if solved.converged else None
    solved, before = replace(solved, swept=[], ends=[]), state.last
    state = replace(state, waiting=(), last=solved, earlier=(), ahead=ahead)
    longest = max(LONGEST, state.window)
    if before is not None and is_linear(solved, before.values[PSI]):
        longest = state.window
    while count := _leaving(state, longest):
        state = _marginalized(state, count)
    return state


def _one_more(state: OnlineState, block: Block) -> OnlineState | None:
    """Return the state after one more block, solved alone; None if the window has to be solved."""
    if state.ahead is None or np.isinf(state.window) or not len(block.samples.attitude):
        return None
    log = joined(state.fits)
    if log.past is None or block.start > log.blocks[-1].end:
        return None
    before = state.fits, state.ahead, block, state.question
    more = followed(*before, is_conserved=state.is_conserved)
    if more is None:
        return None
    (*fits, solved), ahead, gains = more
    last = fits[-1]
    fits[-1] = replace(last, rolled=[replace(each, jacobians={}, rows={}) for each in last.rolled])
    usual = max(each.length for each in log.blocks)
    while fits and (block.end - fits[0].logs[0].blocks[-1].end) / usual > state.window - 1e-3:
        gone = fits.pop(0)
        [log], [rolled] = gone.logs, gone.rolled
        sums, settled = with_blocks(state.sums, log, rolled), (*state.settled, *log.changes)
        state = replace(state, sums=sums, settled=settled)
    solved = replace(solved, swept=[], ends=[])
    gains = state.torque_gains + gains
    return replace(state, last=solved, earlier=tuple(fits), ahead=ahead, torque_gains=gains)


def run(model: Model, stream: Iterable[Log], state: OnlineState | None = None) -> OnlineState:
    """Return the state after all samples of successive chunks.

    Args:
        model: the unknowns.
        stream: screened samples.
        state: before them; default: nothing is known.

    """
    state = state or OnlineState()
    for block in blocks_of(BlockQueue.of(model.suite), stream):
        state = step(model, state, block)
    return state


def _fitted(model: Model, state: OnlineState, blocks: Sequence[Block], fits: BoundedFits) -> Fit:
    """Return the fit of the blocks of the window and of one more."""
    if state.last is None:
        return fits.fit(model, [LogState.of_blocks(model, blocks, NAME)])
    log = joined(state.fits).extended(model, blocks[-1], _start(state.last, blocks[-1]))
    before = None if state.earlier else state.last.rolled[0]
    if not state.is_conserved:
        log = log.opened(range(len(log.blocks) - 1))
    return fits.fit(model, [log], values=state.last.values, before=before, most=MOST_SWEEPS)


def _start(last: Fit, block: Block) -> TrajectoryState:
    """Return the state at the start of one more block: where the last one ends, if it is known."""
    model, [log], [rolled] = last.model, last.logs, last.rolled
    if block.start > log.blocks[-1].end and len(block.samples.attitude):
        alone = LogState.of_blocks(model, [block], NAME)
        return state_of(model, alone, last.values[PSI])
    return rolled.models[-1].motion.end(rolled.trajectories[-1])


def _without_fit(state: OnlineState, blocks: Sequence[Block]) -> OnlineState:
    """Return the state after blocks that no fit explains.

    Before the first fit, the last ones wait for more samples.
    """
    waiting = tuple(blocks[1 - LONGEST :]) if state.last is None else ()
    left_out = blocks[: len(blocks) - len(waiting)]
    sums = dict(state.sums)
    for block in left_out:
        for name, samples in block.samples.items():
            before = sums.get(name, ResidualSums())
            sums[name] = replace(before, rejected=before.rejected + len(samples))
    refused = state.refused + len(left_out)
    return replace(state, sums=sums, refused=refused, waiting=waiting)


def _leaving(state: OnlineState, longest: float) -> int:
    """Return how many blocks leave the window: two together, if one change opened both ends."""
    assert state.last is not None
    [log] = state.last.logs
    count = 2 if {0, 1} <= log.open else 1
    usual = max(block.length for block in log.blocks)
    left = (log.blocks[-1].end - log.blocks[min(count, len(log.blocks)) - 1].end) / usual
    return count if left >= longest - 1e-3 else 0


def _marginalized(state: OnlineState, count: int) -> OnlineState:
    """Return the state without the first blocks, linear about their values."""
    assert state.last is not None
    last, [log], [rolled] = state.last, state.last.logs, state.last.rolled
    model, values = last.model, last.values
    gone, rest = log.part(0, count), log.part(count, len(log.blocks))
    linearize(model.of_log(log.name), log, rolled, values)
    before, linear = known_at_start(model, log, values), rolled.part(0, count)
    gaussian = sweep(model, gone, linear, values, before=before, forward_only=True).end
    past = Past(
        replace(gaussian, rho2=0.0),
        rest.starts[0],
        rest.states[0].joints.coefficients[:ORDER],
        first_table(model, rest, values),
        linear_at(last),
        log.noise.slow_places,
        rest.states[0].slow,
    )
    kept = rolled.part(count, len(log.blocks))
    gains = _torque_gains(last, gone, gaussian, rest, kept)
    derived = {part: own for part, own in kept.jacobians.items() if part in kept.models}
    kept = replace(kept, jacobians=derived)
    return replace(
        state,
        sums=with_blocks(state.sums, gone, rolled),
        settled=(*state.settled, *gone.changes),
        last=replace(last, logs=[replace(rest, past=past)], rolled=[kept]),
        unsettled=state.unsettled + (0 if last.converged else count),
        torque_gains=state.torque_gains + gains,
    )


def _torque_gains(
    last: Fit, gone: LogState, gaussian: Gaussian, rest: LogState, rolled: Rolled
) -> Array:
    """Return the `gains_of_change` of that at the end of blocks that leave the window.

    Args:
        last: the fit of the window.
        gone: the blocks that leave it.
        gaussian: what is known at their end.
        rest: the others.
        rolled: their prediction.

    """
    if gone.links[-1].is_open or gone.links[-1].gap:
        return NO_GAINS
    model, values, name = last.model, last.values, gone.change(len(gone.blocks) - 1)
    before = linked(gaussian, name, farthest(model), np.zeros(12))
    total = sweep(model, rest, rolled, values, before=before, forward_only=True).gaussian
    total = total.add(prior_of(model, [rest], values))
    return gains_of_change(model, total.marginal([name]), name, gone.blocks[-1].length)
