"""One block of the online fit: from what is known at its start to what is known at its end.

Attitude, centre of mass and momentum may change at the start of a block: a link. It acts with a
probability w, and has the size a of its σ that its evidence prefers; see `evidence`. So its prior
has the variance w a² σ²: one that the samples exclude is zero, one that acts is free, and one that
they cannot tell from none widens the intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.evidence import Comparison, compare
from cpid_drake.estimation.fit import CLOSE
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import joint_part, tracked
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.estimation.likelihood.model import jump_between
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.log_state import LogState, farthest
from cpid_drake.estimation.roll import Rolled, Values, roll
from cpid_drake.estimation.sweep import BOUNDARY, EXACT, back, boundary_size, changed, linked, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.weights import weights_of

NAME = "online"
"""Name of the log of an online fit."""

ODDS = 1 / 40
"""A change is expected at the start of one of so many blocks."""

MOST_LINEARIZATIONS = 6
"""A block is linearized so many times at most."""

UNLIKELY = 6.0
"""Noise does not explain a block whose χ² is above its expectation by so many σ."""


@dataclass(frozen=True)
class Link:
    """A change of attitude, centre of mass and momentum at the start of a block.

    Attributes:
        time: the start of the block [s].
        probability: that something changed.
        size: of the change, as a share of its σ.

    """

    time: float
    probability: float = 1.0
    size: float = 1.0

    @property
    def name(self) -> str:
        """Name of the change as an unknown."""
        return f"link {self.time!r}"


def compared(model: Model, gaussian: Gaussian, names: Sequence[str]) -> Comparison:
    """Return the comparison of changes that are unknowns of these names."""
    sigma, odds = dict.fromkeys(names, farthest(model)), dict.fromkeys(names, ODDS)
    return compare(gaussian, sigma, [PSI], odds)


def with_links(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> Gaussian:
    """Return what is known if the links are as large as their evidence shows."""
    for link in links:
        sigma = max(np.sqrt(link.probability) * link.size, EXACT) * farthest(model)
        rows = np.column_stack([np.diag(1 / sigma), np.zeros(12)])
        gaussian = gaussian.add(Gaussian.of_rows({link.name: 12}, rows))
    return gaussian


def closed(model: Model, gaussian: Gaussian, links: Sequence[Link]) -> Gaussian:
    """Return what is known of the others if some links are as large as their evidence shows."""
    names = [link.name for link in links]
    others = [name for name in gaussian.places if name not in names]
    return with_links(model, gaussian, links).marginal(others)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known at the end of the last block.

    Attributes:
        values: of all unknowns, about which everything is linear.
        log: the last block, with its noise; it starts with the state at its end.
        gaussian: about what is at the boundary and all unknowns, and of the links themselves.
        links: at the starts of the last blocks.
        track: (J, ORDER, ORDER + 1) rows about the joints, by their own sensors alone.
        about: values of the target and the hardware about which all rows are linear.
        converged: whether this is the best fit of the blocks so far.

    """

    values: Values
    log: LogState
    gaussian: Gaussian
    links: tuple[Link, ...]
    track: NDArray[np.float64]
    about: Values
    converged: bool = True

    def unknowns(self, model: Model) -> Gaussian:
        """Return what is known of all unknowns but the block's, about `values`."""
        found = closed(model, self.gaussian, self.links)
        return found.marginal(name for name in found.places if name != BOUNDARY)


def is_likely(log: LogState, rolled: Rolled) -> bool:
    """Return whether noise explains the samples of a block."""
    rest = [log.weighted(0, name, each) for name, each in rolled.residuals[0].items()]
    count = sum(each.size for each in rest)
    return sum(float(np.sum(r * r)) for r in rest) < count + UNLIKELY * np.sqrt(2 * count)


def solved(
    model: Model, known: Known, block: Block, *, is_linked: bool = True
) -> tuple[Known, LogState, Rolled]:
    """Return what is known at the end of a block, and the block at its solution.

    Its start has a link. It is linearized anew until χ² at the solution is what the last
    linearization predicts.

    Raises:
        InputError: no motion can be predicted near what is known.

    """
    links, n, walking = known.links, boundary_size(model), model.walking_columns
    sigma = model.walking_sigma * np.sqrt(block.length)
    gaussian, _ = changed(known.gaussian, n + walking, sigma, np.zeros(len(walking)))
    if is_linked:
        links = (*links, Link(block.start))
        gaussian = linked(gaussian, links[-1].name, farthest(model), np.zeros(12))
    part, track = tracked(known.track, joint_part(block, model.suite, known.log.smoothness))
    forces = (model.no_forces(block.start, block.end),)
    log = replace(known.log, blocks=(block,), joints=(part,), forces=forces)
    values, rolled = known.values, roll(model, log, known.values)
    here = _start(log)
    before = here[0], known.log.joints[0].coefficients[-ORDER:]
    gaussian = _moved(gaussian, _step(before, here))
    for _ in range(MOST_LINEARIZATIONS):
        about = _linear(model, known, log, rolled, values)
        swept = sweep(model, log, about, values, before=gaussian)
        linear = swept.gaussian
        acting = compared(model, linear, [link.name for link in links])
        links = tuple(
            Link(link.time, acting.probability[link.name], acting.sizes.get(link.name, 0.0))
            for link in links
        )
        mean = with_links(model, linear, links)
        g = solve_triangular(mean.R, mean.z)  # priors determine all
        change = {name: g[place] for name, place in linear.places.items()}
        better = back(model, log, swept, change)
        values = {name: value + change[name] for name, value in values.items()}
        ahead, there = roll(model, better, values), _start(better)
        table = g[: sum(unknown.size for unknown in model.table)]
        gaussian = _moved(gaussian, _step(here, there), table)
        jumps = np.concatenate([np.zeros(n + len(table)), g[len(table) :]])
        excess = ahead.cost_inside(better) + gaussian.cost(jumps) - linear.cost(g)
        ends = _end(log, rolled), _end(better, ahead)
        after = _moved(swept.end, _step(*ends), table)
        log, is_settled = _weighted(better, ahead)
        rolled, here = ahead, there
        if abs(excess) < CLOSE and is_settled:
            break
    last = replace(log, starts=(_end(log, rolled)[0],), weights=({},))
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


Boundary = tuple[TrajectoryState, NDArray[np.float64]]
"""What is at one end of a block: the base's state and joints (ORDER, J)."""


def _start(log: LogState) -> Boundary:
    """Return what is at the start of the block of a log."""
    return log.starts[0], log.joints[0].coefficients[:ORDER]


def _end(log: LogState, rolled: Rolled) -> Boundary:
    """Return what is at the end of the block of a log."""
    state = rolled.models[0].motion.end(rolled.trajectories[0])
    return state, log.joints[0].coefficients[-ORDER:]


def _step(old: Boundary, new: Boundary) -> NDArray[np.float64]:
    """Return the step (n,) from one to another."""
    return np.concatenate([jump_between(old[0], new[0]), (new[1] - old[1]).T.ravel()])


def _moved(gaussian: Gaussian, *steps: NDArray[np.float64]) -> Gaussian:
    """Return a Gaussian about another boundary, other values of the table, and the same links."""
    step = np.concatenate(steps)
    return gaussian.moved(np.append(step, np.zeros(gaussian.size - len(step))))


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
