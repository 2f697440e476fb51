"""The present values of the unknowns of one block of a log, and of the link to the next block."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.joint_model import JointPart
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.unknowns import Model


@dataclass(frozen=True, eq=False)
class Link:
    """What changes from the end of a block to the start of the next one.

    Attributes:
        gap: time between them [s]. Nothing is known of the joints in a gap, so that attitude,
            centre of mass, L and v begin anew behind it.
        walk: (w,) change of the constants that walk.
        pull: (12,) derivative of half χ² by the change of attitude, centre of mass, L and v, which
            is zero, if the end of the block is closed.
        is_open: whether these may change by any amount.
        span: σ of their change at an open end, as a share of `log_state.farthest`.
        push: σ (12,) of their change at a closed end by what acts unmodelled [rad, m, N·m·s, m/s];
            zero if nothing does.

    """

    gap: float
    walk: Array
    pull: Array
    is_open: bool = False
    span: float = 1.0
    push: Array | float = 0.0

    @classmethod
    def closed(cls, model: Model, gap: float = 0.0) -> "Link":
        """Return the link behind which a log goes on, before the first fit."""
        return cls(gap, np.zeros(len(model.walking_columns)), np.zeros(12))


@dataclass(frozen=True, eq=False)
class BlockState:
    """A block, and the present values of the unknowns that belong to it.

    Attributes:
        block: its samples.
        joints: the joint motion.
        forces: (K,) entries of white forces, in units of their σ.
        slow: (s,) slow noise of sensors at its start, in units of their declared σ.
        start: attitude, centre of mass and momentum at its start; None before the first fit.
        weights: (M,) weights of a sensor's samples, by sensor; without one, all weigh 1.
        link: to the block that follows; None of the last block of a log.

    """

    block: Block
    joints: JointPart
    forces: Array
    slow: Array
    start: TrajectoryState | None = None
    weights: Mapping[str, Array] = field(default_factory=dict)
    link: Link | None = None
