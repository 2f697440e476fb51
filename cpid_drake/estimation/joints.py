"""The joints' motion by their own sensors: smoothing splines that continue from block to block.

Position, rate and acceleration continue at the ends of blocks; the spline of a block is quintic.
With samples q at times t, the rows of all its coefficients c are

    B(t) c = q / (σ f)    samples, with a noise factor f of the declared σ; a rounded value that
                          is repeated counts once
    P c = 0 / s           |P c|² = ∫ jerk² dt: the jerk is white noise of size s

so the jerk's prior bridges missing samples with the uncertainty that they leave. The number of
pieces, s and f have the largest marginal likelihood (evidence). But a motion is not as rough all
the time: where its acceleration steps, a jerk of the usual size leaves errors of its rates that
only a gyro feels. So s in the rows is that of the roughest block. With λ = s²/f²,
ν = `DECLARED_COUNT` and M = BᵀB + PᵀP/λ, for n samples and K coefficients of the whole log,

    −2 log(evidence) = (ν + n − d) log(ν + S) + log det M + (K − d) log λ − log det PᵀP

with d = 3 for each part of the log that has no gap inside, the penalized χ² S, and det PᵀP that on
the coefficients that have a jerk.

Sources: Wahba 1990, Spline Models for Observational Data, ch. 1 and 4.
"""

from collections.abc import Mapping, Sequence
from functools import cache, partial
from itertools import pairwise

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.joint_samples import JointSamples, Smoothness, once_weights
from cpid_drake.estimation.joint_splines import ENOUGH, JointSplines
from cpid_drake.estimation.least_squares import loss_weight
from cpid_drake.estimation.likelihood.joint_model import ORDER, JointPart
from cpid_drake.estimation.process import EXACT, Process
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.suite import SensorSuite

FINER = 2
"""The gyro feels errors of the splines that encoders do not: so many times as many pieces."""

_FAST = 16.0  # pieces in a second, which follow 5 Hz: with too few, a fast motion looks like noise
_REWEIGHTINGS = 6  # at most; outliers look like a rough motion or like noise until they are known
_SAME = 0.05  # change of a weight that does not matter
_SHAPES = 9, 7  # of τ and of ratios
_FIRST = (1, 2), (3, 2), (5, 2)  # shapes that are tried first
_PRICE = 12.0  # of −2 log(evidence): of noise that is not white


def smooth_joints(
    blocks: Sequence[Block], suite: SensorSuite, earlier: Smoothness | None = None
) -> tuple[Smoothness, list[JointPart]]:
    """Return the smoothness of a log's joints, and their smoothed motion in successive blocks.

    Args:
        blocks: successive blocks of one log.
        suite: the sensors' errors.
        earlier: the smoothness of most of these blocks, with the noise from which it is sought.

    Raises:
        InputError: the samples are too few.

    """
    samples = [JointSamples(block, suite) for block in blocks]
    _require_enough(samples)
    once = once_weights(samples)
    processes: dict[str, Process] = {**earlier.processes} if earlier else {}
    weights = once
    for _ in range(_REWEIGHTINGS):
        samples = [each.with_processes(processes) for each in samples]
        splines = _best_splines(samples, weights, once, processes, earlier.rate if earlier else 0.0)
        u = splines.best()
        coefficients, noise, roughness = splines.solved(u)
        loss = [loss_weight(left / noise) for left in splines.residuals(coefficients)]
        before, weights = weights, [w * o for w, o in zip(loss, once, strict=True)]
        pairs = zip(before, weights, strict=True)
        is_same = max(np.abs(a - b).max(initial=0.0) for a, b in pairs) < _SAME
        if not is_same:
            continue
        is_exact = bool(np.median(noise) < EXACT) if len(noise) else True
        old, processes = processes, {} if is_exact else _processes(splines, u, processes)
        if old == processes:
            break
    # the jerk of the roughest block, s² = λ f² roughness²
    coefficients, _, _ = splines.solved(u + 2 * np.log(roughness))
    noise = np.maximum(noise, 1.0)
    # s = f √λ
    jerk = np.exp(u / 2) * noise
    smoothness = Smoothness(splines.rate, jerk, roughness, noise, processes)
    parts = [
        each.part(smoothness, w).about(c)
        for each, w, c in zip(samples, before, coefficients, strict=True)
    ]
    return smoothness, parts


def continued(part: JointPart, before: Array) -> JointPart:
    """Return the part that continues what is at the end of the block before, (ORDER, J)."""
    c = part.coefficients.copy()
    c[:ORDER] = before
    rests = part.about(c).rest
    for j, (A, rest) in enumerate(zip(part.rows, rests, strict=True)):
        # least |A δc − rest| over all coefficients but the first
        c[ORDER:, j] += np.linalg.lstsq(A[:, ORDER:], rest, rcond=1e-12)[0]
    return part.about(c)


def _processes(splines: JointSplines, u: Array, now: Mapping[str, Process]) -> dict[str, Process]:
    """Return the shapes of the noise, of variance 1, of the joints' sensors without steps.

    They have the largest evidence of a grid of τ and of ratios of slow and white variances, if it
    is much larger than that of white noise: shapes are tried from one to its neighbours.
    """
    shapes = dict(now)
    for name, step in splines.steps.items():
        others = {n: p for n, p in shapes.items() if n != name}
        cost = cache(partial(_shape_cost, splines, u, others, name, step))
        places = {_shape(step, i, j): (i, j) for i in range(_SHAPES[0]) for j in range(_SHAPES[1])}
        best = places.get(shapes.get(name, Process()))
        best = min([None, *(_FIRST if best is None else [best])], key=cost)
        while best is not None:
            i, j = best
            near = [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
            near = [at for at in near if 0 <= at[0] < _SHAPES[0] and 0 <= at[1] < _SHAPES[1]]
            better = min([best, *near], key=cost)
            if better == best:
                break
            best = better
        shapes = others if best is None else {**others, name: _shape(step, *best)}
    return shapes


def _shape_cost(
    splines: JointSplines,
    u: Array,
    others: Mapping[str, Process],
    name: str,
    step: float,
    at: tuple[int, int] | None,
) -> float:
    """Return −2 log(evidence) of a shape of a sensor's noise beside others; of white without."""
    if at is None:
        return splines.of(others).least_about(u)
    return splines.of({**others, name: _shape(step, *at)}).least_about(u) + _PRICE


def _shape(step: float, i: int, j: int) -> Process:
    """Return one of the shapes: τ from a step on, and slow noise of 0.1 to 100 of the white."""
    ratio = 0.1 * 10 ** (j / 2)
    # white + slow = 1, slow / white = ratio
    return Process(1 / (1 + ratio), ratio / (1 + ratio), step * 2.0**i, 1)


def _best_splines(
    samples: Sequence[JointSamples],
    weights: Sequence[Array],
    once: Sequence[Array],
    processes: Mapping[str, Process],
    rate: float,
) -> JointSplines:
    """Return splines with `FINER` times the pieces with the most evidence, or fewer if as good.

    More than `_FAST` pieces in a second are tried as long as they have more, and more than noise
    has that is not white: it looks like a fast motion. They are no fewer than at a given rate
    [1/s].
    """
    usual = float(np.median([block.end - block.start for block in samples]))
    most = float(np.median([len(block.values) for block in samples])) / 2  # samples show no more
    first = max(1, round(rate * usual / FINER))
    splines, best, least, pieces = dict[int, JointSplines](), first, np.inf, first
    while pieces == first or pieces <= most:
        splines[pieces] = JointSplines(samples, pieces / usual, weights, once)
        value = float(splines[pieces].on_grid.min(axis=1).sum())
        if value < least - ENOUGH:
            if splines[pieces].rate > _FAST and value > _noisy(splines[best], processes):
                break
            best, least = pieces, value
        elif splines[pieces].rate >= _FAST:
            break
        pieces *= 2
    finer = FINER * best
    return splines.get(finer) or JointSplines(samples, finer / usual, weights, once)


def _noisy(splines: JointSplines, processes: Mapping[str, Process]) -> float:
    """Return −2 log(evidence) of splines with the noise that they leave."""
    u = splines.best()
    shapes = _processes(splines, u, processes)
    price = _PRICE * len(shapes.keys() - processes.keys())
    return splines.of(shapes).least_about(u) + price


def _require_enough(samples: Sequence[JointSamples]) -> None:
    """Raise an error unless encoders determine a parabola between any two gaps."""
    ends = [k for k, (a, b) in enumerate(pairwise(samples), 1) if a.end < b.start]
    counts = np.array([block.positions for block in samples])
    has_joints = samples[0].values.shape[1] > 0
    if has_joints and min(np.add.reduceat(counts, [0, *ends])) < ORDER:
        raise InputError("encoders: too few samples to show how the joints move")
