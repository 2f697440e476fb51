"""The fit online: block after block, with a state that is a value.

At first, errors of the sensors look like effects of the target: the blocks are stored, and all of
them are fitted at doubling lengths. Once the inertia of the system is well known, a block is linear
about the target: from then on every block is swept once when it is complete, and only what is known
at its end is kept. A block that its noise does not explain may follow a change of momentum, or
contain one: its start is opened, or it is halved; a shortest piece that nothing explains is bridged
by its joints alone.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.events import farthest
from cpid_drake.estimation.fit import Fit, fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import (
    joined,
    joint_part,
    opened,
    triangles,
)
from cpid_drake.estimation.likelihood.joint_motion import KICK, ORDER, JointPart
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, roll, walking_columns
from cpid_drake.estimation.sweep import (
    Swept,
    back,
    boundary_size,
    sweep,
    with_change,
)
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model

NAME = "online"
"""Name of the log of an online fit."""

WELL_KNOWN = 1e-3
"""Relative error of the system's inertia from which a block is linear about the target."""

UNLIKELY = 6.0
"""A block whose χ² is above its expectation by so many σ is not explained by its noise."""

CURVED = 0.1
"""χ² above its linear prediction by less than this: the block is linear about its solution."""

MOST_SWEEPS = 6
"""A block is linearized so many times before it is, at its solution, once more."""

HALVINGS = 3
"""A block that nothing explains is halved so many times."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known at the end of the last block.

    Attributes:
        values: of all unknowns, about which everything is linear.
        log: the last block, with its start, bias and noise; `start` is the state at its end.
        rows: about what is at the boundary, and all unknowns: [boundary | table | right side].
        track: (J, ORDER, ORDER + 1) rows about the joints, by their own sensors alone.

    """

    values: Values
    log: LogState
    rows: NDArray[np.float64]
    track: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OnlineState:
    """The state of the online fit.

    Attributes:
        window: stored blocks, until the target is well known.
        next_fit: length of the window at which it is fitted [s].
        known: what is known at the end of the last block; None before the target is well known.
        first: the latest fit of the window; None before the first.
        events: times at which the momentum changed [s].

    """

    window: tuple[Block, ...] = ()
    next_fit: float = 0.0
    known: Known | None = None
    first: Fit | None = None
    events: tuple[float, ...] = field(default_factory=tuple)

    def gaussian(self, model: Model) -> Gaussian | None:
        """Return what is known of all unknowns but the block's, about `values`; None if nothing."""
        if self.known is None:
            return None if self.first is None else self.first.gaussian
        n = boundary_size(model)
        sizes = {unknown.key(NAME): unknown.size for unknown in model.table}
        return Gaussian.of_rows(sizes, self.known.rows[n:, n:])

    @property
    def values(self) -> Values | None:
        """The values of all unknowns; None before the first fit."""
        if self.known is not None:
            return self.known.values
        return None if self.first is None else self.first.values


def step(model: Model, state: OnlineState, block: Block) -> OnlineState:
    """Return the state after one more block.

    The work is bounded: one fit of the window, or that of at most 2^(`HALVINGS` + 1) parts.

    Args:
        model: the unknowns.
        state: before the block.
        block: the samples that follow.

    """
    if state.known is None:
        return _grown(model, replace(state, window=(*state.window, block)))
    return _after(model, state, block, HALVINGS)


def _grown(model: Model, state: OnlineState) -> OnlineState:
    """Return the state with a longer window, fitted if it is long enough."""
    length = state.window[-1].end - state.window[0].start
    if length < state.next_fit:
        return state
    try:
        log = LogState.of_blocks(model, state.window, NAME)
        found = fit(model, [log])
    except (InputError, np.linalg.LinAlgError):
        return replace(state, next_fit=2 * length)
    state = replace(state, next_fit=2 * length, first=found)
    if not (found.converged and inertia_error(model, found) < WELL_KNOWN):
        return state
    return replace(state, window=(), known=_begun(model, found))


def _begun(model: Model, found: Fit) -> Known:
    """Return what a fit of the window knows at its end."""
    log, rolled = found.logs[0], found.rolled[0]
    swept = sweep(model, log, rolled, found.values)
    total = prior_of(model, [log], found.values, ()).add(swept.gaussian)
    n = boundary_size(model)
    order = total.indices(unknown.key(NAME) for unknown in model.table)
    below = np.column_stack([np.zeros((total.size, n)), total.R[:, order], total.z])
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
    )
    return Known(found.values, last, np.vstack([swept.boundary, below]), track)


def _after(model: Model, state: OnlineState, block: Block, halvings: int) -> OnlineState:
    """Return the state after a block that may be halved so many times."""
    known = state.known
    assert known is not None
    for is_open in (False, True):
        try:
            found = _solved(model, known, block, is_open=is_open)
        except (InputError, np.linalg.LinAlgError):
            continue
        if _is_likely(found):
            events = (*state.events, block.start) if is_open else state.events
            return replace(state, known=_known(model, found), events=events)
    if halvings and len(block.samples.encoders) > 1:
        first, second = block.halves()
        state = _after(model, state, first, halvings - 1)
        return _after(model, state, second, halvings - 1)
    alone = {name: block.samples[name] for name in ("encoders", "joint_rates", "thrust")}
    bridge = replace(block, samples=replace(block.samples, samples=alone))
    found = _solved(model, known, bridge, is_open=False)
    after = _known(model, found)
    rows = with_change(after.rows, np.arange(12), farthest(model), np.zeros(12))
    return replace(
        state,
        known=replace(after, rows=rows[12 : 12 + len(after.rows), 12:]),
        events=(*state.events, block.end),
    )


@dataclass(frozen=True, eq=False)
class _Solved:
    """A block, linearized at its solution."""

    values: Values
    log: LogState
    rolled: Rolled
    swept: Swept
    track: NDArray[np.float64]


def _solved(model: Model, known: Known, block: Block, *, is_open: bool) -> _Solved:
    """Return a block's solution, linearized there."""
    n = boundary_size(model)
    track, rows = known.track, known.rows
    joints = slice(n - ORDER * model.joint_count, n)
    if block.is_kicked:
        track = opened(track)
        kicked = np.arange(joints.start, n)[ORDER - 1 :: ORDER]
        rows = _changed(rows, kicked, np.full(len(kicked), KICK))
    walking, sigma = walking_columns(model)
    if len(walking):
        rows = _changed(rows, n + walking, sigma * np.sqrt(block.length))
    if is_open:
        rows = _changed(rows, np.arange(12), farthest(model))
    part, track = _tracked(track, joint_part(block, model.suite, known.log.smoothness))
    moved = part.coefficients[:ORDER] - known.log.joints[0].coefficients[-ORDER:]
    rows = rows.copy()
    rows[:, -1] -= rows[:, joints] @ moved.T.ravel()
    nodes = [2 if gyro.bias_growth else 1 for gyro in model.gyros]
    bias = np.repeat(known.log.bias[0], nodes, axis=0)
    log, values = (
        replace(known.log, blocks=(block,), joints=(part,), bias=(bias,)),
        known.values,
    )
    names = [unknown.key(NAME) for unknown in model.table]
    rolled = roll(model, log, values)
    for _ in range(MOST_SWEEPS):
        swept = sweep(model, log, rolled, values, before=rows)
        predicted, g = swept.gaussian.rho2, swept.gaussian.solve()
        change = {name: g[swept.gaussian.places[name]] for name in names}
        better = back(model, log, swept, change)
        shift = np.concatenate([_boundary_step(model, log, better), g])
        rows = rows.copy()
        rows[:, -1] -= rows[:, :-1] @ shift
        log, values = better, {name: values[name] + change[name] for name in names}
        rolled = roll(model, log, values)
        found = rolled.cost_inside(log) + float(np.sum(rows[:, -1] ** 2))
        if found - predicted < CURVED:
            break
    swept = sweep(model, log, rolled, values, before=rows)
    return _Solved(values, log, rolled, swept, track)


def _boundary_step(model: Model, log: LogState, better: LogState) -> NDArray[np.float64]:
    """Return the step (n,) of what is at the start of a block."""
    old, new = log.start, better.start
    assert old is not None
    assert new is not None
    first = np.cumsum([0, *(2 if gyro.bias_growth else 1 for gyro in model.gyros)])[:-1]
    bias = (better.bias[0] - log.bias[0])[first]
    joints = better.joints[0].coefficients[:ORDER] - log.joints[0].coefficients[:ORDER]
    turn = (new.attitude * old.attitude.inv()).as_rotvec()
    pose = [turn, new.p_Wcm - old.p_Wcm, new.L - old.L, new.v_Wcm - old.v_Wcm]
    return np.concatenate([*pose, bias.ravel(), joints.T.ravel()])


def _known(model: Model, found: _Solved) -> Known:
    """Return what is known at the end of a solved block."""
    n, gaussian = boundary_size(model), found.swept.gaussian
    below = np.column_stack([np.zeros((gaussian.size, n)), gaussian.R, gaussian.z])
    end = found.rolled.models[0].motion.end(found.rolled.trajectories[0])
    log = replace(found.log, start=end, bias=(_last_bias(model, found.log.bias[0]),))
    return Known(found.values, log, np.vstack([found.swept.boundary, below]), found.track)


def _is_likely(found: _Solved) -> bool:
    """Return whether noise explains the samples of a block."""
    rest = [
        found.log.weighted(0, name, each).ravel()
        for name, each in found.rolled.residuals[0].items()
    ]
    count = sum(map(len, rest))
    return float(sum(r @ r for r in rest)) < count + UNLIKELY * np.sqrt(2 * count)


def _tracked(track: NDArray[np.float64], part: JointPart) -> tuple[JointPart, NDArray[np.float64]]:
    """Return a part about the motion by its sensors so far, and the rows at its end."""
    T = triangles(joined(track, part))
    K = part.size
    c = [np.linalg.lstsq(rows[:K, :K], rows[:K, K], rcond=1e-12)[0] for rows in T]
    return replace(part, coefficients=np.stack(c, axis=1)), T[:, K - ORDER : K, K - ORDER :]


def _changed(
    rows: NDArray[np.float64], columns: NDArray[np.intp], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return rows after an unknown change of some columns."""
    m = len(columns)
    return with_change(rows, columns, sigma, np.zeros(m))[m : m + len(rows), m:]


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
