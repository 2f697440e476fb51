"""Whether the first samples of a stream contradict the units and axes in which they are read.

Positions are compared with rates, and both with the momentum. While they do not agree, blocks wait;
once there are enough, the comparison is that of a whole log. A stream that contradicts its units is
not solved: no fit explains it, and none would end soon.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cpid_drake.estimation.block import Block
from cpid_drake.files.errors import InputError
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import check_log
from cpid_drake.identification.log_conventions import with_conventions
from cpid_drake.logs.conventions import has_agreement
from cpid_drake.logs.log import THRUST, Log, Samples, concatenated

COMPARED = 3
"""So many blocks are compared."""


@dataclass(frozen=True, eq=False)
class FirstSamples:
    """The first samples of a stream.

    Attributes:
        blocks: the first blocks, until enough were compared.
        solved: how many of them need not wait.
        is_compared: whether enough were compared.
        contradiction: what they contradict, with the remedy; empty if nothing.

    """

    blocks: tuple[Block, ...] = ()
    solved: int = 0
    is_compared: bool = False
    contradiction: str = ""

    def with_block(
        self, block: Block, arguments: Arguments
    ) -> tuple["FirstSamples", Sequence[Block]]:
        """Return the first samples with those of one more block, and the blocks to solve now.

        Args:
            block: the next block.
            arguments: the spacecraft, the sensors and its bodies.

        """
        if self.is_compared:
            return self, []
        blocks = (*self.blocks, block)
        log, waiting = _together(blocks), blocks[self.solved :]
        if len(blocks) == COMPARED:
            contradiction = _contradiction(log, arguments)
            return FirstSamples(
                is_compared=True, contradiction=contradiction
            ), [] if contradiction else waiting
        if has_agreement(log, arguments.spacecraft.tree):
            return FirstSamples(blocks, len(blocks)), waiting
        return FirstSamples(blocks, self.solved), []

    @property
    def waiting(self) -> tuple[Block, ...]:
        """The blocks that wait."""
        return self.blocks[self.solved :]


def _together(blocks: Sequence[Block]) -> Log:
    """Return the samples of blocks; their logs of thrust overlap."""
    log = concatenated([each.samples for each in blocks])
    if THRUST not in log.samples:
        return log
    time, first = np.unique(log.thrust.time, return_index=True)
    return log.updated({THRUST: Samples(time, log.thrust.value[first])})


def _contradiction(log: Log, arguments: Arguments) -> str:
    """Return what a log contradicts, as `identify` says it; nothing if it cannot be compared."""
    with suppress(InputError):
        checked = check_log(arguments.spacecraft, log, arguments.sensors, arguments.planar)
        return "; ".join(with_conventions(checked, arguments).conventions.failures)
    return ""
