"""The present values of the unknowns of one block of a log."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.joint_model import JointPart
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.links import Link


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
