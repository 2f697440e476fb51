"""The state of the online fit: a value; see `online`."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.online_block import Known
from cpid_drake.estimation.roll import Rolled
from cpid_drake.estimation.whiteness import LagSums


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
