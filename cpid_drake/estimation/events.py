"""Changes of momentum that nothing models, each at the end of a block.

A firing, a contact or a push changes attitude, centre of mass, L and v between two blocks by any
amount (12 entries). With the ends of all blocks open, every change is an unknown of one fit, and
`evidence.compare` decides which of them are not zero. The blocks beside a change are cut into
parts, so that a change inside a block has an end near it, and all ends are judged once more. More
changes than are probable are another cause, which no finer cut shows.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import pdtrik

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.evidence import (
    MOST_CANDIDATES,
    SIZES,
    UNEXPECTED_ODDS,
    ModelComparison,
    Question,
)
from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import FAR, IMPROBABLE
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.links import farthest
from cpid_drake.estimation.log_state import CHANGE, LogState
from cpid_drake.estimation.noise import with_best_noise
from cpid_drake.estimation.roll import Rolled, Values, linearize, roll
from cpid_drake.estimation.sweep import known_at_start, sweep
from cpid_drake.estimation.unknowns import Model

LATER = 8
"""So many blocks after these ends are used to judge them."""


def fit_with_events(
    fit: Fit,
    question: Question,
    fits: BoundedFits,
) -> Fit:
    """Return a fit with the changes of momentum that its samples show; see `LogState.changes`.

    Args:
        fit: a fit, which is returned if the samples show no changes but its own.
        question: the candidates beside the changes, which are judged together.
        fits: makes the fits.

    Raises:
        InputError: no motion can be predicted, or it needs more linearizations than are left.

    """
    model = fit.model
    # Slow noise may be a change in disguise, and changes may be slow noise.
    quiet = [log.with_each(weights=({} for _ in log.states)) for log in fit.logs]
    declared = [log.with_processes({}) for log in quiet]
    changes = _changes(replace(fit, logs=declared), question)
    if all(log.open.issuperset(own) for log, own in zip(quiet, changes, strict=True)):
        return fit
    slow = [p.total for log in quiet for p in log.noise.processes.values() if p.slow]
    is_noise = max(slow, default=0.0) < FAR**2  # else the fit is no start, and changes come first
    if slow and is_noise:
        parts = zip(quiet, fit.rolled, changes, strict=True)
        cut = [_cut(model, *each) for each in parts]
        finer = replace(fit, logs=cut, rolled=[roll(model, log, fit.values) for log in cut])
        ends = zip(cut, finer.rolled, _changes(finer, question), strict=True)
        kept = [
            _kept(finer, log.with_processes(before.noise.processes), rolled, own, question)
            for before, (log, rolled, own) in zip(fit.logs, ends, strict=True)
        ]
        if not any(kept):
            return fit
    wide = fit
    # What a change has bent is no start.
    now = [log.of_others(model, log.blocks) for log in fit.logs]
    for last in (False, True):  # whole blocks, then parts of those beside changes
        logs = [log.opened(range(len(log.blocks) - 1)) for log in now]
        wide = fits.fit(model, logs, values=wide.values)
        if not is_explained(wide):
            return fit  # changes do not explain the samples
        plain = [log.with_processes({}) for log in wide.logs]
        changes = _changes(replace(wide, logs=plain), question)
        logs = [log.opened(each) for log, each in zip(wide.logs, changes, strict=True)]
        count = sum(len(log.changes) for log in logs)
        if last or not 0 < count <= most_changes(len(logs)):
            break
        parts = zip(wide.logs, wide.rolled, changes, strict=True)
        now = [_cut(model, *each) for each in parts]
    changed = fits.fit(model, logs, values=wide.values)
    ends = zip(changed.logs, changed.rolled, changes, strict=True)
    kept = [
        _kept(changed, log.with_processes(before.noise.processes), rolled, own, question)
        for before, (log, rolled, own) in zip(fit.logs, ends, strict=True)
    ]
    if not any(kept):
        return fit if is_noise else changed
    if all(log.open == own for log, own in zip(changed.logs, kept, strict=True)):
        return changed
    logs = [log.opened(own) for log, own in zip(wide.logs, kept, strict=True)]
    return fits.fit(model, logs, values=wide.values)


def _kept(
    fit: Fit,
    log: LogState,
    rolled: Rolled,
    changes: Mapping[int, float],
    question: Question,
) -> frozenset[int]:
    """Return the first changes, by their evidence, that have the most beside the noise.

    The noise is sought from that of the log, with one change after the other. A change inside of a
    block is one at both of its ends: two more that are no better are the last. Of more changes than
    are probable, it is all or none.
    """
    ends, costs, noise = list(changes), list[float](), log
    are_many = len(log.opened(ends).changes) > most_changes(1)
    counts = [0, len(ends)] if are_many else range(len(ends) + 1)
    price = 2 * float(np.log(len(SIZES)) - np.log(UNEXPECTED_ODDS))
    for k, count in enumerate(counts):
        if costs and k > 2 + int(np.argmin(costs)):
            break
        alone = replace(fit, logs=[log.with_processes({})], rolled=[rolled])
        [spans] = _changes(alone, question, ends[:count]) if count else [{}]
        some = noise.opened(ends[:count], spans)
        before = costs[-1] if costs else np.inf
        noise, cost = with_best_noise(fit.model, some, rolled, fit.values, before)
        costs.append(cost + count * price)
    return log.opened(ends[: counts[int(np.argmin(costs))]]).open


def is_explained(fit: Fit) -> bool:
    """Return whether residuals are as small as samples that do not weigh less."""
    return fit.cost < FAR**2 * sum(each.count for each in fit.rolled)


@cache
def most_changes(logs: int) -> int:
    """Return the most changes that are probable in so many logs: one in a log is expected."""
    return int(np.ceil(pdtrik(1 - IMPROBABLE, logs)))


def _changes(
    fit: Fit, question: Question, among: Collection[int] | None = None
) -> list[dict[int, float]]:
    """Return of each log the blocks at whose ends something changed, and how much.

    That is a share of `links.farthest`, as `Link.span`.

    Of some ends `among` which alone something can change, all are returned.
    """
    model, result = fit.model, []
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        best, count = dict[int, float](), len(log.blocks)
        before = known_at_start(model, log, fit.values)
        linearize(model.of_log(log.name), log, rolled, fit.values)
        wide = log.opened(range(count - 1) if among is None else among)
        for first in range(0, count - 1, MOST_CANDIDATES):
            last = min(first + MOST_CANDIDATES, count - 1)
            ends = [k for k in range(last - first) if not log.links[first + k].gap]
            ends = [k for k in ends if among is None or first + k in among]
            later = slice(last, min(last + LATER + 1, count))
            own, part = wide.part(first, last), rolled.part(first, last)
            parts = own, part
            gaussian = sweep(
                model, *parts, fit.values, carry=ends, before=before, forward_only=True
            ).end
            parts = log.part(later.start, later.stop), rolled.part(later.start, later.stop)
            carried = sweep(model, *parts, fit.values, before=gaussian, forward_only=True).gaussian
            changes = {own.change(k): part.jumps[k] for k in ends}
            compared = _compared(own, fit, carried, changes, question)
            acting = compared.best if among is None else compared.sizes
            numbers = {own.change(k): first + k for k in ends if own.change(k) in acting}
            best |= {numbers[n]: a for n, a in compared.sizes.items() if n in numbers}
            gaussian = gaussian.condition(
                {own.change(k): -part.jumps[k] for k in ends if first + k not in log.open}
            )
            before = gaussian.marginal(n for n in gaussian.places if not n.startswith(CHANGE))
        result.append(best)
    return result


def _compared(
    log: LogState,
    fit: Fit,
    gaussian: Gaussian,
    changes: Values,
    question: Question,
) -> ModelComparison:
    """Return the comparison of changes of a log, given by name, beside all other candidates."""
    total = prior_of(fit.model, [log], fit.values).add(gaussian)
    values = fit.values | changes
    values = {name: values.get(name, np.zeros(size)) for name, size in total.sizes.items()}
    candidates = dict.fromkeys(changes, farthest(fit.model))
    return question.answer(total, values, candidates)


def _cut(model: Model, log: LogState, rolled: Rolled, changes: Collection[int]) -> LogState:
    """Return a log whose whole blocks beside the changes are cut into parts.

    The parts keep their states.
    """
    if not changes:
        return log
    usual = max(block.length for block in log.blocks)
    blocks, starts, ends = list[Block](), list[TrajectoryState](), list[int]()
    for k, (block, motion, trajectory) in enumerate(
        zip(log.blocks, rolled.models, rolled.trajectories, strict=True)
    ):
        is_whole = block.length > usual / 2
        parts = block.cut() if is_whole and {k, k - 1} & {*changes} else [block]
        blocks += parts
        starts += [log.starts[k]]
        nodes = np.searchsorted(motion.motion.nodes, [part.start for part in parts[1:]])
        starts += [motion.motion.at_node(trajectory, int(node)) for node in nodes]
        ends += [len(blocks) - 1] if k in log.open else []
    return log.of_others(model, blocks, starts).opened(ends)
