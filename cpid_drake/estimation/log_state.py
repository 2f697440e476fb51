"""A log cut into blocks, and the present values of what belongs to this log alone."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.gaussian import places_of
from cpid_drake.estimation.joint_samples import Smoothness
from cpid_drake.estimation.joints import continued, smooth_joints
from cpid_drake.estimation.likelihood.joint_model import ORDER, JointPart
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.process import DECLARED, Innovations, Process
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import SENSORS

CLOSED = 1e-8
"""σ of a change at a closed end, as a share of 1 rad, 1 m, 1 m/s and a fast tumble's momentum."""

JUDGED = 1e-5
"""The same for the χ² by which a step is judged; see `LogState.link_cost`."""

RECENT = 3
"""Behind a past, so many of the last blocks show how smooth the joints of one more are."""

CHANGE = "change at "
"""Beginning of the name of an unknown change of momentum; see `LogState.change`."""

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
        spans: σ of changes at some open ends, as shares of `farthest`; 1 of all others.
        gaps: of each block but a log's last: time until the next one begins [s]. Nothing is known
            of the joints in a gap, so that attitude, centre of mass, L and v begin anew behind it.
        pulls: of each block but a log's last: (12,) derivative of half χ² by the change at its end,
            which is zero, if the end is closed.
        weights: of each block: (M,) weights of a sensor's samples.
        processes: of each sensor and white force whose noise is not as declared.
        edges: (s,) slow noise of these sensors, in units of their declared σ, at the start of each
            block and at the end of the last.
        is_known: whether the processes have been sought at a fit with noise of their own, or where
            there are none.
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
    spans: Mapping[int, float] = field(default_factory=dict)
    gaps: tuple[float, ...] = ()
    pulls: tuple[Array, ...] = ()
    weights: tuple[dict[str, Array], ...] = ()
    processes: dict[str, Process] = field(default_factory=dict)
    edges: tuple[Array, ...] = ()
    is_known: bool = False
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
        edges = tuple(np.zeros(0) for _ in range(len(blocks) + 1))
        return cls(
            name,
            blocks,
            parts,
            *own,
            gaps=gaps,
            pulls=pulls,
            weights=weights,
            past=past,
            edges=edges,
        )

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
        if not self.past:
            return fresh
        return fresh.with_processes(self.processes)

    def extended(self, model: Model, block: Block, start: TrajectoryState) -> "LogState":
        """Return the log with one more block; with a past, joints of the others stay as they are.

        The joints' motion is as smooth as that of all its blocks, or with a past of the last ones.
        """
        blocks, gap = (*self.blocks, block), block.start - self.blocks[-1].end
        recent, known = blocks if self.past is None else blocks[-RECENT:], self.smoothness
        smoothness, joints = smooth_joints(recent, model.suite, known)
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
            edges=(*self.edges, self.edges[-1]),
            is_known=False,
        )

    def opened(self, ends: Iterable[int]) -> "LogState":
        """Return the log open at the ends of some blocks, and closed at all others.

        What begins anew behind a gap does not change there.
        """
        return replace(self, open=frozenset(k for k in ends if not self.gaps[k]))

    def step(self, k: int) -> float:
        """Return the time [s] from the start of block k, not a log's last, to that of the next."""
        return self.blocks[k].length + self.gaps[k]

    def change(self, k: int) -> str:
        """Return the name of the change at the end of block k, if it is an unknown of its own."""
        return f"{CHANGE}{self.blocks[k].end} s|{self.name}"

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
        if is_open:
            return self.spans.get(k, 1.0) * farthest(model)
        return _sizes(model, closed, closed, closed)

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
        found = dict.fromkeys(self.freedom, 1.0)
        length = self.blocks[-1].end - self.blocks[0].start
        return found | {n: float(np.sqrt(p.within(length))) for n, p in self.processes.items()}

    @cached_property
    def slow(self) -> dict[str, slice]:
        """Places of sensors with slow noise in `edges`."""
        return places_of({n: p.size for n, p in self.processes.items() if p.slow})

    @cached_property
    def slow_size(self) -> int:
        """Number of entries of slow noise."""
        return sum(process.size for process in self.processes.values())

    @property
    def slow_sigma(self) -> Array:
        """(s,) their σ."""
        return np.array([p.slow**0.5 for p in self.processes.values() for _ in range(p.size)])

    def slow_at(self, k: int) -> Array:
        """Return slow noise (2, s) at both edges of block k."""
        return np.stack(self.edges[k : k + 2])

    def with_processes(self, processes: Mapping[str, Process]) -> "LogState":
        """Return the log with other noise; slow noise that was there keeps its values."""
        made = replace(self, processes=dict(processes))
        old, edges = self.slow, list[Array]()
        for edge in self.edges:
            parts = [
                edge[old[n]] if n in old else np.zeros(p.stop - p.start)
                for n, p in made.slow.items()
            ]
            edges.append(np.concatenate([np.empty(0), *parts]))
        return replace(made, edges=tuple(edges))

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
        )
        parts: dict[str, Any] = {name: getattr(self, name)[first:end] for name in lists}
        parts["edges"] = self.edges[first : end + 1]
        ends = frozenset(k - first for k in self.open if first <= k < end)
        return replace(self, open=ends, past=None if first else self.past, **parts)

    def followed(self, model: Model, other: "LogState") -> "LogState":
        """Return the blocks and then those of a log that goes on at their closed end."""
        lists = ("blocks", "joints", "forces", "weights", "starts")
        parts: dict[str, Any] = {n: (*getattr(self, n), *getattr(other, n)) for n in lists}
        ends = {"walks": np.zeros(len(model.walking_columns)), "gaps": 0.0, "pulls": np.zeros(12)}
        for name, between in ends.items():
            parts[name] = (*getattr(self, name), between, *getattr(other, name))
        parts["edges"] = (*self.edges, *other.edges[1:])
        parts["open"] = self.open | {len(self.blocks) + k for k in other.open}
        return replace(other, past=self.past, origin=self.origin, **parts)

    def whitened(self, k: int, sensor: str, rest: Array) -> Array:
        """Return white residuals (M, d) of those (M, d) of a sensor in block k."""
        return self.rows_of(k, {sensor: rest})[sensor][: len(rest)]

    def rows_of(self, k: int, rest: Mapping[str, Array]) -> dict[str, Array]:
        """Return white residuals of those (M, d) in block k, and of the links of slow noise."""
        slow, places, found = self.slow_at(k), self.slow, {}
        for name, white in self.whitenings(k, rest).items():
            own = rest.get(name, np.zeros((0, white.process.channels)))
            found[name] = white.of(own, *slow[:, places.get(name, slice(0))])
        return found

    def whitenings(self, k: int, rest: Mapping[str, Array]) -> dict[str, Innovations]:
        """Return what makes the residuals of block k white, and links slow noise."""
        found = {name: self.whitening(k, name, len(each)) for name, each in rest.items()}
        for name in self.slow:
            if name not in rest:
                found[name] = self.whitening(k, name, 0)
        return found

    def whitening(self, k: int, sensor: str, count: int) -> Innovations:
        """Return what makes the residuals of a sensor, or of a white force, in block k white."""
        block = self.blocks[k]
        if sensor in SENSORS:
            times = block.samples[sensor].time if count else np.zeros(0)
        else:  # of a force: the middles of its pieces
            times = block.start + (np.arange(count) + 0.5) * block.length / max(count, 1)
        weights = self.weights[k].get(sensor, np.ones(count))[:count]
        end = block.start + (self.step(k) if k < len(self.gaps) else block.length)
        process = self.processes.get(sensor, DECLARED)
        return Innovations(times, block.start, end, weights, process)


def farthest(model: Model) -> Array:
    """Return σ (12,) of a change of attitude, centre of mass, L and v at an open end."""
    return _sizes(model, *FARTHEST)


def _sizes(model: Model, turn: float, place: float, speed: float) -> Array:
    return np.repeat([turn, place, speed * model.L_sigma, speed], 3)
