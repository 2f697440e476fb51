"""Blocks that noise does not explain: outliers are left out, and changes of momentum are bridged.

The rule is simple. If the likelihood of a block is too small, a few outliers may explain it. If
not, the block is divided into halves, again and again. A shortest piece that nothing explains is
bridged: its joint motion is used, its samples of the base are not, and attitude, centre of mass and
momentum are open afterwards, while the target and the biases remain as they are known. A thruster's
firing of any length is such a piece, or several. A piece without encoder samples is a gap, in which
the momentum is constant and the attitude is lost.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.plane import tilt
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, first_sample
from cpid_drake.estimation.block_state import UNLIKELY, BlockFit, BlockState
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.jumps import LONGEST, SPACING
from cpid_drake.estimation.likelihood.joint_block import joint_block
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.priors import FASTEST_DRIFT, Prior
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.sensors import ATTITUDE

SPIKE = 6.0
"""A sample may be left out if it is off by more than this number of σ."""

FEW = 0.1
"""Largest share of the samples of one sensor in a block that may be left out (at least one)."""

LONGEST_GAP = 8.0
"""A gap between encoder samples longer than this number of periods interrupts the joint motion."""

HALVINGS = 3
"""A block is divided into halves at most this number of times."""

FEWEST, FEWEST_AT_START = 5, 8
"""Fewest encoder samples, on average, in the parts of a block, and where joints are not known yet.

A part with fewer has no model of its joint motion, and would be lost without a word.
"""

HOPELESS = 2
"""After this number of mostly bridged blocks in a row, a block is divided into halves only once.

What lasts so long is no short fault: a model that is wrong would need all pieces of all blocks.
"""

LOST = {"attitude": 0.5, "p_Wcm": 10.0}
"""σ of attitude [rad] and centre of mass [m] after an unexplained piece or a gap."""


@dataclass(frozen=True, eq=False)
class Explained:
    """A block after its explanation.

    Attributes:
        state: at the end.
        fits: of its pieces.
        bridged: start and end of each piece that nothing explained [s].
        left_out: number of samples left out, by sensor.
        jumps: times at which weak changes of momentum were found [s].

    """

    state: BlockState
    fits: tuple[BlockFit, ...] = ()
    bridged: tuple[tuple[float, float], ...] = ()
    left_out: tuple[tuple[str, int], ...] = ()
    jumps: tuple[float, ...] = ()

    def then(self, other: "Explained") -> "Explained":
        """Return both blocks as one."""
        return Explained(
            other.state,
            self.fits + other.fits,
            self.bridged + other.bridged,
            self.left_out + other.left_out,
            self.jumps + other.jumps,
        )


def block_model(solver: BlockSolver, state: BlockState, block: Block) -> BlockModel:
    """Return the likelihood of a block.

    Raises:
        InputError: too few samples of the joints' positions.

    """
    start, end, samples, is_kicked = block.start, block.end, block.samples, block.is_kicked
    suite, track, finer = solver.suite, state.track, solver.finer
    joints = joint_block(start, end, samples, suite, track, finer, is_kicked=is_kicked)
    return solver.model(joints, block.samples, state.nominal.constants)


def explain(
    solver: BlockSolver,
    prior: Prior,
    state: BlockState,
    block: Block,
    plausible: NDArray[np.float64] | None = None,
) -> Explained:
    """Return what is known after a block, with outliers left out and changes found.

    Args:
        solver: solves blocks.
        prior: whose σ a reopened momentum has.
        state: at the start of the block.
        block: the samples.
        plausible: see `BlockSolver.solve`.

    """
    fewest = FEWEST_AT_START if state.track is None else FEWEST
    shares = len(block.samples.encoders) / fewest
    most = HALVINGS if state.unexplained < HOPELESS else 1
    halvings = min(most, int(np.log2(max(shares, 1.0))))
    found = _pieces(solver, prior, state, block, plausible, halvings)
    is_lost = sum(end - start for start, end in found.bridged) > block.length / 2
    unexplained = state.unexplained + 1 if is_lost else 0
    state = replace(found.state, unexplained=unexplained)
    jump = max(state.jumps, key=lambda each: each.gain, default=None)
    if jump is not None and jump.exceeds_noise(solver.misfit, UNLIKELY):
        state = solver.with_jump(state, jump, opened(prior))
        return replace(found, state=solver.settled(state, plausible), jumps=(jump.time,))
    recent = tuple(each for each in state.jumps if each.blocks < LONGEST)
    state = replace(state, jumps=recent)
    if not recent or recent[-1].blocks >= SPACING:
        state = solver.with_assumed_jump(state)
    return replace(found, state=state)


def _pieces(
    solver: BlockSolver,
    prior: Prior,
    state: BlockState,
    block: Block,
    plausible: NDArray[np.float64] | None,
    halvings: int,
) -> Explained:
    """Return what is known after a block that may be divided into halves so many times."""
    gap = _gap(block, solver)
    if gap is not None:
        before, later = block.part(block.start, gap[0]), block.part(gap[1], block.end)
        begun = _pieces(solver, prior, state, before, plausible, halvings)
        resumed = skipped(solver, begun.state, gap[1], block.samples.thrust)
        return begun.then(_pieces(solver, prior, resumed, later, plausible, halvings))
    try:
        state = with_first_attitude(state, block, solver.tree.normal_B)
        model = block_model(solver, state, block)
    except InputError:
        return Explained(skipped(solver, state, block.end, block.samples.thrust))
    found = _without_faults(solver, state, model, plausible)
    if found is not None:
        return found
    if halvings:
        first, second = block.halves()
        begun = _pieces(solver, prior, state, first, plausible, halvings - 1)
        return begun.then(_pieces(solver, prior, begun.state, second, plausible, halvings - 1))
    try:
        after_bridge = bridged(solver, prior, state, model, plausible)
    except (InputError, np.linalg.LinAlgError):
        after_bridge = skipped(solver, state, block.end, block.samples.thrust)
    return Explained(after_bridge, bridged=((block.start, block.end),))


def _gap(block: Block, solver: BlockSolver) -> tuple[float, float] | None:
    """Return start and end of the longest gap between encoder samples, if it is long."""
    times = block.samples.encoders.time
    if not len(times):
        return None
    edges = np.concatenate([[block.start], times, [block.end]])
    k = int(np.argmax(np.diff(edges)))
    start, end = edges[k], edges[k + 1]
    usual = np.median(np.diff(times)) if len(times) > 2 else 0.0  # a log may be slower than said
    if end - start < LONGEST_GAP * max(1 / solver.suite["encoders"].rate, usual):
        return None
    return float(start), float(end)


def _without_faults(
    solver: BlockSolver, state: BlockState, model: BlockModel, plausible: NDArray[np.float64] | None
) -> Explained | None:
    """Return the block with few outliers left out; None if this does not explain it."""
    weights: NDArray[np.float64] | None = None
    names = np.repeat(list(model.sensors), [len(s.samples) for s in model.sensors.values()])
    out = np.zeros(len(names), dtype=bool)
    for _ in range(6):
        try:
            fit = solver.solve(state, model, plausible=plausible, weights=weights)
        except (InputError, np.linalg.LinAlgError):
            return None
        if fit.is_likely:
            counts = {name: int(out[names == name].sum()) for name in model.sensors}
            counts["encoders"] = fit.joints.outliers
            left_out = tuple((name, count) for name, count in counts.items() if count)
            return Explained(fit.state, (_kept(fit, names, ~out),), (), left_out)
        if not len(names):
            return None
        size = np.concatenate(
            [np.sqrt(np.mean(rest**2, axis=1)) for rest in fit.residuals.values()]
        )
        spike = SPIKE * np.sqrt(solver.misfit)
        far = (size > max(spike, 0.4 * size[~out].max(initial=0.0))) & ~out
        out |= far
        most = {name: max(1.0, FEW * (names == name).sum()) for name in model.sensors}
        if not far.any() or any(out[names == name].sum() > most[name] for name in model.sensors):
            return None
        weights = np.where(out, 0.0, 1.0)
    return None


def _kept(fit: BlockFit, names: NDArray[np.str_], kept: NDArray[np.bool_]) -> BlockFit:
    """Return a fit without the residuals of the samples that were left out.

    Args:
        fit: the fit.
        names: (N,) name of the sensor of each sample.
        kept: (N,) whether each sample was used.

    """
    used = {name: kept[names == name] for name in fit.residuals}
    residuals = {name: rest[used[name]] for name, rest in fit.residuals.items()}
    times = {name: time[used[name]] for name, time in fit.times.items()}
    return replace(fit, residuals=residuals, times=times)


def bridged(
    solver: BlockSolver,
    prior: Prior,
    state: BlockState,
    model: BlockModel,
    plausible: NDArray[np.float64] | None,
) -> BlockState:
    """Return what is known after a block whose samples of the base are not used."""
    nothing = np.zeros(sum(len(sensor.samples) for sensor in model.sensors.values()))
    state = solver.solve(state, model, plausible=plausible, weights=nothing).state
    return solver.loosened(state, opened(prior))


def opened(prior: Prior) -> dict[str, float]:
    """Return σ of what an unexplained piece or a change of momentum may have changed."""
    return {**LOST, "L": prior.unknown_L_sigma, "v_Wcm": FASTEST_DRIFT}


def skipped(
    solver: BlockSolver, state: BlockState, end: float, thrust: Samples | None = None
) -> BlockState:
    """Return what is known after a gap without encoder samples: momentum, target and biases.

    Args:
        solver: solves blocks.
        state: at the start of the gap.
        end: its end [s].
        thrust: the log of thrust; None without one.

    """
    elapsed = end - state.time
    growth = max((g.bias_growth for g in solver.gyros), default=0.0) * np.sqrt(elapsed)
    lost = {"attitude": np.pi, "p_Wcm": 1e3, "joints": 1e6, "bias": growth}
    state = solver.coasted(solver.loosened(state, lost), elapsed, thrust)
    p_Wcm = state.nominal.p_Wcm + elapsed * state.nominal.v_Wcm
    nominal = replace(state.nominal, p_Wcm=p_Wcm)
    return replace(state, time=end, nominal=nominal, track=None)


def with_first_attitude(
    state: BlockState, block: Block, normal_B: NDArray[np.float64] | None = None
) -> BlockState:
    """Return a state in which the first attitude of a block replaces a lost nominal attitude.

    Args:
        state: before.
        block: the samples.
        normal_B: (3,) the normal in B of a table, which holds the tilt; None without one.

    Raises:
        InputError: the nominal attitude is lost, and the block has no attitude sample.

    """
    if state.track is not None:
        return state
    first = first_sample(block.samples, ATTITUDE)
    if first is None:
        raise InputError("no attitude samples while the joints are known: none to start from")
    attitude = Rotation.from_quat(first, scalar_first=True)
    if normal_B is not None:
        attitude = Rotation.from_rotvec(tilt(first[None], normal_B)[0]) * attitude
    return replace(state, nominal=replace(state.nominal, attitude=attitude))
