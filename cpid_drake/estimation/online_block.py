"""One block of the online fit: from what is known at its start to what is known at its end."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.fit import CLOSE, weights_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import joint_part, tracked
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.links import Link, judged, linked, with_links
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, roll
from cpid_drake.estimation.sweep import Swept, back, boundary_size, sweep, with_change
from cpid_drake.estimation.unknowns import Model

NAME = "online"
"""Name of the log of an online fit."""

BOUNDARY = "boundary"
"""Name of what is at the end of the last block: attitude, p, L, v, biases and joints."""

MOST_LINEARIZATIONS = 6
"""A block is linearized so many times at most, and a step to an impossible target halved."""

UNLIKELY = 6.0
"""Noise does not explain a block whose χ² is above its expectation by so many σ."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known at the end of the last block.

    Attributes:
        values: of all unknowns, about which everything is linear.
        log: the last block, with its bias and noise; `start` is the state at its end.
        gaussian: about what is at the boundary and all unknowns, and of the links themselves.
        links: at the starts of the last blocks.
        track: (J, ORDER, ORDER + 1) rows about the joints, by their own sensors alone.
        about: values of the target and the hardware about which all rows are linear.
        is_lost: whether the base is not known any more, because the joints were not.

    """

    values: Values
    log: LogState
    gaussian: Gaussian
    links: tuple[Link, ...]
    track: NDArray[np.float64]
    about: Values
    is_lost: bool = False


def is_likely(log: LogState, rolled: Rolled) -> bool:
    """Return whether noise explains the samples of a block."""
    rest = [log.weighted(0, name, each) for name, each in rolled.residuals[0].items()]
    count = sum(each.size for each in rest)
    return sum(float(np.sum(r * r)) for r in rest) < count + UNLIKELY * np.sqrt(2 * count)


def solved(
    model: Model, known: Known, block: Block, *, is_judged: bool, is_linked: bool = True
) -> tuple[Known, LogState, Rolled]:
    """Return what is known at the end of a block, and the block at its solution.

    A link at its start is judged, or open.

    It is linearized anew until χ² at the solution is what the last linearization predicts.
    """
    n, gaussian = boundary_size(model), known.gaussian
    walking, sigma = model.walking_columns, model.walking_sigma
    if len(walking):
        gaussian = _changed(gaussian, n + walking, sigma * np.sqrt(block.length))
    links = known.links
    if known.is_lost:
        gaussian = _changed(gaussian, np.arange(12), model.farthest)
    elif is_linked:
        links = (*links, Link(block.start))
        gaussian = linked(model, gaussian, links[-1])
    part, track = tracked(known.track, joint_part(block, model.suite, known.log.smoothness))
    counts = model.last_nodes - model.first_nodes + 1
    bias = np.repeat(known.log.bias[0], counts, axis=0)
    forces = (model.no_forces(block.start, block.end),)
    log = replace(known.log, blocks=(block,), joints=(part,), bias=(bias,), forces=forces)
    values, rolled = known.values, roll(model, log, known.values)
    here = _Boundary.at_start(model, log)
    before = replace(here, joints=known.log.joints[0].coefficients[-ORDER:])
    gaussian = _moved(gaussian, before.step_to(here))
    for _ in range(MOST_LINEARIZATIONS):
        swept = _swept(model, log, _linear(model, known, log, rolled, values), values, gaussian)
        if is_judged:
            links = judged(model, swept.gaussian, links)
        g = _mean(with_links(model, swept.gaussian, links))
        g, better, values, ahead = _stepped(model, log, swept, values, g)
        table = g[: sum(unknown.size for unknown in model.table)]
        there = _Boundary.at_start(model, better)
        gaussian = _moved(gaussian, here.step_to(there), table)
        jumps = np.concatenate([np.zeros(n + len(table)), g[len(table) :]])
        excess = ahead.cost_inside(better) + gaussian.cost(jumps) - swept.gaussian.cost(g)
        ends = [_Boundary.at_end(model, *each) for each in ((log, rolled), (better, ahead))]
        after = _moved(at_end(model, swept), ends[0].step_to(ends[1]), table)
        weighted, is_settled = _weighted(better, ahead)
        log, rolled, here = weighted, ahead, there
        if abs(excess) < CLOSE and is_settled:
            break
    end = rolled.models[0].motion.end(rolled.trajectories[0])
    last = replace(log, start=end, bias=(log.bias[0][model.last_nodes],), weights=({},))
    return Known(values, last, after, links, track, known.about), log, rolled


def _linear(model: Model, known: Known, log: LogState, rolled: Rolled, values: Values) -> Rolled:
    """Return a prediction with the derivatives at the first values of target and hardware.

    What no motion tells, such as where C is in the target, would else seem to be known: derivatives
    at other values in every block contradict each other. Source: Huang, Mourikis and
    Roumeliotis 2010 (first-estimates Jacobians).
    """
    if not any(unknown.scope == "hardware" for unknown in model.table):
        return rolled
    return replace(roll(model, log, values | known.about), residuals=rolled.residuals)


def _stepped(
    model: Model, log: LogState, swept: Swept, values: Values, g: NDArray[np.float64]
) -> tuple[NDArray[np.float64], LogState, Values, Rolled]:
    """Return a step g, or the part of it for which a motion can be predicted, and its end."""
    for _ in range(MOST_LINEARIZATIONS):
        change = {name: g[place] for name, place in swept.gaussian.places.items()}
        better = back(model, log, swept, change)
        there = {name: value + change[name] for name, value in values.items()}
        try:
            return g, better, there, roll(model, better, there)
        except InputError:
            g = g / 2
    raise InputError("no motion can be predicted near what is known")


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
        return cls(log.start, log.bias[0][model.first_nodes], log.joints[0].coefficients[:ORDER])

    @classmethod
    def at_end(cls, model: Model, log: LogState, rolled: Rolled) -> "_Boundary":
        """Return what is at the end of the block of a log."""
        end = rolled.models[0].motion.end(rolled.trajectories[0])
        return cls(end, log.bias[0][model.last_nodes], log.joints[0].coefficients[-ORDER:])

    def step_to(self, other: "_Boundary") -> NDArray[np.float64]:
        """Return the step (n,) to another one."""
        old, new = self.state, other.state
        turn = (new.attitude * old.attitude.inv()).as_rotvec()
        pose = [turn, new.p_Wcm - old.p_Wcm, new.L - old.L, new.v_Wcm - old.v_Wcm]
        joints = (other.joints - self.joints).T
        return np.concatenate([*pose, (other.bias - self.bias).ravel(), joints.ravel()])


def _swept(
    model: Model, log: LogState, rolled: Rolled, values: Values, gaussian: Gaussian
) -> Swept:
    """Return a linearized block after which the links are still unknowns."""
    before = np.column_stack([gaussian.R, gaussian.z])
    swept = sweep(model, log, rolled, values, before=before)
    T = np.column_stack([swept.gaussian.R, swept.gaussian.z])
    sizes = {name: size for name, size in gaussian.sizes.items() if name != BOUNDARY}
    return replace(swept, gaussian=Gaussian.of_triangle(sizes, T, swept.gaussian.rho2))


def at_end(model: Model, swept: Swept) -> Gaussian:
    """Return what is known at the end of a block."""
    sizes = {BOUNDARY: boundary_size(model), **swept.gaussian.sizes}
    return Gaussian.of_triangle(sizes, swept.rows)


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
    """Return a block's log with the weights of its residuals, and whether they are as before."""
    weights = {
        name: weights_of(rest, log.noise.get(name, 1.0))
        for name, rest in rolled.residuals[0].items()
    }
    before = log.weights[0]
    same = all(
        np.abs(w - before.get(name, 1.0)).max(initial=0.0) < 0.05 for name, w in weights.items()
    )
    return (log, True) if same else (replace(log, weights=(weights,)), False)
