"""A log cut into blocks, and the present values of what belongs to this log alone."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.joint_samples import Smoothness
from cpid_drake.estimation.joints import continued, smooth_joints
from cpid_drake.estimation.likelihood.joint_model import ORDER, JointPart
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.spectrum import WHITE, Spectra, Whitening
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import SENSORS

CLOSED = 1e-8
"""σ of a change at a closed end, as a share of 1 rad, 1 m, 1 m/s and a fast tumble's momentum."""

JUDGED = 1e-5
"""The same for the χ² by which a step is judged; see `LogState.link_cost`."""

FARTHEST = 0.5, 1.0, 1.0
"""σ of a change at an open end: of attitude [rad], centre of mass [m] and its velocity [m/s]."""


@dataclass(frozen=True, eq=False)
class LogState:
    """A log, and the present values of the unknowns of its blocks.

    Attributes:
        name: of the log.
        blocks: successive blocks.
        joints: their joint motion.
        smoothness: of the joint motion.
        starts: of each block: attitude, centre of mass and momentum at its start; none before the
            first fit.
        origin: time from which on zeros of joints and clocks drift [s].
        forces: of each block: (K,) entries of white forces, in units of their σ.
        walks: of each block but a log's last: (w,) change at its end of the constants that walk.
        open: blocks at whose ends attitude, centre of mass, L and v may change by any amount.
        gaps: of each block but a log's last: time until the next one begins [s]. Nothing is known
            of the joints in a gap, so that attitude, centre of mass, L and v begin anew behind it.
        pulls: of each block but a log's last: (12,) derivative of half χ² by the change at its end,
            which is zero, if the end is closed.
        weights: of each block: (M,) weights of a sensor's samples.
        spectra: of each sensor's noise.
        shown: of each block: what it shows of the noise, see `block_noise`; none before it is
            known.
        noise: factors of its σ: what the model leaves beside noise.
        freedom: degrees of freedom of one residual that is not far off, by sensor; none before the
            noise is known.
        past: what is known before the first block; None if it is the first of all.

    """

    name: str
    blocks: tuple[Block, ...]
    joints: tuple[JointPart, ...]
    smoothness: Smoothness
    walks: tuple[Array, ...]
    forces: tuple[Array, ...]
    origin: float
    starts: tuple[TrajectoryState, ...] = ()
    open: frozenset[int] = frozenset()
    gaps: tuple[float, ...] = ()
    pulls: tuple[Array, ...] = ()
    weights: tuple[dict[str, Array], ...] = ()
    spectra: Spectra = field(default_factory=dict)
    shown: tuple[Spectra, ...] = ()
    noise: dict[str, float] = field(default_factory=dict)
    freedom: dict[str, float] = field(default_factory=dict)
    past: Past | None = None

    @classmethod
    def of_blocks(
        cls,
        model: Model,
        blocks: Iterable[Block],
        name: str = "log",
        starts: tuple[TrajectoryState, ...] = (),
        past: Past | None = None,
    ) -> "LogState":
        """Return a log of successive blocks, with smoothed joints.

        Without starts and a past it begins with the first block that has attitude samples.

        Raises:
            InputError: no block has attitude samples.

        """
        blocks, model = tuple(blocks), model.of_log(name)
        seen = (k for k, b in enumerate(blocks) if starts or past or len(b.samples.attitude))
        first = next(seen, None)
        if first is None:
            raise InputError("no attitude samples while the joints are known: none to start from")
        blocks = blocks[first:]
        smoothness, joints = smooth_joints(blocks, model.suite)
        walks = tuple(np.zeros(len(model.walking_columns)) for _ in blocks[1:])
        forces = tuple(model.no_forces(block.start, block.end) for block in blocks)
        weights = tuple(dict[str, Array]() for _ in blocks)
        pulls = tuple(np.zeros(12) for _ in blocks[1:])
        gaps = tuple(later.start - block.end for block, later in pairwise(blocks))
        parts = tuple(joints)
        own = smoothness, walks, forces, blocks[0].start, starts
        return cls(name, blocks, parts, *own, gaps=gaps, pulls=pulls, weights=weights, past=past)

    @classmethod
    def of(cls, model: Model, samples: Log | Iterable[Log], name: str = "log") -> "LogState":
        """Return a log of screened samples (or of chunks of them), cut into blocks.

        Raises:
            InputError: no block has attitude samples.

        """
        stream = [samples] if isinstance(samples, Log) else samples
        queue = BlockQueue.of(model.of_log(name).suite)
        return cls.of_blocks(model, blocks_of(queue, stream), name)

    def of_others(
        self, model: Model, blocks: Iterable[Block], starts: tuple[TrajectoryState, ...] = ()
    ) -> "LogState":
        """Return a log of other blocks with the same past; see `of_blocks`."""
        fresh = LogState.of_blocks(model, blocks, self.name, starts, past=self.past)
        fresh = replace(fresh, origin=self.origin)
        return replace(fresh, spectra=self.spectra, noise=self.noise) if self.past else fresh

    def extended(self, model: Model, block: Block, start: TrajectoryState) -> "LogState":
        """Return the log with one more block; with a past, joints of the others stay as they are.

        The joints' motion is as smooth as that of all its blocks.
        """
        blocks, gap = (*self.blocks, block), block.start - self.blocks[-1].end
        smoothness, joints = smooth_joints(blocks, model.suite)
        if self.past is not None:
            part, last = joints[-1], self.joints[-1].coefficients[-ORDER:]
            joints = [*self.joints, part if gap else continued(part, last)]
        return replace(
            self,
            blocks=blocks,
            smoothness=smoothness,
            joints=tuple(joints),
            starts=(*self.starts, start),
            forces=(*self.forces, model.no_forces(block.start, block.end)),
            walks=(*self.walks, np.zeros(len(model.walking_columns))),
            gaps=(*self.gaps, gap),
            pulls=(*self.pulls, np.zeros(12)),
            weights=(*self.weights, {}),
            shown=(),
        )

    def opened(self, ends: Iterable[int]) -> "LogState":
        """Return the log open at the ends of some blocks, and closed at all others.

        What begins anew behind a gap does not change there.
        """
        return replace(self, open=frozenset(k for k in ends if not self.gaps[k]))

    def step(self, k: int) -> float:
        """Return the time [s] from the start of block k, not a log's last, to that of the next."""
        return self.blocks[k].length + self.gaps[k]

    def link(self, model: Model, k: int) -> Array:
        """Return σ (12,) of a change of attitude, centre of mass, L and v at the end of block k."""
        return self._sigma(model, k, CLOSED)

    def link_cost(self, model: Model, k: int, change: Array) -> float:
        """Return χ² of a change (12,) at the end of block k.

        A closed end would have a χ² that hides that of all samples where a step leaves a change of
        second order: here it costs 2 λᵀu + |u/σ|² with the pull λ of the end and a larger σ
        (augmented Lagrangian; Nocedal and Wright 2006, ch. 17.3).
        """
        judged = self._sigma(model, k, JUDGED)
        if k in self.open:
            return float(np.sum((change / judged) ** 2))
        pull, aim = self.pulls[k], self.pulls[k] * self.link(model, k) ** 2
        square = float(np.sum(((change - aim) / judged) ** 2))
        return square + float(pull @ (2 * change - aim))

    def _sigma(self, model: Model, k: int, closed: float) -> Array:
        is_open = k in self.open or self.gaps[k]
        return farthest(model) if is_open else _sizes(model, closed, closed, closed)

    @property
    def changes(self) -> list[float]:
        """Times of changes [s]: of an open end, or the middle of a block of which both are open."""
        times, ends = list[float](), sorted(self.open, reverse=True)
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

    @property
    def noise_factors(self) -> dict[str, float]:
        """Size of the noise inside of a block, as factors of the sensors' declared σ."""
        found = dict(self.noise)
        for name, spectrum in self.spectra.items():
            times = max((block.samples[name].time for block in self.blocks), key=len)
            if len(times) > 1:
                power = Whitening.of(times, spectrum, np.ones(len(times))).power[1:]
                found[name] = found.get(name, 1.0) * float(np.sqrt(np.mean(power)))
        return found

    def part(self, first: int, end: int) -> "LogState":
        """Return the blocks from `first` up to `end`, with what changes behind the last of them."""
        lists = (
            "blocks",
            "joints",
            "forces",
            "walks",
            "weights",
            "starts",
            "gaps",
            "pulls",
            "shown",
        )
        parts: dict[str, Any] = {name: getattr(self, name)[first:end] for name in lists}
        ends = frozenset(k - first for k in self.open if first <= k < end)
        return replace(self, open=ends, past=None if first else self.past, **parts)

    def whitened(self, k: int, sensor: str, rest: Array) -> Array:
        """Return white residuals of those (M, d) of a sensor in block k."""
        return self.whitening(k, sensor, len(rest))(rest)

    def whitening(self, k: int, sensor: str, count: int) -> Whitening:
        """Return what makes the residuals of a sensor, or of a white force, in block k white."""
        times = self.blocks[k].samples[sensor].time if sensor in SENSORS else np.zeros(count)
        weights = self.weights[k].get(sensor, np.ones(count)) / self.noise.get(sensor, 1.0)
        return Whitening.of(times, self.spectra.get(sensor, WHITE), weights)


def farthest(model: Model) -> Array:
    """Return σ (12,) of a change of attitude, centre of mass, L and v at an open end."""
    return _sizes(model, *FARTHEST)


def _sizes(model: Model, turn: float, place: float, speed: float) -> Array:
    return np.repeat([turn, place, speed * model.L_sigma, speed], 3)
