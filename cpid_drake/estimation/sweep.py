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
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import triangle, updated_information
from cpid_drake.estimation.likelihood.effect_terms import with_changes
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, first_values, jumped, past_of
from cpid_drake.estimation.unknowns import BODIES, FASTEST_DRIFT, MOMENTUM, PSI, Model

EXACT = 1e-9
"""σ of what is conserved, or held while the rest is fitted, as a share of its plausible size."""

OPEN = 1e6
"""σ of attitude, centre of mass and joints before the first sample [rad, m]."""

BOUNDARY = "boundary"
"""Name of what is at the end of a block: attitude, p, L, v and joints."""


@dataclass(frozen=True, eq=False)
class _Change:
    """A change of some entries at the end of a block, eliminated; see `changed`."""

    columns: NDArray[np.intp]
    rows: Array  # [X | z]
    now: Array
    block: int


@dataclass(frozen=True, eq=False)
class _Block:
    """A block, eliminated: what ended with it is z − X keep, with rows [X | z].

    `end` is how its end depends on its start, and `absorbed` how many of a sensor's residuals the
    unknowns absorb that end with the block.
    """

    model: BlockModel
    gone: NDArray[np.intp]
    keep: NDArray[np.intp]
    rows: Array
    end: Array
    absorbed: dict[str, float]

    @classmethod
    def of(
        cls, part: BlockModel, residuals: Mapping[str, Array], own: BlockRows, T: Array
    ) -> "_Block":
        """Return a block from its rows and its triangle."""
        first, g = part.kept[0], len(own.gone)
        keep = np.concatenate(
            [part.at_end, np.arange(first, first + len(T) - 1 - g - len(part.at_end))]
        )
        start = np.linalg.solve(own.end[:, :12], own.end[:, own.gone])
        of_gone = own.samples[:, 12 : 12 + g] - own.samples[:, :12] @ start
        inverse = solve_triangular(T[:g, :g], np.eye(g))
        leverage = np.sum((of_gone @ inverse) ** 2, axis=1)
        ends = np.cumsum([each.size for each in residuals.values()])
        absorbed = {n: float(x.sum()) for n, x in zip(residuals, np.split(leverage, ends))}
        return cls(part, own.gone, keep, inverse @ T[:g, g:], own.end, absorbed)

    def solved(self, x: Array) -> Array:
        """Return the steps of all columns of the block's model, given those at its end."""
        g = len(self.gone)
        y = np.zeros(g + len(self.keep))
        y[self.gone], y[self.keep] = self.rows[:, -1] - self.rows[:, :-1] @ x, x
        step = y[: self.end.shape[1]]
        first = step[:12].copy()
        step[:12] = 0.0
        step[:12] = np.linalg.solve(self.end[:, :12], first - self.end @ step)
        step[self.model.held] = 0.0
        return step


@dataclass(frozen=True, eq=False)
class Swept:
    """A linearized log.

    Attributes:
        end: of what is at the end of the last block, `BOUNDARY`, and then of the log's, the
            hardware's and the target's unknowns, about the present values.
        steps: what `back` needs, in the order of the sweep.
        stops: as `end`, at the ends of some blocks.

    """

    end: Gaussian
    steps: list[_Change | _Block]
    stops: Mapping[int, Gaussian] = field(default_factory=dict)

    @property
    def absorbed(self) -> dict[str, float]:
        """How many of a sensor's residuals the blocks' own unknowns absorb, by sensor."""
        found = [step.absorbed for step in self.steps if isinstance(step, _Block)]
        return {n: sum(each.get(n, 0.0) for each in found) for n in set().union(*found)}

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
        carry: the blocks whose changes at the end remain unknowns of the result, "link k".
        before: what is known at the start, as `Swept.end`; default: the priors of a log's start,
            or its past.
        forward_only: leave out what `back` needs: a quarter of a megabyte a block.
        stops: the blocks at whose ends the result also has what is known.

    """
    model, at = model.of_log(log.name), dict[int, Gaussian]()
    known = known_at_start(model, log, values) if before is None else before
    steps = list[_Change | _Block]()
    linear = linearized(model, log, rolled, values)
    for k, own in enumerate(linear):
        part = rolled.models[k].with_slow(log.slow_size)
        known, T = eliminated(part, own, known)
        if not forward_only:
            steps.append(_Block.of(part, rolled.residuals[k], own, T))
        at |= {k: known} if k in stops else {}
        if k in carry:
            known = linked(known, f"link {k}|{log.name}", log.link(model, k), rolled.links[k])
        if change := change_at_end(model, log, rolled, k, is_carried=k in carry):
            known, rows = changed(known, *change)
            columns, _, now = change
            steps.append(_Change(columns, rows, now, k))
    return Swept(known, steps, at)


def change_at_end(
    model: Model, log: LogState, rolled: Rolled, k: int, *, is_carried: bool = False
) -> tuple[NDArray[np.intp], Array, Array] | None:
    """Return the columns that change at the end of block k, σ and present values; None if none.

    One that is carried is no change.
    """
    if k >= len(log.walks):
        return None
    n = boundary_size(model, log)
    columns, now = n + model.walking_columns, log.walks[k]
    sigma = model.walking_sigma * np.sqrt(log.step(k))
    if k < len(rolled.links) and not is_carried:
        columns, now = np.append(columns, np.arange(12)), np.append(now, rolled.links[k])
        sigma = np.append(sigma, log.link(model, k))
    if log.gaps[k]:
        joints = np.arange(12, n - log.slow_size)
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
    if log.slow_size:
        sigma[-log.slow_size :] = log.slow_sigma
        rows[-log.slow_size :, -1] = -log.edges[0] / log.slow_sigma
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
    g = np.concatenate([step[name] for name in swept.end.places if name != BOUNDARY])
    n, R, z = boundary_size(model, log), swept.end.R, swept.end.z
    edges, before = list(log.edges), n - log.slow_size
    x = solve_triangular(R[:n, :n], z[:n] - R[:n, n:] @ g)
    x = np.concatenate([x, g])
    forces, joints = list(log.forces), list(log.joints)
    walks, starts, pulls = list(log.walks), list(log.starts), list(log.pulls)
    k = len(log.blocks)
    edges[k] = edges[k] + share * x[before:n]
    for each in reversed(swept.steps):
        if isinstance(each, _Change):
            u = each.rows[:, -1] - each.rows[:, :-1] @ x
            x[each.columns] -= u
            w = len(model.walking_columns)
            walks[each.block] = walks[each.block] + share * u[:w]
            if len(u) > w:
                change = (each.now + u)[w : w + 12]
                pulls[each.block] = change / log.link(model, each.block) ** 2
            continue
        k -= 1
        whole = each.solved(x)
        s = share * whole
        part, forces[k] = each.model, forces[k].copy()
        for force in part.motion.white:
            forces[k][force.rows] += s[part.columns[force.name]]
        joints[k] = joints[k].moved(s[part.columns["joints"]])
        x[:n] = whole[part.at_start]
        starts[k] = jumped(starts[k], share * x[:12])
        edges[k] = edges[k] + share * x[before:n]
    return replace(
        log,
        starts=tuple(starts),
        forces=tuple(forces),
        joints=tuple(joints),
        walks=tuple(walks),
        pulls=tuple(pulls),
        edges=tuple(edges),
    )


def linearized(model: Model, log: LogState, rolled: Rolled, values: Values) -> Iterator[BlockRows]:
    """Yield the rows of all blocks."""
    for k, linear in enumerate(derivatives(model, log, rolled, values)):
        part, rest, rows = rolled.models[k], rolled.residuals[k], rolled.rows.get(rolled.models[k])
        whitening, slow = log.whitenings(k, rest), log.slow_at(k)
        if rows is None or not rows.is_for(whitening, slow):
            wide = part.with_slow(log.slow_size)
            rows = BlockRows.of(wide, linear, rest, whitening, log.slow, slow)
            rolled.rows[part] = rows
        yield rows


def derivatives(
    model: Model, log: LogState, rolled: Rolled, values: Values
) -> Iterator[tuple[Array, Array]]:
    """Yield the derivatives of samples and end of all blocks, without slow noise."""
    new = [k for k, part in enumerate(rolled.models) if part not in rolled.linear]
    motions = [rolled.models[k].motion for k in new]
    at = [rolled.trajectories[k] for k in new]
    trajectories = with_changes(motions, at, model.known_bodies, values.get(BODIES))
    for part in rolled.models:
        if part not in rolled.linear:
            J, end = part.jacobian(next(trajectories))
            psi = part.columns[PSI]
            J[:, psi], end[:, psi] = J[:, psi] @ rolled.by_psi, end[:, psi] @ rolled.by_psi
            rolled.linear[part] = J, end
        yield rolled.linear[part]


def eliminated(part: BlockModel, own: BlockRows, before: Gaussian) -> tuple[Gaussian, Array]:
    """Return what is known at the end of a block, and the triangle [R | z] without its start.

    With the start x₀ (attitude, p, L, v) and all other columns y, the end is x₁ = E₀ x₀ + E y. So a
    row A₀ x₀ + A y = b is

        A₀E₀⁻¹ x₁ + (A − A₀E₀⁻¹E) y = b,

    and QR eliminates what ends with the block. Only the first rows of both triangles contain x₀ or
    what ends: the others remain a triangle.
    """
    n, gone = len(own.order), len(own.gone)
    size = gone + before.size
    # The result's columns are: what ends, x₁, the joints at the end, and the table; then b.
    of_block = np.r_[:gone, gone + 12 : n, size]  # places of the block's y and b
    joints = of_block[np.argsort(own.order)[part.at_start[12:]] - 12]  # those at its start end
    of_before = np.r_[:12, 12 + joints, 12 + gone + len(part.at_end) : size + 13]  # after x₀
    # [A₀ | A | b]: the first rows of what is known before, and of the block's own.
    known, last, first = before.rows, n - gone, gone + 12
    rows = np.zeros((last + first, 12 + size + 1))
    rows[:last, of_before] = known[:last]
    rows[last:, :12], rows[last:, 12 + of_block] = own.T[:first, :12], own.T[:first, 12:]
    # A₀E₀⁻¹ x₁ + (A − A₀E₀⁻¹E) y = b
    by_end = rows[:, :12] @ np.linalg.inv(own.end[:, :12])
    rows[:, 12 + of_block[:-1]] -= by_end @ own.end[:, own.order[12:]]
    rows[:, 12 + gone : 12 + first] = by_end
    T = triangle(rows[:, 12:])
    # The other rows contain neither.
    others = np.zeros((size + 1, size + 1), order="F")
    others[np.ix_(of_block[gone:], of_block[gone:])] = own.T[first:, first:]
    others[n:size, n:] = known[last:, last:]
    T[first:, first:] = updated_information(others[first:, first:], T[first:, first:])
    rho2 = before.rho2 + float(T[-1, -1]) ** 2
    volume = before.volume + float(np.sum(np.log(np.abs(np.diag(T)[:gone]))))
    return replace(before, R=T[gone:-1, gone:-1], z=T[gone:-1, -1], rho2=rho2, volume=volume), T


def changed(
    known: Gaussian, columns: NDArray[np.intp], sigma: Array, now: Array
) -> tuple[Gaussian, Array]:
    """Return what is known after a change u ~ N(0, σ²) of some entries, which is eliminated.

    u has the present value `now`. The entries before are those after it less u: rows R x = z become
    R x − R_u u = z, and (now + u)/σ = 0 is one more. The second result is [X | z] of u = z − X x.
    """
    m, n = len(columns), known.size
    if not m:
        return known, np.zeros((0, n + 1))
    before, p = known.rows, 1 + int(columns.max())  # the first rows contain them
    rows = np.zeros((m + p, m + n + 1))
    rows[:m, :m], rows[:m, -1] = np.diag(1 / sigma), -now / sigma
    rows[m:, :m], rows[m:, m:] = -before[:p, columns], before[:p]
    T = triangle(rows)
    before[:p] = T[m : m + p, m:]
    of_change = solve_triangular(T[:m, :m], T[:m, m:])
    volume = known.volume + float(np.sum(np.log(np.abs(np.diag(T)[:m]))))
    return replace(known, R=before[:, :-1], z=before[:, -1], volume=volume), of_change


def linked(known: Gaussian, name: str, sigma: Array, now: Array) -> Gaussian:
    """Return what is known after a change u (12,) of attitude, p, L and v, a further unknown.

    See `changed`. These are the first columns, and u is last: the rows remain a triangle.
    """
    n = known.size
    T = np.zeros((n + 12, n + 13))
    T[:n, :n], T[:n, n:-1], T[:n, -1] = known.R, -known.R[:, :12], known.z
    T[n:, n:-1], T[n:, -1] = np.diag(1 / sigma), -now / sigma
    return Gaussian.of_triangle({**known.sizes, name: 12}, T, known.rho2)


def boundary_size(model: Model, log: LogState) -> int:
    """Return the number of entries at a boundary: attitude, p, L, v, joints, slow noise."""
    return 12 + ORDER * model.joint_count + log.slow_size
