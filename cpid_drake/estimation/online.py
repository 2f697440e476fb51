"""The fit online: block after block, with a state that is a value.

At first, errors of the sensors look like effects of the target: the blocks are stored, and all of
them are fitted at doubling lengths. Once the inertia of the system is well known, or the stored
blocks are many, a block is linear about the target: from then on every block is swept once when it
is complete, and only what is known at its end is kept.

Attitude, centre of mass and momentum may change at the start of every block. This change remains an
unknown for `KEPT` blocks; see `online_block`. Where something changed, it may have changed inside
of a block: the blocks before and after are cut into parts and solved once more. A part that noise
does not explain is bridged by its joints alone.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.fit import Fit, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import tracked
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.log_state import LogState, farthest
from cpid_drake.estimation.online_block import NAME, Known, closed, compared, is_likely, solved
from cpid_drake.estimation.roll import Rolled
from cpid_drake.estimation.sweep import OPEN, boundary_size, changed, sweep
from cpid_drake.estimation.unknowns import BODIES, PSI, Model
from cpid_drake.estimation.weights import spread
from cpid_drake.estimation.whiteness import LagSums
from cpid_drake.logs.log import Log

WELL_KNOWN = 1e-3
"""Relative error of the system's inertia from which a block is linear about the target."""

LONGEST = 8
"""So many blocks are stored at most: then a target that is known at all is well enough known."""

KEPT = 4
"""A change at the start of a block remains an unknown until so many blocks have followed."""

OF_JOINTS = ("encoders", "joint_rates", "thrust")
"""What is used of a part of a block that noise does not explain."""


@dataclass(frozen=True, eq=False)
class OnlineState:
    """The state of the online fit.

    Attributes:
        window: stored blocks, until the target is well known.
        next_fit: number of blocks at which the window is fitted.
        known: what is known at the end of the last block that is fitted; None before the first.
        settled: times at which the momentum changed [s], of links that are no unknowns any more.
        used, rejected: number of samples, and of those that weigh less or not at all, by sensor.
        lags: sums over the residuals of every sensor and over products of neighbours.
        bridged: length of the pieces that nothing explains [s].
        length: of all blocks that are fitted [s].
        is_free: whether the momentum has changed before the first block that is fitted.
        recent: the last blocks, each with the state before it.

    """

    window: tuple[Block, ...] = ()
    next_fit: int = 0
    known: Known | None = None
    settled: tuple[float, ...] = ()
    used: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    lags: Mapping[str, LagSums] = field(default_factory=dict)
    bridged: float = 0.0
    length: float = 0.0
    is_free: bool = False
    recent: tuple["Recent", ...] = ()

    @property
    def events(self) -> tuple[float, ...]:
        """Times at which the momentum changed [s]."""
        links = () if self.known is None else self.known.links
        return (*self.settled, *(link.time for link in links if link.probability >= NAMED))

    def observed(self, log: LogState, rolled: Rolled) -> "OnlineState":
        """Return the state with the numbers of samples and the residuals of the blocks of a log."""
        used, rejected, lags = Counter(self.used), Counter(self.rejected), dict(self.lags)
        for block, weights in zip(log.blocks, log.weights, strict=True):
            for name, samples in block.samples.items():
                far = int(np.sum(weights.get(name, np.ones(1)) < 1))
                used[name] += len(samples) - far
                rejected[name] += far
        for name, rest in rolled.all_residuals().items():
            lags[name] = lags.get(name, LagSums()).added(rest)
        length = self.length + sum(block.length for block in log.blocks)
        return replace(self, used=used, rejected=rejected, lags=lags, length=length)


@dataclass(frozen=True, eq=False)
class Recent:
    """A block that is solved once more if something changed beside it.

    Attributes:
        before: the state before it.
        block: the block.
        is_cut: whether it is solved in two halves.

    """

    before: OnlineState
    block: Block
    is_cut: bool = False


def step(model: Model, state: OnlineState, block: Block) -> OnlineState:
    """Return the state after one more block.

    The work is bounded. While blocks are stored: at lengths of 1, 2, 4, … blocks a fit of at most
    `LONGEST` of them, of `fit.MOST_SWEEPS` sweeps. Then: one or two sweeps of the block; and once
    for every change, those of the last `KEPT` + 1 blocks, two of which are cut into parts.

    Args:
        model: the unknowns.
        state: before the block.
        block: the samples that follow.

    """
    if state.window or state.known is None:
        return _grown(model, replace(state, window=(*state.window, block)))
    try:
        return _continued(model, state, block)
    except (InputError, np.linalg.LinAlgError):  # no motion has these samples: they are a gap
        rejected = Counter(state.rejected) + Counter({n: len(s) for n, s in block.samples.items()})
        bridged, length = state.bridged + block.length, state.length + block.length
        return replace(state, rejected=rejected, bridged=bridged, length=length)


def _continued(model: Model, state: OnlineState, block: Block) -> OnlineState:
    """Return the state after one more block, from what is known before it."""
    recent = (*state.recent, Recent(replace(state, recent=()), block))[-KEPT - 1 :]
    after, is_explained = _after(model, recent[-1])
    cut = _beside_changes(recent, after)
    if not (is_explained or recent[-1].is_cut):
        cut = {*cut, len(recent) - 1}
    if cut:
        recent = tuple(replace(r, is_cut=r.is_cut or k in cut) for k, r in enumerate(recent))
        again, after = [], recent[min(cut)].before
        for each in recent[min(cut) :]:
            again.append(replace(each, before=after))
            after, _ = _after(model, again[-1])
        recent = (*recent[: min(cut)], *again)
    return replace(_settled(model, after, recent[-KEPT:][0].block.start), recent=recent)


def run(model: Model, stream: Iterable[Log]) -> OnlineState:
    """Return the state after all samples of successive chunks.

    Args:
        model: the unknowns.
        stream: screened samples.

    """
    state = OnlineState()
    for block in blocks_of(BlockQueue.of(model.suite), stream):
        state = step(model, state, block)
    return finish(model, state)


def finish(model: Model, state: OnlineState) -> OnlineState:
    """Return the state with all stored blocks fitted; blocks may follow.

    Args:
        model: the unknowns.
        state: after the last block.

    """
    window, known = state.window, state.known
    if not window or (known is not None and known.log.blocks[-1] is window[-1]):
        return state
    return _grown(model, replace(state, next_fit=0))


def _beside_changes(recent: Sequence[Recent], after: OnlineState) -> set[int]:
    """Return the whole blocks before and after those times at which something changed."""
    assert after.known is not None
    changes = [link.time for link in after.known.links if link.probability >= NAMED]
    return {
        k
        for k, each in enumerate(recent)
        if not each.is_cut and {each.block.start, each.block.end} & set(changes)
    }


def _grown(model: Model, state: OnlineState) -> OnlineState:
    """Return the state with a longer window, fitted if it is long enough.

    If something changed, the window begins anew after the block that follows the change; the
    momentum is unknown then. If the longest window does not determine the target, it goes on with
    its later half.
    """
    window = state.window
    is_full = len(window) >= LONGEST
    if len(window) < state.next_fit and not is_full:
        return state
    state = replace(state, next_fit=2 * len(window))
    later = replace(state, window=window[len(window) // 2 :]) if is_full else state
    try:
        found = fit(model, [LogState.of_blocks(model, window, NAME)])
        changes = _changes(model, found)
        error = _inertia_error(model, found.logs[0], found.gaussian, found.values[PSI])
        known = _begun(model, found)
    except (InputError, np.linalg.LinAlgError):
        return later
    if changes:
        return _restarted(state, changes)
    if not found.converged:
        return replace(later, known=known, is_free=is_full or state.is_free)
    is_stored = error > (KNOWN if is_full else WELL_KNOWN)
    state = replace(state, window=later.window if is_stored else (), known=known)
    state = replace(state, used={}, rejected={}, lags={}, length=0.0)
    return state.observed(found.logs[0], found.rolled[0])


def _restarted(state: OnlineState, changes: Sequence[int]) -> OnlineState:
    """Return the state with the blocks of the window after those beside the last change."""
    window = state.window
    first = [k for k in changes if k - 1 not in changes]  # one change can open several ends
    settled = (*state.settled, *(window[k].end for k in first))
    later = window[changes[-1] + 2 :]
    return replace(state, window=later, next_fit=0, settled=settled, known=None, is_free=True)


def _changes(model: Model, found: Fit) -> list[int]:
    """Return the blocks of a window at whose ends something changed.

    A change makes residuals that look like noise with a long memory; the noise here is that of most
    samples.
    """
    (log,), (rolled,) = found.logs, found.rolled
    ends = [k for k, gap in enumerate(log.gaps) if not gap]
    if not ends:
        return []
    noise = {n: max(1.0, spread(rest)) for n, rest in rolled.all_residuals().items()}
    quiet = replace(log, noise=noise).opened(ends)
    carried = sweep(model, quiet, rolled, found.values, carry=ends).gaussian
    total = prior_of(model, [quiet], found.values).add(carried)
    names = [name for name in total.places if name.startswith("link ")]
    acting = compared(model, total, names).probability
    return [k for k, name in zip(ends, names, strict=True) if acting[name] >= NAMED]


def _begun(model: Model, found: Fit) -> Known:
    """Return what a fit of the window knows at its end."""
    log, rolled = found.logs[0], found.rolled[0]
    end = sweep(model, log, rolled, found.values).end
    gaussian = end.add(prior_of(model, [log], found.values))
    track = np.zeros((model.joint_count, ORDER, ORDER + 1))
    for part in log.joints:
        track = tracked(track, part)[1]
    last = replace(
        log.part(len(log.blocks) - 1, len(log.blocks)),
        weights=({},),
        starts=(rolled.models[-1].motion.end(rolled.trajectories[-1]),),
    )
    about = {u.name: found.values[u.name] for u in model.table if u.scope != "log"}
    return Known(found.values, last, gaussian, (), track, about, converged=found.converged)


def _after(model: Model, each: Recent) -> tuple[OnlineState, bool]:
    """Return the state after a block, and whether noise explains all of it.

    A whole block that noise does not explain is not used; a part of a cut one is bridged by its
    joints alone.
    """
    state, parts, is_explained = _behind_gap(model, each), [each.block], True
    if each.is_cut and len(each.block.samples.encoders) > 1:
        parts = each.block.cut()
    for part in parts:
        known, found = state.known, None
        assert known is not None
        with suppress(InputError, np.linalg.LinAlgError):
            found = solved(model, known, part)
        is_good = found is not None and is_likely(*found[1:])
        if not (is_good or each.is_cut):
            return state, False
        if found is None or not is_good:
            joints = {name: part.samples[name] for name in OF_JOINTS}
            alone = replace(part, samples=replace(part.samples, samples=joints))
            others = {n: len(s) for n, s in part.samples.items() if n not in OF_JOINTS}
            state = replace(state, rejected=Counter(state.rejected) + Counter(others))
            found = solved(model, known, alone, is_linked=False)
            is_explained = False
            state = replace(state, bridged=state.bridged + part.length)
        after, log, rolled = found
        state = replace(state, known=after).observed(log, rolled)
    return state, is_explained


def _behind_gap(model: Model, each: Recent) -> OnlineState:
    """Return the state before a block; behind a gap, all that is at its start begins anew."""
    known, block = each.before.known, each.block
    assert known is not None
    gap = block.start - known.log.blocks[-1].end
    if not gap:
        return each.before
    n = boundary_size(model)
    columns = np.concatenate([np.arange(n), n + model.walking_columns])
    walk = np.sqrt(gap) * model.walking_sigma
    sigma = np.concatenate([farthest(model), np.full(n - 12, OPEN), walk])
    lost, _ = changed(known.gaussian, columns, sigma, np.zeros(len(sigma)))
    track = np.zeros_like(known.track)
    return replace(each.before, known=replace(known, gaussian=lost, track=track))


def _settled(model: Model, state: OnlineState, oldest: float) -> OnlineState:
    """Return the state in which old links are no unknowns."""
    known, settled = state.known, state.settled
    assert known is not None
    gone = [each for each in known.links if each.time < oldest]
    settled = (*settled, *(each.time for each in gone if each.probability >= NAMED))
    links = tuple(each for each in known.links if each not in gone)
    known = replace(known, gaussian=closed(model, known.gaussian, gone), links=links)
    return replace(state, known=known, settled=settled)


def change_beyond_linear(model: Model, known: Known, gaussian: Gaussian) -> float:
    """Return the relative change d of the system's inertia since the first block that is linear.

    It is 0 if its second-order effect d² is below the error of the inertia.

    Args:
        model: the unknowns.
        known: after the last block.
        gaussian: what it says of the unknowns, about its values.

    """
    log, psi = known.log, known.values[PSI]
    B = _by_inertia(model, log, psi)
    change = float(np.linalg.norm(B @ (psi - known.about[PSI])) / len(B) ** 0.25)
    return change if change**2 > _inertia_error(model, log, gaussian, psi) else 0.0


def _inertia_error(
    model: Model, log: LogState, gaussian: Gaussian, psi: NDArray[np.float64]
) -> float:
    """Return the relative error of the system's inertia about its centre of mass.

    It is the root mean square of Wᵀ δJ W, with J = W⁻ᵀW⁻¹, along the axes that can turn. Errors of
    the known bodies, which stay uncertain for ever, are not in it.
    """
    exact = {BODIES: 0.0} if BODIES in gaussian.places else {}
    covariance = gaussian.condition(exact).marginal([PSI]).covariance()
    B = _by_inertia(model, log, psi)
    return float(np.sqrt(np.trace(B @ covariance @ B.T) / np.sqrt(len(B))))


def _by_inertia(model: Model, log: LogState, psi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative (9, 10) of Wᵀ J W by ψ at the end of a log; (1, 10) on a table."""
    q = log.joints[-1].coefficients[-ORDER][None]
    dynamics = BodyDynamics.at(model.tree, q, np.zeros_like(q))
    J, none = dynamics.inertia(psi)[0], dynamics.inertia(np.zeros(10))[0]
    normal_B = model.tree.normal_B
    if normal_B is None:
        W = np.linalg.inv(np.linalg.cholesky(J)).T
    else:
        W = normal_B[:, None] / np.sqrt(normal_B @ J @ normal_B)
    by = [(W.T @ (dynamics.inertia(e)[0] - none) @ W).ravel() for e in np.eye(10)]
    return np.stack(by, axis=1)
