"""State of the recursive fit: a value; see `recursive_fit`."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.estimation.block import Block, BlockQueue
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.faults import Explained
from cpid_drake.estimation.likelihood.priors import Prior
from cpid_drake.estimation.whiteness import LagSums
from cpid_drake.estimation.window_sweep import Sweep

NEXT_FIT = 1.3
"""Ratio of the lengths of successive windows that are fitted."""

LARGEST_MISFIT = 1.1
"""χ² per degree of freedom above which the model misses the samples by more than noise."""


@dataclass(frozen=True, eq=False)
class RecursiveState:
    """The state of the estimator.

    Attributes:
        queue: samples of the block that is not complete.
        prior: what is known before the first stored block.
        window: stored blocks, while the target is fitted to all of them.
        explained: number of stored blocks that the latest fit explained.
        changed: number of the stored block in which the momentum has changed; −1 for none.
        next_fit: length of the window of the next fit [s].
        hopeless: number of successive windows that nothing explained by far. What does not explain
            some blocks does not explain them together with later ones either.
        given_up: number of successive beginnings of windows that were given up as hopeless.
        finer: see `BlockSolver.finer`.
        idle: number of blocks to come before the next fit.
        sweep: of the latest fit of a window; None before the first.
        rough: of a fit of the whole window that does not explain it; None without such a fit.
        block: what is known at the end of the last block; None while the window is fitted.
        is_explained: whether noise, outliers and changes of momentum explain the samples.
        expected_misfit: χ² per degree of freedom that is expected; see `BlockSolver.misfit`.
        changes: number of changes of momentum found, without those in the window.
        change_time: end of the latest of them [s]; NaN without one.
        bridged_time: length of all pieces that nothing explained [s].
        chi_squared, freedom: of the samples of the base's sensors.
        used, left_out: number of samples used and left out, by sensor.
        lags: sums over the residuals of each sensor, which tell whether these are white.
        first_edge: start of the first counted block [s]; NaN before it.
        has_thrust: whether thrusters have changed the momentum.
        unfinished: number of fits that were given up because they needed too much work; see
            `RecursiveFit`.

    """

    queue: BlockQueue
    prior: Prior
    window: tuple[Block, ...] = ()
    explained: int = 0
    changed: int = -1
    next_fit: float = 0.0
    hopeless: int = 0
    given_up: int = 0
    idle: int = 0
    finer: int = 0
    sweep: Sweep | None = None
    rough: Sweep | None = None
    block: BlockState | None = None
    is_explained: bool = True
    expected_misfit: float = 1.0
    changes: int = 0
    change_time: float = np.nan
    bridged_time: float = 0.0
    chi_squared: float = 0.0
    freedom: int = 0
    used: dict[str, int] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    lags: dict[str, LagSums] = field(default_factory=dict)
    first_edge: float = np.nan
    has_thrust: bool = False
    unfinished: int = 0

    @property
    def start(self) -> float:
        """Start of the first block that was used [s]; NaN before it."""
        return self.window[0].start if self.window else self.first_edge

    @property
    def initializing(self) -> bool:
        """Whether the target is still fitted to all samples so far."""
        return self.block is None

    @property
    def length(self) -> float:
        """Length of the window [s]."""
        return self.window[-1].end - self.window[0].start if self.window else 0.0

    @property
    def has_grown(self) -> bool:
        """Whether the window is longer than when it was fitted."""
        return self.length > self.next_fit / NEXT_FIT + 1e-6

    @property
    def processed(self) -> dict[str, int]:
        """Number of samples by sensor that the estimate is based on, those left out included."""
        fitted = self.sweep.state.time if self.sweep is not None else -np.inf
        counts = self.used
        for block in self.window:
            if block.end <= fitted:
                counts = _sum(counts, [(n, len(s)) for n, s in block.samples.items() if len(s)])
        return counts

    @property
    def all_left_out(self) -> dict[str, int]:
        """Number of samples left out so far, by sensor."""
        window = self.sweep.left_out if self.sweep is not None and self.window else ()
        return _sum(self.left_out, window)

    @property
    def all_changes(self) -> tuple[int, float]:
        """Number of changes of momentum found, and the end of the latest [s]; NaN without one."""
        pieces = self.sweep.bridged if self.sweep is not None and self.window else ()
        return self.changes + len(pieces), pieces[-1][1] if pieces else self.change_time

    @property
    def misfit(self) -> float:
        """χ² per degree of freedom, or 1 if that is not much larger than noise makes it."""
        chi_squared, freedom = self.chi_squared, self.freedom
        if self.initializing and self.sweep is not None:
            chi_squared = self.sweep.cost
            freedom = sum(fit.freedom for fit in self.sweep.fits)
        freedom = max(freedom, 1)
        limit = max(LARGEST_MISFIT, 1 + 5 * np.sqrt(2 / freedom))
        return chi_squared / freedom if chi_squared > limit * freedom else 1.0

    @property
    def known(self) -> BlockState | None:
        """What is known at the end of the last block that was used; None before the first."""
        return self.block or (None if self.sweep is None else self.sweep.state)

    def bridged_share(self, time: float) -> float:
        """Return the share of the log up to a time [s] that nothing explained."""
        return self.bridged_time / max(time - self.start, 1e-9) if self.bridged_time else 0.0


def counted(state: RecursiveState, block: Block | None, found: Explained) -> RecursiveState:
    """Return the state with the samples of a block and its faults counted."""
    changes, last, used, lost = state.changes, state.change_time, state.used, state.bridged_time
    for start, end in found.bridged:
        changes += not start <= last + 1e-6  # pieces that follow each other are one change
        last, lost = end, lost + end - start
    for _ in found.jumps:
        changes, last = changes + 1, found.state.time
    lags = dict(state.lags)
    for fit in found.fits:
        for name, rest in fit.residuals.items():
            lags[name] = lags.get(name, LagSums()).added(rest)
    first, has_thrust = state.first_edge, state.has_thrust
    if block is not None:
        first = block.start if np.isnan(first) else first
        used = _sum(used, [(n, len(s)) for n, s in block.samples.items() if len(s)])
        has_thrust = has_thrust or block.samples.has_thrust
    left_out = _sum(state.left_out, found.left_out)
    return replace(
        state,
        changes=changes,
        change_time=last,
        bridged_time=lost,
        chi_squared=state.chi_squared + sum(fit.chi_squared for fit in found.fits),
        freedom=state.freedom + sum(fit.freedom for fit in found.fits),
        used=used,
        left_out=left_out,
        lags=lags,
        first_edge=first,
        has_thrust=has_thrust,
    )


def _sum(counts: dict[str, int], more: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Return the counts after adding more of them."""
    total = dict(counts)
    for name, count in more:
        total[name] = total.get(name, 0) + count
    return total
