"""One sweep through a log: the rows of all blocks, without what ends with each block.

`roll` predicts the samples of a log at given values. `sweep` goes through its blocks: the rows of a
block are those known at its start, its links and its samples; QR eliminates what ends with it, and
what remains is known at its end. The result is a Gaussian of the log's, the hardware's and the
target's unknowns, about the present values. `back` goes the other way: given a step of those, it
finds the steps of everything else, so that the next roll starts from smoothed values. Together they
are one Gauss-Newton step of all unknowns at once.

Source: Bierman 1977, ch. V and X (square-root information filter and smoother).
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.array import Array
from cpid_drake.estimation.block_rows import BlockRows
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.elimination import Change, EndedBlock, changed, eliminated, linked
from cpid_drake.estimation.gaussian import Gaussian, places_of
from cpid_drake.estimation.least_squares import triangle
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.links import Link, link_sigma
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import (
    Rolled,
    Values,
    derivatives,
    first_values,
    jumped,
    past_of,
)
from cpid_drake.estimation.unknowns import FASTEST_DRIFT, MOMENTUM, Model
from cpid_drake.estimation.whitening import whiteners

EXACT = 1e-9
"""σ of what is conserved, or held while the rest is fitted, as a share of its plausible size."""

OPEN = 1e6
"""σ of attitude, centre of mass and joints before the first sample [rad, m]."""

BOUNDARY = "boundary"
"""Name of what is at the end of a block: attitude, p, L, v and joints."""


@dataclass(frozen=True, eq=False)
class Swept:
    """A linearized log.

    Attributes:
        end: of what is at the end of the last block, `BOUNDARY`, and then of the log's, the
            hardware's and the target's unknowns, about the present values.
        eliminations: what `back` needs, in the order of the sweep.
        stops: as `end`, at the ends of some blocks.

    """

    end: Gaussian
    eliminations: list[Change | EndedBlock]
    stops: Mapping[int, Gaussian] = field(default_factory=dict)

    @property
    def absorbed(self) -> dict[str, float]:
        """How many of a sensor's residuals the blocks' own unknowns absorb, by sensor."""
        absorbed = [step.absorbed for step in self.eliminations if isinstance(step, EndedBlock)]
        return {n: sum(each.get(n, 0.0) for each in absorbed) for n in set().union(*absorbed)}

    def step(self, others: Values) -> Array:
        """Return the step of all entries of `end`, given that of all but the boundary's."""
        g = np.concatenate([others[name] for name in self.end.places if name != BOUNDARY])
        n, R, z = self.end.size - len(g), self.end.R, self.end.z
        # R₁₁ b + R₁₂ g = z₁
        return np.concatenate([solve_triangular(R[:n, :n], z[:n] - R[:n, n:] @ g), g])

    @property
    def gaussian(self) -> Gaussian:
        """Of the log's, the hardware's and the target's unknowns."""
        return self.end.marginal(name for name in self.end.places if name != BOUNDARY)


def sweep(
    model: Model,
    log: LogState,
    rolled: Rolled,
    values: Values,
    *,
    carry: Collection[int] = (),
    before: Gaussian | None = None,
    forward_only: bool = False,
    stops: Collection[int] = (),
) -> Swept:
    """Linearize a log about given values.

    Args:
        model: the unknowns.
        log: the log.
        rolled: its prediction at these values.
        values: the values.
        carry: the blocks whose changes at the end remain unknowns of the result, named as
            `LogState.change` says.
        before: what is known at the start, as `Swept.end`; default: the priors of a log's start,
            or its past.
        forward_only: leave out what `back` needs: a quarter of a megabyte a block.
        stops: the blocks at whose ends the result also has what is known.

    """
    model, at = model.of_log(log.name), dict[int, Gaussian]()
    gaussian = known_at_start(model, log, values) if before is None else before
    eliminations = list[Change | EndedBlock]()
    for k, jacobians in enumerate(derivatives(model, log, rolled, values)):
        block_model = rolled.models[k].with_slow(log.noise.slow_size)
        residuals, rows = rolled.residuals[k], rolled.rows.get(rolled.models[k])
        white, slow = whiteners(log, k, residuals), log.slow_at(k)
        if rows is None or not rows.is_for(white, slow):
            places = log.noise.slow_places
            rows = BlockRows.of(block_model, jacobians, residuals, white, places, slow)
            rolled.rows[rolled.models[k]] = rows
        gaussian, T = eliminated(block_model, rows, gaussian)
        if not forward_only:
            eliminations.append(EndedBlock.of(block_model, residuals, rows, T))
        at |= {k: gaussian} if k in stops else {}
        if k in carry:
            gaussian = linked(
                gaussian, log.change(k), link_sigma(model, log.links[k]), rolled.jumps[k]
            )
        if change := change_at_end(model, log, rolled, k, is_carried=k in carry):
            gaussian, step = changed(gaussian, *change, block=k)
            eliminations.append(step)
    return Swept(gaussian, eliminations, at)


def change_at_end(
    model: Model, log: LogState, rolled: Rolled, k: int, *, is_carried: bool = False
) -> tuple[NDArray[np.intp], Array, Array] | None:
    """Return the columns that change at the end of block k, σ and present values; None if none.

    One that is carried is no change.
    """
    link = log.states[k].link
    if link is None:
        return None
    n = boundary_size(model, log)
    columns, now = n + model.walking_columns, link.walk
    # A walk changes by N(0, σ² Δt).
    sigma = model.walking_sigma * np.sqrt(log.interval(k))
    if k < len(rolled.jumps) and not is_carried:
        columns, now = np.append(columns, np.arange(12)), np.append(now, rolled.jumps[k])
        sigma = np.append(sigma, link_sigma(model, log.links[k]))
    if link.gap:
        joints = np.arange(12, n - log.noise.slow_size)
        columns, now = np.append(columns, joints), np.append(now, np.zeros(len(joints)))
        sigma = np.append(sigma, np.full(len(joints), OPEN))
    return columns, sigma, now


def known_at_start(model: Model, log: LogState, values: Values) -> Gaussian:
    """Return what is known at the start of a log, about its present values, as `Swept.end`.

    L and v are the log's momentum, what walks has its prior, and joints, attitude and centre of
    mass are open; or what its past tells.
    """
    model = model.of_log(log.name)
    if log.past is not None:
        return past_of(model, log, values)
    n, places = boundary_size(model, log), model.places
    rows = np.zeros((n, n + sum(u.size for u in model.table) + 1))
    sigma = np.full(n, OPEN)
    if log.noise.slow_size:
        sigma[-log.noise.slow_size :] = log.noise.slow_sigma
        rows[-log.noise.slow_size :, -1] = -log.states[0].slow / log.noise.slow_sigma
    sigma[6:12] = EXACT * np.repeat([model.L_sigma, FASTEST_DRIFT], 3)
    rows[:, :n] = np.diag(1 / sigma)
    rows[6:12, n + places[MOMENTUM].start :][:, :6] = -np.diag(1 / sigma[6:12])
    walking = model.walking_columns
    first = np.zeros((len(walking), rows.shape[1]))
    first[np.arange(len(walking)), n + walking] = 1.0
    first[:, -1] = -first_values(model, log, values)
    sizes = {BOUNDARY: n, **{u.key(log.name): u.size for u in model.table}}
    return Gaussian.of_rows(sizes, np.vstack([rows, first]))


def back(model: Model, log: LogState, swept: Swept, step: Values, share: float = 1.0) -> LogState:
    """Return the log after a step of its own, the hardware's and the target's unknowns.

    Args:
        model: the unknowns.
        log: before the step.
        swept: its linearization.
        step: of all unknowns, by name.
        share: of the step that is taken.

    """
    model = model.of_log(log.name)
    n, x = boundary_size(model, log), swept.step(step)
    slow, k = slice(n - log.noise.slow_size, n), len(log.states)
    slow_at_end = log.slow_at_end + share * x[slow]
    link, states = log.states[-1].link, list[BlockState]()
    for each in reversed(swept.eliminations):
        if isinstance(each, Change):
            u = each.solved(x)
            x[each.columns] -= u
            link = _link_after(model, log, each, u, share)
            continue
        k -= 1
        state, part, whole = log.states[k], each.model, each.solved(x)
        taken, forces = share * whole, state.forces.copy()
        for force in part.motion.white:
            forces[force.rows] += taken[part.columns[force.name]]
        x[:n] = whole[part.at_start]
        after = replace(
            state,
            joints=state.joints.moved(taken[part.columns["joints"]]),
            forces=forces,
            slow=state.slow + share * x[slow],
            start=jumped(log.starts[k], share * x[:12]),
            link=link,
        )
        states.append(after)
        link = log.states[k - 1].link
    return replace(log, states=tuple(reversed(states)), slow_at_end=slow_at_end)


def _link_after(model: Model, log: LogState, change: Change, u: Array, share: float) -> Link:
    """Return the link at the end of a block after a share of the step u of what changes there."""
    link, w = log.links[change.block], len(model.walking_columns)
    link = replace(link, walk=link.walk + share * u[:w])
    if len(u) == w:
        return link
    jump = (change.now + u)[w : w + 12]
    # λ = u/σ²
    return replace(link, pull=jump / link_sigma(model, log.links[change.block]) ** 2)


def marginals(
    model: Model, log: LogState, swept: Swept, posterior: Gaussian
) -> Iterator[tuple[int, BlockModel, Array, Array]]:
    """Yield number and model of each block, from the last to the first, with its marginal.

    That is the mean (n,) of the steps of all columns, and a root (n, ...) of their covariance.

    Args:
        model: the unknowns.
        log: the log.
        swept: its linearization.
        posterior: what is known at its end, of all entries that `Swept.end` has, by all rows.

    """
    for k, each, mean, root in _backward(log, swept, posterior):
        if isinstance(each, EndedBlock):
            yield k, each.model, mean, root


def walked(
    model: Model, log: LogState, swept: Swept, posterior: Gaussian
) -> dict[str, tuple[float, float]]:
    """Return of each unknown that walks χ² of its smoothed steps, and what it is on average.

    A step has the prior N(0, 1) and, smoothed, the covariance P. The mean of what is known of it
    then has the covariance 1 − P: the part of the step that the samples show.

    Args:
        model, log, swept, posterior: see `marginals`.

    """
    model = model.of_log(log.name)
    w = len(model.walking_columns)
    squares, shown = np.zeros(w), np.zeros(w)
    for k, each, mean, root in _backward(log, swept, posterior):
        if isinstance(each, Change):
            sigma = model.walking_sigma * np.sqrt(log.interval(k))
            # Σ (u/σ)², and Σ (1 − P/σ²)
            squares += ((log.links[k].walk + mean[:w]) / sigma) ** 2
            shown += 1 - np.sum(root[:w] ** 2, axis=1) / sigma**2
    places = places_of({unknown.name: unknown.size for unknown in model.walking})
    return {n: (float(squares[p].sum()), float(shown[p].sum())) for n, p in places.items()}


def _backward(
    log: LogState, swept: Swept, posterior: Gaussian
) -> Iterator[tuple[int, Change | EndedBlock, Array, Array]]:
    """Yield number, step, mean and a root of the covariance of what ends with each step.

    That is the change, or all columns of the block's model.
    """
    root = solve_triangular(posterior.R, np.eye(posterior.size))
    x, k = root @ posterior.z, len(log.blocks)
    for each in reversed(swept.eliminations):
        if isinstance(each, Change):
            u = each.solved(x)
            yield each.block, each, u, np.column_stack([each.unit, each.rows[:, :-1] @ root])
            x[each.columns] -= u
            root = each.spread(root)
            continue
        k -= 1
        whole, spread = each.solved(x), each.spread(root)
        yield k, each, whole, spread[: len(whole)]
        x[: len(each.model.at_start)] = whole[each.model.at_start]
        root = triangle(each.at_start(spread).T).T


def boundary_size(model: Model, log: LogState) -> int:
    """Return the number of entries at a boundary: attitude, p, L, v, joints, slow noise."""
    return 12 + ORDER * model.joint_count + log.noise.slow_size
