"""One sweep through a log: the rows of all blocks, without what ends with each block.

`roll` predicts the samples of a log at given values. `sweep` goes through its blocks: the rows of a
block are those known at its start, its links and its samples; QR eliminates what ends with it, and
what remains is known at its end. The result is a Gaussian of the log's, the hardware's and the
target's unknowns, about the present values. `back` goes the other way: given a step of those, it
finds the steps of everything else, so that the next roll starts from smoothed values. Together they
are one Gauss-Newton step of all unknowns at once.

Source: Bierman 1977, ch. V and X (square-root information filter and smoother).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import triangle
from cpid_drake.estimation.likelihood.effects import with_changes
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion import Trajectory
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
    """A change of some entries at the end of a block, eliminated: z − X (all entries after it)."""

    columns: NDArray[np.intp]
    rows: NDArray[np.float64]  # [X | z]
    now: NDArray[np.float64]
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
    rows: NDArray[np.float64]
    end: NDArray[np.float64]
    absorbed: dict[str, float]

    def solved(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
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
    at = dict[int, Gaussian]()
    known = known_at_start(model, log, values) if before is None else before
    boundary = np.arange(boundary_size(model))
    walking, pose, joints = len(boundary) + model.walking_columns, boundary[:12], boundary[12:]
    steps = list[_Change | _Block]()
    motions = [part.motion for part in rolled.models]
    bodies = model.known_bodies, values.get(BODIES)
    for k, trajectory in enumerate(with_changes(motions, rolled.trajectories, *bodies)):
        block, known = _eliminated(model, log, k, rolled, trajectory, known, forward_only)
        steps += [] if block is None else [block]
        at |= {k: known} if k in stops else {}
        if k in carry:
            known = linked(known, f"link {k}|{log.name}", log.link(model, k), rolled.links[k])
        if k < len(log.walks):
            columns, now = walking, log.walks[k]
            sigma = model.walking_sigma * np.sqrt(log.step(k))
            if k < len(rolled.links) and k not in carry:
                columns, now = np.append(columns, pose), np.append(now, rolled.links[k])
                sigma = np.append(sigma, log.link(model, k))
            if log.gaps[k]:
                columns, now = np.append(columns, joints), np.append(now, np.zeros(len(joints)))
                sigma = np.append(sigma, np.full(len(joints), OPEN))
            known, rows = changed(known, columns, sigma, now)
            steps.append(_Change(columns, rows, now, k))
    return Swept(known, steps, at)


def known_at_start(model: Model, log: LogState, values: Values) -> Gaussian:
    """Return what is known at the start of a log, about its present values, as `Swept.end`.

    L and v are the log's momentum, what walks has its prior, and joints, attitude and centre of
    mass are open; or what its past tells.
    """
    if log.past is not None:
        return past_of(model, log, values)
    n, places = boundary_size(model), model.places
    rows = np.zeros((n, n + sum(u.size for u in model.table) + 1))
    sigma = np.full(n, OPEN)
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
    g = np.concatenate([step[name] for name in swept.end.places if name != BOUNDARY])
    n, R, z = boundary_size(model), swept.end.R, swept.end.z
    x = solve_triangular(R[:n, :n], z[:n] - R[:n, n:] @ g)
    x = np.concatenate([x, g])
    forces, joints = list(log.forces), list(log.joints)
    walks, starts, pulls = list(log.walks), list(log.starts), list(log.pulls)
    k = len(log.blocks)
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
    return replace(
        log,
        starts=tuple(starts),
        forces=tuple(forces),
        joints=tuple(joints),
        walks=tuple(walks),
        pulls=tuple(pulls),
    )


def _eliminated(
    model: Model,
    log: LogState,
    k: int,
    rolled: Rolled,
    trajectory: Trajectory,
    before: Gaussian,
    forward_only: bool,
) -> tuple[_Block | None, Gaussian]:
    """Return block k without what ends with it, if it is needed, and what is known at its end."""
    part, carried = rolled.models[k], before.rows
    J, end = part.jacobian(trajectory)
    links, rest = part.joint_rows()
    psi, by_psi = part.columns[PSI], rolled.by_psi
    J[:, psi], end[:, psi] = J[:, psi] @ by_psi, end[:, psi] @ by_psi
    residuals = rolled.residuals[k]
    r = [log.weighted(k, name, each).ravel() for name, each in residuals.items()]
    w = [np.repeat(log.scale(k, n, len(e)), e.shape[1]) for n, e in residuals.items()]
    J = np.concatenate([np.empty(0), *w])[:, None] * J
    n, known, total = boundary_size(model), J.shape[1], carried.shape[1] - 1
    first = psi.start - model.constants.size  # of the unknowns that outlive the block
    outside = n + known - first  # columns of carried that are no columns of the block's model
    rows = np.zeros((len(carried) + len(rest) + len(J), known + total - outside + 1))
    a, b = len(carried), len(carried) + len(rest)
    rows[:a, part.at_start] = carried[:, :n]
    rows[:a, first:] = carried[:, n:]
    rows[a:b, :known], rows[a:b, -1] = links, rest
    rows[b:, :known], rows[b:, -1] = J, np.concatenate([np.empty(0), *r])
    # Replace attitude, centre of mass and momentum at the start by those at the end.
    by_end = rows[:, :12] @ np.linalg.inv(end[:, :12])
    rows[:, :known] -= by_end @ end
    rows[:, :12] = by_end
    ends = part.at_end
    keep = np.concatenate([ends, np.arange(first, rows.shape[1] - 1)])
    gone = np.setdiff1d(np.arange(first), ends)
    T = triangle(rows[:, np.concatenate([gone, keep, [rows.shape[1] - 1]])])
    g, kept = len(gone), len(keep)
    rho2 = before.rho2 + float(T[-1, -1]) ** 2
    after = Gaussian.of_triangle(before.sizes, T[g : g + kept, g:], rho2)
    if forward_only:
        return None, after
    leverage = np.sum(solve_triangular(T[:g, :g], rows[b:, gone].T, trans="T") ** 2, axis=0)
    ends = np.cumsum([each.size for each in residuals.values()])
    own = {n: float(x.sum()) for n, x in zip(residuals, np.split(leverage, ends))}
    of_gone = solve_triangular(T[:g, :g], T[:g, g:])
    return _Block(part, gone, keep, of_gone, end, own), after


def changed(
    known: Gaussian,
    columns: NDArray[np.intp],
    sigma: NDArray[np.float64],
    now: NDArray[np.float64],
) -> tuple[Gaussian, NDArray[np.float64]]:
    """Return what is known after a change u ~ N(0, σ²) of some entries.

    u has the present value `now`. The second result is [X | z], with u = z − X (entries).
    """
    m, n = len(columns), known.size
    if not m:
        return known, np.zeros((0, n + 1))
    rows = np.zeros((m + n, m + n + 1))
    rows[:m, :m], rows[:m, -1] = np.diag(1 / sigma), -now / sigma
    rows[m:, :m], rows[m:, m:-1], rows[m:, -1] = -known.R[:, columns], known.R, known.z
    T = triangle(rows)
    of_change = solve_triangular(T[:m, :m], T[:m, m:])
    return Gaussian.of_triangle(known.sizes, T[m:-1, m:], known.rho2), of_change


def linked(
    known: Gaussian, name: str, sigma: NDArray[np.float64], now: NDArray[np.float64]
) -> Gaussian:
    """Return what is known after a change (12,) of attitude, p, L and v, a further unknown."""
    n = known.size
    rows = np.zeros((12 + n, n + 13))
    rows[:12, n:-1], rows[:12, -1] = np.diag(1 / sigma), -now / sigma
    rows[12:, :n], rows[12:, n:-1], rows[12:, -1] = known.R, -known.R[:, :12], known.z
    return Gaussian.of_rows({**known.sizes, name: 12}, rows, known.rho2)


def boundary_size(model: Model) -> int:
    """Return the number of entries at a boundary: attitude, p, L, v, joints."""
    return 12 + ORDER * model.joint_count
