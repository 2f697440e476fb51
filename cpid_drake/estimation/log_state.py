"""A log cut into blocks, and the present values of what belongs to this log alone."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.joints import Smoothness, smooth_joints
from cpid_drake.estimation.likelihood.joint_motion import JointPart
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.unknowns import Model
from cpid_drake.logs.log import Log, Samples


@dataclass(frozen=True, eq=False)
class LogState:
    """A log, and the present values of the unknowns of its blocks.

    Attributes:
        name: of the log.
        blocks: successive blocks.
        joints: their joint motion.
        smoothness: of the joint motion.
        start: attitude, centre of mass and momentum at the start; None before the first fit.
        origin: time from which on the zeros of joints drift [s].
        forces: of each block: (K,) entries of white forces, in units of their σ.
        walks: of each block but a log's last: (w,) change at its end of the constants that walk.
        jumps: (12,) changes of attitude, centre of mass, L and v at the open ends of some blocks.
        aims: states at the start of some blocks, at which changes and white forces before them aim.
        weights: of each block: (M,) weights of a sensor's samples.
        noise: factors of the sensors' declared σ.

    """

    name: str
    blocks: tuple[Block, ...]
    joints: tuple[JointPart, ...]
    smoothness: Smoothness
    walks: tuple[NDArray[np.float64], ...]
    forces: tuple[NDArray[np.float64], ...]
    origin: float
    start: TrajectoryState | None = None
    jumps: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    aims: dict[int, TrajectoryState] = field(default_factory=dict)
    weights: tuple[dict[str, NDArray[np.float64]], ...] = ()
    noise: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of_blocks(
        cls,
        model: Model,
        blocks: Iterable[Block],
        name: str = "log",
        start: TrajectoryState | None = None,
    ) -> "LogState":
        """Return a log of successive blocks, with smoothed joints.

        Without a start it begins with the first block that has attitude samples.

        Raises:
            InputError: no block has attitude samples.

        """
        blocks = tuple(blocks)
        seen = (k for k, b in enumerate(blocks) if start or len(b.samples.attitude))
        first = next(seen, None)
        if first is None:
            raise InputError("no attitude samples while the joints are known: none to start from")
        blocks = blocks[first:]
        smoothness, joints = smooth_joints(blocks, model.suite)
        walks = tuple(np.zeros(len(model.walking_columns)) for _ in blocks[1:])
        forces = tuple(model.no_forces(block.start, block.end) for block in blocks)
        weights = tuple(dict[str, NDArray[np.float64]]() for _ in blocks)
        parts = tuple(joints)
        own = smoothness, walks, forces, blocks[0].start, start
        return cls(name, blocks, parts, *own, weights=weights)

    @classmethod
    def of(cls, model: Model, samples: Log | Iterable[Log], name: str = "log") -> "LogState":
        """Return a log of screened samples (or of chunks of them), cut into blocks.

        Raises:
            InputError: no block has attitude samples.

        """
        stream = [samples] if isinstance(samples, Log) else samples
        return cls.of_blocks(model, blocks_of(BlockQueue.of(model.suite), stream), name)

    def opened(self, ends: Iterable[int]) -> "LogState":
        """Return the log open at the ends of some blocks, and closed at all others."""
        jumps = {k: self.jumps.get(k, np.zeros(12)) for k in sorted(set(ends))}
        return replace(self, jumps=jumps)

    @property
    def changes(self) -> list[float]:
        """Times of changes [s]: of an open end, or the middle of a block of which both are open."""
        times, ends = list[float](), sorted(self.jumps, reverse=True)
        while ends:
            first = last = ends.pop()
            if ends and ends[-1] == first + 1:
                last = ends.pop()
            times.append(float(self.blocks[first].end + self.blocks[last].end) / 2)
        return times

    @property
    def thrust(self) -> Samples:
        """The log of thrust of all blocks."""
        parts = [block.samples.thrust for block in self.blocks]
        time, first = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
        return Samples(time, np.concatenate([part.value for part in parts])[first])

    @property
    def has_thrust(self) -> bool:
        """Whether thrusters fire."""
        return any(block.samples.has_thrust for block in self.blocks)

    def part(self, first: int, end: int) -> "LogState":
        """Return the blocks from `first` up to `end`, with what changes behind the last of them.

        Its start is that of the whole log.
        """
        lists = ("blocks", "joints", "forces", "walks", "weights")
        parts: dict[str, Any] = {name: getattr(self, name)[first:end] for name in lists}
        for name in ("jumps", "aims"):
            own = getattr(self, name).items()
            parts[name] = {k - first: each for k, each in own if first <= k < end}
        return replace(self, **parts)

    def weighted(self, k: int, sensor: str, rest: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return residuals (M, ...) of a sensor in block k, with weights and noise factor."""
        return np.asarray((rest.T * self.scale(k, sensor, len(rest))).T)

    def scale(self, k: int, sensor: str, count: int) -> NDArray[np.float64]:
        """Return the factors (M,) of a sensor's residuals in block k."""
        weights = self.weights[k].get(sensor, np.ones(count))
        return weights / self.noise.get(sensor, 1.0)
