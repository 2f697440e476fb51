"""The fit online: block after block, with a state that is a value.

At first, errors of the sensors look like effects of the target: the blocks are stored, and all of
them are fitted at doubling lengths. Once the inertia of the system is well known, or the stored
blocks are many, a block is linear about the target: from then on every block is swept once when it
is complete, and only what is known at its end is kept.

Attitude, centre of mass and momentum may change at the start of every block. This change remains an
unknown for `KEPT` blocks. It acts with a probability w, and has the size a of its σ that its
evidence prefers, as in `evidence`; so its prior has the variance w a² σ². A small one that the
samples cannot tell from none widens the intervals, one that they exclude is zero, and one that acts
is free. A block at whose start something changed is halved, because the change may be inside of it.
A shortest piece that nothing explains is bridged by its joints alone.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.events import HELD, farthest, fit_with_events
from cpid_drake.estimation.evidence import NAMED, compare
from cpid_drake.estimation.fit import CLOSE, Fit, fit, prior_of, weights_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import (
    joined,
    joint_part,
    opened,
    triangles,
)
from cpid_drake.estimation.likelihood.joint_motion import KICK, ORDER, JointPart
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, first_bias, roll, walking_columns
from cpid_drake.estimation.sweep import EXACT, Swept, back, boundary_size, sweep, with_change
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model

NAME = "online"
"""Name of the log of an online fit."""

BOUNDARY = "boundary"
"""Name of what is at the end of the last block: attitude, p, L, v, biases and joints."""

WELL_KNOWN = 1e-3
"""Relative error of the system's inertia from which a block is linear about the target."""

LONGEST = 16
"""So many blocks are stored at most: then a block is taken as linear about what is known."""

KEPT = 4
"""A change at the start of a block remains an unknown until so many blocks have followed."""

MOST_SWEEPS = 6
"""A block is linearized so many times at most."""

HALVINGS = 3
"""A block is halved so many times."""

UNLIKELY = 6.0
"""A shortest piece whose χ² is above its expectation by so many σ is bridged."""


@dataclass(frozen=True)
class Link:
    """A change of attitude, centre of mass and momentum at the start of a block.

    Attributes:
        time: the start of the block [s].
        probability: that something changed.
        size: of the change, as a share of its σ.

    """

    time: float
    probability: float = 0.0
    size: float = 1.0

    @property
    def name(self) -> str:
        """Name of the change as an unknown."""
        return f"link {self.time!r}"


@dataclass(frozen=True, eq=False)
class Known:
    """What is known at the end of the last block.

    Attributes:
        values: of all unknowns, about which everything is linear.
        log: the last block, with its bias and noise; `start` is the state at its end.
        gaussian: about what is at the boundary and all unknowns, and of the links themselves.
        links: at the starts of the last blocks.
        track: (J, ORDER, ORDER + 1) rows about the joints, by their own sensors alone.

    """

    values: Values
    log: LogState
    gaussian: Gaussian
    links: tuple[Link, ...]
    track: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OnlineState:
    """The state of the online fit.

    Attributes:
        window: stored blocks, until the target is well known.
        next_fit: length of the window at which it is fitted [s].
        known: what is known at the end of the last block; None while blocks are stored.
        first: the latest fit of the window; None before the first.
        settled: times at which the momentum changed [s], of links that are no unknowns any more.
        processed, rejected: number of samples, and of those that weigh less or not at all, by
            sensor.
        bridged: length of the pieces that nothing explains [s].
        start: of the first block [s].

    """

    window: tuple[Block, ...] = ()
    next_fit: float = 0.0
    known: Known | None = None
    first: Fit | None = None
    settled: tuple[float, ...] = ()
    processed: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    bridged: float = 0.0
    start: float = np.nan

    @property
    def events(self) -> tuple[float, ...]:
        """Times at which the momentum changed [s]."""
        links = () if self.known is None else self.known.links
        return (*self.settled, *(link.time for link in links if link.probability >= NAMED))

    def gaussian(self, model: Model) -> Gaussian | None:
        """Return what is known of all unknowns but the block's, about `values`; None if nothing."""
        if self.known is None:
            return None if self.first is None else self.first.gaussian
        closed = self.known.gaussian
        for link in self.known.links:
            closed = _closed(model, closed, link)
        return closed.marginal(name for name in closed.places if name != BOUNDARY)

    @property
    def values(self) -> Values | None:
        """The values of all unknowns; None before the first fit."""
        if self.known is not None:
            return self.known.values
        return None if self.first is None else self.first.values


def step(model: Model, state: OnlineState, block: Block) -> OnlineState:
    """Return the state after one more block.

    The work is bounded. While blocks are stored: at lengths of 1, 2, 4, … blocks a fit of at most
    `LONGEST` of them. Then: a sweep of the block, usually one and at most `MOST_SWEEPS`; and of at
    most 2^(`HALVINGS` + 1) − 2 parts of a block in which something changed.

    Args:
        model: the unknowns.
        state: before the block.
        block: the samples that follow.

    """
    count = {name: len(samples) for name, samples in block.samples.items()}
    state = replace(
        state,
        processed=Counter(state.processed) + Counter(count),
        start=block.start if np.isnan(state.start) else state.start,
    )
    if state.known is None:
        return _grown(model, replace(state, window=(*state.window, block)))
    return _after(model, state, block, HALVINGS)


def _grown(model: Model, state: OnlineState) -> OnlineState:
    """Return the state with a longer window, fitted if it is long enough."""
    window = state.window
    length, is_full = window[-1].end - window[0].start, len(window) >= LONGEST
    if length < state.next_fit and not is_full:
        return state
    state = replace(state, next_fit=2 * length)
    try:
        found = fit(model, [LogState.of_blocks(model, window, NAME)])
        found, events = fit_with_events(model, found)
        is_known = found.converged and inertia_error(model, found) < WELL_KNOWN
    except (InputError, np.linalg.LinAlgError):
        return replace(state, window=window[len(window) // 2 :]) if is_full else state
    state = replace(state, first=found, settled=tuple(event.time for event in events))
    if not (is_known or is_full):
        return state
    return replace(state, window=(), known=_begun(model, found))


def _begun(model: Model, found: Fit) -> Known:
    """Return what a fit of the window knows at its end."""
    log, rolled = found.logs[0], found.rolled[0]
    swept = sweep(model, log, rolled, found.values)
    total = prior_of(model, [log], found.values, ()).add(swept.gaussian)
    total = total.marginal(unknown.key(NAME) for unknown in model.table)
    track = np.zeros((model.joint_count, ORDER, ORDER + 1))
    for part in log.joints:
        track = _tracked(track, part)[1]
    end = rolled.models[-1].motion.end(rolled.trajectories[-1])
    last = replace(
        log,
        blocks=log.blocks[-1:],
        joints=log.joints[-1:],
        bias=(_last_bias(model, log.bias[-1]),),
        walks=(),
        weights=({},),
        start=end,
        links={},
        jumps={},
    )
    gaussian = _at_end(model, replace(swept, gaussian=total))
    return Known(found.values, last, gaussian, (), track)


def _after(model: Model, state: OnlineState, block: Block, halvings: int) -> OnlineState:
    """Return the state after a block that may be halved so many times."""
    known = state.known
    assert known is not None
    try:
        found = _solved(model, known, block)
        is_explained = found.is_likely and (not halvings or not found.is_changed)
    except (InputError, np.linalg.LinAlgError):
        found, is_explained = None, False
    if found is not None and is_explained:
        return _settled(model, state, found.known(model), found.rejected)
    if halvings and len(block.samples.encoders) > 1:
        first, second = block.halves()
        state = _after(model, state, first, halvings - 1)
        return _after(model, state, second, halvings - 1)
    if found is not None and found.is_likely:
        return _settled(model, state, found.known(model), found.rejected)
    alone = {name: block.samples[name] for name in ("encoders", "joint_rates", "thrust")}
    bridge = replace(block, samples=replace(block.samples, samples=alone))
    rejected = {name: len(s) for name, s in block.samples.items() if name not in alone}
    state = replace(state, bridged=state.bridged + block.length)
    return _settled(model, state, _solved(model, known, bridge).known(model), rejected)


@dataclass(frozen=True, eq=False)
class _Solved:
    """A block, linearized near its solution.

    Attributes:
        values, log, rolled: at the solution.
        gaussian: about what is at the end of the block and all unknowns, and of the links.
        links: with that at the start of the block as the last one.
        track: rows about the joints at the end.

    """

    values: Values
    log: LogState
    rolled: Rolled
    gaussian: Gaussian
    links: tuple[Link, ...]
    track: NDArray[np.float64]

    def known(self, model: Model) -> Known:
        """Return what is known at the end."""
        end = self.rolled.models[0].motion.end(self.rolled.trajectories[0])
        bias = (_last_bias(model, self.log.bias[0]),)
        log = replace(self.log, start=end, bias=bias, weights=({},))
        return Known(self.values, log, self.gaussian, self.links, self.track)

    @property
    def is_changed(self) -> bool:
        """Whether something changed at the start of the block."""
        return self.links[-1].probability >= NAMED

    @property
    def is_likely(self) -> bool:
        """Whether noise explains the samples."""
        rest = [
            self.log.weighted(0, name, each).ravel()
            for name, each in self.rolled.residuals[0].items()
        ]
        count = sum(map(len, rest))
        return float(sum(r @ r for r in rest)) < count + UNLIKELY * np.sqrt(2 * count)

    @property
    def rejected(self) -> dict[str, int]:
        """Number of samples that weigh less than others, by sensor."""
        return {name: int(np.sum(w < 1)) for name, w in self.log.weights[0].items()}


def _solved(model: Model, known: Known, block: Block) -> _Solved:
    """Return a block's solution, with a link at its start.

    It is linearized anew until χ² at the solution is what the last linearization predicts.
    """
    n, gaussian, track = boundary_size(model), known.gaussian, known.track
    if block.is_kicked:
        track = opened(track)
        kicked = np.arange(n - ORDER * model.joint_count, n)[ORDER - 1 :: ORDER]
        gaussian = _changed(gaussian, kicked, np.full(len(kicked), KICK))
    walking, sigma = walking_columns(model)
    if len(walking):
        gaussian = _changed(gaussian, n + walking, sigma * np.sqrt(block.length))
    links = (*known.links, Link(block.start))
    gaussian = _linked(model, gaussian, links[-1])
    part, track = _tracked(track, joint_part(block, model.suite, known.log.smoothness))
    nodes = [2 if gyro.bias_growth else 1 for gyro in model.gyros]
    bias = np.repeat(known.log.bias[0], nodes, axis=0)
    log = replace(known.log, blocks=(block,), joints=(part,), bias=(bias,))
    values, rolled = known.values, roll(model, log, known.values)
    here = _Boundary.at_start(model, log)
    before = replace(here, joints=known.log.joints[0].coefficients[-ORDER:])
    gaussian = _moved(gaussian, before.step_to(here))
    names = [unknown.key(NAME) for unknown in model.table]
    for _ in range(MOST_SWEEPS):
        swept = _swept(model, log, rolled, values, gaussian)
        links = _judged(model, swept.gaussian, links)
        g = _mean(_with_priors(model, swept.gaussian, links))
        change = {name: g[place] for name, place in swept.gaussian.places.items()}
        better = back(model, log, swept, change)
        values = {name: values[name] + change[name] for name in names}
        ahead = roll(model, better, values)
        table = np.concatenate([change[name] for name in names])
        there = _Boundary.at_start(model, better)
        gaussian = _moved(gaussian, here.step_to(there), table)
        jumps = np.concatenate([np.zeros(n + len(table)), g[len(table) :]])
        excess = ahead.cost_inside(better) + gaussian.cost(jumps) - swept.gaussian.cost(g)
        ends = [_Boundary.at_end(model, *each) for each in ((log, rolled), (better, ahead))]
        at_end = _moved(_at_end(model, swept), ends[0].step_to(ends[1]), table)
        weighted, is_settled = _weighted(better, ahead)
        log, rolled, here = weighted, ahead, there
        if abs(excess) < CLOSE and is_settled:
            break
    return _Solved(values, log, rolled, at_end, links, track)


@dataclass(frozen=True, eq=False)
class _Boundary:
    """What is at one end of a block: the base's state, biases (G, 3) and joints (ORDER, J)."""

    state: TrajectoryState
    bias: NDArray[np.float64]
    joints: NDArray[np.float64]

    @classmethod
    def at_start(cls, model: Model, log: LogState) -> "_Boundary":
        """Return what is at the start of the block of a log."""
        assert log.start is not None
        return cls(log.start, first_bias(model, log), log.joints[0].coefficients[:ORDER])

    @classmethod
    def at_end(cls, model: Model, log: LogState, rolled: Rolled) -> "_Boundary":
        """Return what is at the end of the block of a log."""
        end = rolled.models[0].motion.end(rolled.trajectories[0])
        return cls(end, _last_bias(model, log.bias[0]), log.joints[0].coefficients[-ORDER:])

    def step_to(self, other: "_Boundary") -> NDArray[np.float64]:
        """Return the step (n,) to another one."""
        old, new = self.state, other.state
        turn = (new.attitude * old.attitude.inv()).as_rotvec()
        pose = [turn, new.p_Wcm - old.p_Wcm, new.L - old.L, new.v_Wcm - old.v_Wcm]
        joints = (other.joints - self.joints).T
        return np.concatenate([*pose, (other.bias - self.bias).ravel(), joints.ravel()])


def _settled(
    model: Model, state: OnlineState, known: Known, rejected: Mapping[str, int]
) -> OnlineState:
    """Return the state after a block; its oldest links are no unknowns any more."""
    settled, links = state.settled, known.links
    while len(links) > KEPT:
        oldest, *rest = links
        known = replace(known, gaussian=_closed(model, known.gaussian, oldest), links=tuple(rest))
        settled = (*settled, oldest.time) if oldest.probability >= NAMED else settled
        links = known.links
    total = Counter(state.rejected) + Counter(rejected)
    return replace(state, known=known, settled=settled, rejected=total)


# -- links -----------------------------------------------------------------------------------------


def _linked(model: Model, gaussian: Gaussian, link: Link) -> Gaussian:
    """Return what is known after a change at the boundary, which is a further unknown."""
    n = gaussian.size
    rows = np.zeros((12 + n, n + 13))
    rows[:12, n : n + 12] = np.diag(1 / farthest(model))
    rows[12:, :n], rows[12:, n : n + 12] = gaussian.R, -gaussian.R[:, :12]
    rows[12:, -1] = gaussian.z
    return Gaussian.of_rows({**gaussian.sizes, link.name: 12}, rows)


def _judged(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> tuple[Link, ...]:
    """Return the links with the probabilities and sizes that the evidence shows."""
    candidates = {link.name: farthest(model) for link in links}
    held = {} if model.tree.normal_B is None else dict.fromkeys(candidates, HELD)
    found = compare(gaussian, candidates, [PSI], held)
    return tuple(
        replace(each, probability=found.probability[each.name], size=found.sizes.get(each.name, 0))
        for each in links
    )


def _prior_sigma(model: Model, link: Link) -> NDArray[np.float64]:
    """Return σ (12,) of a change that acts with its probability, and has its size."""
    sigma = farthest(model)
    share = np.full(12, np.sqrt(link.probability) * link.size)
    if model.tree.normal_B is not None:
        share[list(HELD)] = 0.0
    return sigma * np.maximum(share, EXACT)


def _with_priors(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> Gaussian:
    """Return what is known if the links are as large as their evidence shows."""
    sigma = np.concatenate([_prior_sigma(model, link) for link in links])
    rows = np.column_stack([np.diag(1 / sigma), np.zeros(len(sigma))])
    return gaussian.add(Gaussian.of_rows({link.name: 12 for link in links}, rows))


def _closed(model: Model, gaussian: Gaussian, link: Link) -> Gaussian:
    """Return what is known of the others if a link is as large as its evidence shows."""
    others = [name for name in gaussian.places if name != link.name]
    return _with_priors(model, gaussian, [link]).marginal(others)


# -- rows ------------------------------------------------------------------------------------------


def _swept(
    model: Model, log: LogState, rolled: Rolled, values: Values, gaussian: Gaussian
) -> Swept:
    """Return a linearized block after which the links are still unknowns."""
    before = np.column_stack([gaussian.R, gaussian.z])
    swept = sweep(model, log, rolled, values, before=before)
    rows = np.column_stack([swept.gaussian.R, swept.gaussian.z])
    sizes = {name: size for name, size in gaussian.sizes.items() if name != BOUNDARY}
    return replace(swept, gaussian=Gaussian.of_rows(sizes, rows, swept.gaussian.rho2))


def _at_end(model: Model, swept: Swept) -> Gaussian:
    """Return what is known at the end of a block."""
    n, gaussian = boundary_size(model), swept.gaussian
    below = np.column_stack([np.zeros((gaussian.size, n)), gaussian.R, gaussian.z])
    return Gaussian.of_rows({BOUNDARY: n, **gaussian.sizes}, np.vstack([swept.boundary, below]))


def _moved(gaussian: Gaussian, *steps: NDArray[np.float64]) -> Gaussian:
    """Return a Gaussian about another boundary, other values of the table, and the same links."""
    step = np.concatenate(steps)
    return gaussian.moved(np.append(step, np.zeros(gaussian.size - len(step))))


def _mean(gaussian: Gaussian) -> NDArray[np.float64]:
    """Return the mean (n,); priors determine all."""
    return np.asarray(solve_triangular(gaussian.R, gaussian.z))


def _changed(gaussian: Gaussian, columns: NDArray[np.intp], sigma: NDArray[np.float64]) -> Gaussian:
    """Return what is known after an unknown change of some columns."""
    m = len(columns)
    rows = np.column_stack([gaussian.R, gaussian.z])
    T = with_change(rows, columns, sigma, np.zeros(m))[m : m + len(rows), m:]
    return Gaussian(gaussian.places, T[:, :-1], T[:, -1])


def _weighted(log: LogState, rolled: Rolled) -> tuple[LogState, bool]:
    """Return a block's log with the weights that its residuals show, and whether they are as before."""
    weights = {
        name: weights_of(rest, log.noise.get(name, 1.0))
        for name, rest in rolled.residuals[0].items()
    }
    before = log.weights[0]
    same = all(
        np.abs(w - before.get(name, 1.0)).max(initial=0.0) < 0.05 for name, w in weights.items()
    )
    return (log, True) if same else (replace(log, weights=(weights,)), False)


def _tracked(track: NDArray[np.float64], part: JointPart) -> tuple[JointPart, NDArray[np.float64]]:
    """Return a part about the motion by its sensors so far, and the rows at its end."""
    T = triangles(joined(track, part))
    K = part.size
    c = [np.linalg.lstsq(rows[:K, :K], rows[:K, K], rcond=1e-12)[0] for rows in T]
    return replace(part, coefficients=np.stack(c, axis=1)), T[:, K - ORDER : K, K - ORDER :]


def _last_bias(model: Model, bias: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bias (G, 3) of each gyro at the end of a block."""
    nodes = np.cumsum([2 if gyro.bias_growth else 1 for gyro in model.gyros])
    return bias[nodes - 1]


def inertia_error(model: Model, found: Fit) -> float:
    """Return the relative error of the system's inertia about its centre of mass.

    It is the root mean square of Wᵀ δJ W, with J = W⁻ᵀW⁻¹, along the axes that can turn.
    """
    log, psi = found.logs[0], found.values[PSI]
    zero = {f"{MOMENTUM}|{log.name}": -found.values[f"{MOMENTUM}|{log.name}"]}
    covariance = found.gaussian.condition(zero).marginal([PSI]).covariance()
    q = log.joints[-1].coefficients[-ORDER][None]
    dynamics = relative_dynamics(model.tree, q, np.zeros_like(q))
    J, none = dynamics.inertia(psi)[0], dynamics.inertia(np.zeros(10))[0]
    normal_B = model.tree.normal_B
    if normal_B is None:
        W = np.linalg.inv(np.linalg.cholesky(J)).T
    else:
        W = normal_B[:, None] / np.sqrt(normal_B @ J @ normal_B)
    by = [(W.T @ (dynamics.inertia(e)[0] - none) @ W).ravel() for e in np.eye(10)]
    B = np.stack(by, axis=1)
    return float(np.sqrt(np.trace(B @ covariance @ B.T) / W.shape[1]))
