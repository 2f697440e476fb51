"""One sweep through a log: the rows of all blocks, without what ends with each block.

`roll` predicts the samples of a log at given values. `sweep` goes through its blocks: the rows of a
block are those known at its start, its links and its samples; QR eliminates what ends with it, and
what remains is known at its end. The result is a Gaussian of the log's, the hardware's and the
target's unknowns, about the present values. `back` goes the other way: given a step of those, it
finds the steps of everything else, so that the next roll starts from smoothed values. Together they
are one Gauss-Newton step of all unknowns at once.

Source: Bierman 1977, ch. V and X (square-root information filter and smoother).
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import triangle
from cpid_drake.estimation.likelihood.effects import GyroBias, with_joint_changes
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion import Trajectory, TrajectoryState
from cpid_drake.estimation.likelihood.priors import FASTEST_DRIFT
from cpid_drake.estimation.likelihood.white_effects import White
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, first_values, jumped
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model

EXACT = 1e-9
"""σ of what is conserved, as a share of the σ of an unknown momentum."""

START = {"attitude": np.pi, "p_Wcm": 1e3}
"""σ of attitude [rad] and centre of mass [m] before the first sample."""


@dataclass(frozen=True, eq=False)
class _Change:
    """A change u of some entries at a boundary, eliminated: rows [u | all entries | right side]."""

    columns: NDArray[np.intp]
    rows: NDArray[np.float64]
    kind: str
    block: int

    def solved(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return u, given all entries x after the change."""
        m = len(self.columns)
        rows = self.rows
        return np.asarray(solve_triangular(rows[:, :m], rows[:, -1] - rows[:, m:-1] @ x))


@dataclass(frozen=True, eq=False)
class _Block:
    """A block, eliminated: rows of what ended with it, and how its end depends on its start."""

    model: BlockModel
    start: TrajectoryState
    gone: NDArray[np.intp]
    keep: NDArray[np.intp]
    rows: NDArray[np.float64]
    end: NDArray[np.float64]

    def solved(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the steps of all columns of the block's model, given those at its end."""
        g = len(self.gone)
        y = np.zeros(g + len(self.keep))
        rest = self.rows[:, -1] - self.rows[:, g:-1] @ x
        y[self.gone], y[self.keep] = solve_triangular(self.rows[:, :g], rest), x
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
        gaussian: of the log's, the hardware's and the target's unknowns, about the present values.
        boundary: (n, n + …) rows of what is known at the end of the last block.
        steps: what `back` needs, in the order of the sweep.
        absorbed: how many of a sensor's residuals the blocks' own unknowns absorb, by sensor.

    """

    gaussian: Gaussian
    boundary: NDArray[np.float64]
    steps: list[_Change | _Block]
    absorbed: dict[str, float]

    @property
    def rows(self) -> NDArray[np.float64]:
        """Rows of all that is known at the end of the last block."""
        n, found = len(self.boundary), self.gaussian
        below = np.column_stack([np.zeros((found.size, n)), found.R, found.z])
        return np.vstack([self.boundary, below])


def sweep(
    model: Model,
    log: LogState,
    rolled: Rolled,
    values: Values,
    *,
    carry: Collection[int] = (),
    before: NDArray[np.float64] | None = None,
) -> Swept:
    """Linearize a log about given values.

    Args:
        model: the unknowns.
        log: the log.
        rolled: its prediction at these values.
        values: the values.
        carry: the open links whose changes remain unknowns of the result, "link k".
        before: rows of what is known at the start; default: the priors of a log's start.

    """
    carried = known_at_start(model, log, values) if before is None else before
    n = boundary_size(model)
    walking, walk_sigma = model.walking_columns, model.walking_sigma
    steps: list[_Change | _Block] = []
    rho2, links, absorbed = 0.0, list[int](), dict[str, float]()

    def opened(
        columns: NDArray[np.intp], sigma: NDArray[np.float64], now: NDArray[np.float64], kind: str
    ) -> NDArray[np.float64]:
        T = with_change(carried, columns, sigma, now)
        m = len(columns)
        steps.append(_Change(columns, T[:m], kind, k))
        return T[m : m + len(carried), m:]

    motions = [part.motion for part in rolled.models]
    for k, trajectory in enumerate(with_joint_changes(motions, rolled.trajectories)):
        block, carried, rest, own = _eliminated(model, log, k, rolled, trajectory, carried)
        steps.append(block)
        rho2 += rest
        absorbed |= {name: absorbed.get(name, 0.0) + value for name, value in own.items()}
        if k < len(log.walks) and len(walking):
            sigma = walk_sigma * np.sqrt(log.blocks[k].length)
            carried = opened(n + walking, sigma, log.walks[k], "walk")
        if k in log.links and k in carry:
            T = with_change(carried, np.arange(12), log.links[k], log.jumps[k], is_kept=True)
            carried, rest = T[:-1], T[-1, -1]
            rho2 += float(rest) ** 2
            links.append(k)
        elif k in log.links:
            carried = opened(np.arange(12), log.links[k], log.jumps[k], "jump")
    sizes = {u.key(log.name): u.size for u in model.table}
    sizes |= {f"link {k}|{log.name}": 12 for k in links}
    gaussian = Gaussian.of_triangle(sizes, carried[n:, n:], rho2)
    return Swept(gaussian, carried[:n], steps, absorbed)


def known_at_start(model: Model, log: LogState, values: Values) -> NDArray[np.float64]:
    """Return the rows of what is known at the start of a log, about its present values.

    L and v are the log's momentum, the biases and what walks have their priors, and joints,
    attitude and centre of mass are open.
    """
    n, places = boundary_size(model), model.places
    rows = np.zeros((n, n + sum(u.size for u in model.table) + 1))
    sigma = np.full(n, 1e6)
    sigma[:3], sigma[3:6] = START["attitude"], START["p_Wcm"]
    sigma[6:12] = EXACT * np.repeat([model.L_sigma, FASTEST_DRIFT], 3)
    bias = slice(12, 12 + 3 * len(model.gyros))
    sigma[bias] = np.repeat(model.bias_sigma, 3)
    rows[:, :n] = np.diag(1 / sigma)
    rows[6:12, n + places[MOMENTUM].start :][:, :6] = -np.diag(1 / sigma[6:12])
    rows[bias, -1] = -log.bias[0][model.first_nodes].ravel() / sigma[bias]
    walking = model.walking_columns
    first = np.zeros((len(walking), rows.shape[1]))
    first[np.arange(len(walking)), n + walking] = 1.0
    first[:, -1] = -first_values(model, log, values)
    return np.vstack([rows, first])


def back(model: Model, log: LogState, swept: Swept, step: Values) -> LogState:
    """Return the log after a step of its own, the hardware's and the target's unknowns.

    Args:
        model: the unknowns.
        log: before the step.
        swept: its linearization.
        step: of all unknowns, by name.

    """
    g = np.concatenate([step[name] for name in swept.gaussian.places])
    n, tail = boundary_size(model), swept.boundary
    x = solve_triangular(tail[:, :n], tail[:, -1] - tail[:, n:-1] @ g)
    x = np.concatenate([x, g])
    bias, forces, joints = list(log.bias), list(log.forces), list(log.joints)
    walks, jumps, aims = list(log.walks), {**log.jumps}, dict[int, TrajectoryState]()
    k = len(log.blocks)
    for each in reversed(swept.steps):
        if isinstance(each, _Change):
            u = each.solved(x)
            x[each.columns] -= u
            if each.kind == "walk":
                walks[each.block] = walks[each.block] + u
            elif each.kind == "jump":
                jumps[each.block] = jumps[each.block] + u
            continue
        k -= 1
        s = each.solved(x)
        part, bias[k], forces[k] = each.model, bias[k].copy(), forces[k].copy()
        for effect in part.effects:
            if isinstance(effect, GyroBias):
                bias[k][effect.rows] += s[part.columns[effect.name]].reshape(-1, 3)
            elif isinstance(effect, White):
                forces[k][effect.force.rows] += s[part.columns[effect.name]]
        joints[k] = joints[k].moved(s[part.columns["joints"]])
        x[:n] = s[part.at_start[:n]]
        aims[k] = jumped(each.start, x[:12])
    assert log.start is not None
    return replace(
        log,
        start=jumped(log.start, x[:12]),
        bias=tuple(bias),
        forces=tuple(forces),
        joints=tuple(joints),
        walks=tuple(walks),
        jumps=jumps,
        aims=aims,
    )


def _eliminated(
    model: Model,
    log: LogState,
    k: int,
    rolled: Rolled,
    trajectory: Trajectory,
    carried: NDArray[np.float64],
) -> tuple[_Block, NDArray[np.float64], float, dict[str, float]]:
    """Return block k without what ends with it, the rows known at its end, and what remains.

    The last value is how many residuals of each sensor the unknowns absorb that end with the block.
    """
    part = rolled.models[k]
    J, end = part.jacobian(trajectory)
    links, rest = part.links(trajectory.state)
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
    rows[:a, part.at_start[:n]] = carried[:, :n]
    rows[:a, first:] = carried[:, n:]
    rows[a:b, :known], rows[a:b, -1] = links, rest
    rows[b:, :known], rows[b:, -1] = J, np.concatenate([np.empty(0), *r])
    # Replace attitude, centre of mass and momentum at the start by those at the end.
    by_end = rows[:, :12] @ np.linalg.inv(end[:, :12])
    rows[:, :known] -= by_end @ end
    rows[:, :12] = by_end
    ends = part.at_end[:n]
    keep = np.concatenate([ends, np.arange(first, rows.shape[1] - 1)])
    gone = np.setdiff1d(np.arange(first), ends)
    T = triangle(rows[:, np.concatenate([gone, keep, [rows.shape[1] - 1]])])
    g, kept = len(gone), len(keep)
    leverage = np.sum(solve_triangular(T[:g, :g], rows[b:, gone].T, trans="T") ** 2, axis=0)
    ends = np.cumsum([each.size for each in residuals.values()])
    own = {n: float(x.sum()) for n, x in zip(residuals, np.split(leverage, ends))}
    block = _Block(part, trajectory.state, gone, keep, T[:g].copy(), end)
    return block, T[g : g + kept, g:], float(np.sum(T[g + kept :, -1] ** 2)), own


def with_change(
    carried: NDArray[np.float64],
    columns: NDArray[np.intp],
    sigma: NDArray[np.float64],
    now: NDArray[np.float64],
    *,
    is_kept: bool = False,
) -> NDArray[np.float64]:
    """Return the triangle [u | entries | right side] if some entries change by u ~ N(0, σ²).

    If u is kept as a further unknown, it is [entries | u | right side].
    """
    m, n = len(columns), carried.shape[1] - 1
    rows = np.zeros((m + len(carried), m + n + 1))
    u, rest = (slice(n, n + m), slice(0, n)) if is_kept else (slice(0, m), slice(m, m + n))
    rows[:m, u], rows[:m, -1] = np.diag(1 / sigma), -now / sigma
    rows[m:, u], rows[m:, rest], rows[m:, -1] = (
        -carried[:, columns],
        carried[:, :-1],
        carried[:, -1],
    )
    return triangle(rows)


def boundary_size(model: Model) -> int:
    """Return the number of entries at a boundary: attitude, p, L, v, biases, joints."""
    return 12 + 3 * len(model.gyros) + ORDER * model.joint_count
