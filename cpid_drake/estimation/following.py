"""One more block, solved alone: all before it is its past, and stays as it is.

The fit of one more block behind a Gaussian of all others is the fit of all blocks, if these are
linear about the new values, if the noise is as before, and if nothing changed between blocks. So it
is a filter, while these conditions hold; else the window of the last blocks is solved anew.

A change of momentum at one of the last ends is an unknown of its own in the past, which is
conditioned on zero. How much the samples behind an end ask for it needs no other fit. If they may
ask, parts of the new block are fitted with all their ends open: what was before it was explained.
Of these ends and the last ones, those at which something changed stay open.

Source: Bierman 1977, ch. V (square-root information filter).
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.elimination import changed, linked
from cpid_drake.estimation.events import is_explained
from cpid_drake.estimation.evidence import Question, is_possible_change
from cpid_drake.estimation.fit import Fit, fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import FAR
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.linearity import is_linear, linear_at
from cpid_drake.estimation.links import Link, farthest
from cpid_drake.estimation.log_state import CHANGE, LogState
from cpid_drake.estimation.noise import is_as_before
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.roll import past_of, roll
from cpid_drake.estimation.start import state_of
from cpid_drake.estimation.sweep import BOUNDARY, boundary_size, sweep
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.estimation.unknowns_prior import prior_of
from cpid_drake.estimation.white_torque import NO_GAINS, gains_of_change
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.sensors import SENSORS

LINKS = 3
"""Changes at so many of the last ends are in question."""

MOST_SWEEPS = 4
"""Most sweeps of one block, and of its parts: else the window is solved."""

FEWEST_FAR = 3
"""Samples of a sensor that are far off behind a change, more than those that are not."""

WIDE_SWEEPS = 10
"""Most sweeps of its parts with all their ends open."""


def followed(
    fits: Sequence[Fit],
    ahead: Past,
    block: Block,
    question: Question,
    *,
    is_conserved: bool = True,
) -> tuple[tuple[Fit, ...], Past, Array] | None:
    """Return the fits with that of one more block, and what is known ahead of it; None if none is.

    And what the change that is no more in question says of white torques; see `gains_of_change`.

    Args:
        fits: of the blocks of the window, each of those behind the past of the next.
        ahead: what is known at their end; see `ahead_of`.
        block: the samples that follow without a gap.
        question: what is compared with changes of the momentum.
        is_conserved: whether the momentum is as before; else it is another in every block.

    """
    try:
        gaussian = _known_before(fits, ahead)
        if not is_conserved:
            return _apart(fits, ahead, gaussian, block)
        solved = _fitted(fits[-1], _following(fits, ahead, [block]), gaussian)
        if not (solved.converged and is_explained(solved)):
            parts = _parts_beside_change(fits, ahead, block)
            return _with_changes(fits, ahead, gaussian, parts, question)
        if not is_linear(solved, np.array([each.values[PSI] for each in fits])):
            return None
        if _has_noise_of(fits, solved):
            end = _known_at_end(solved, gaussian)
            changes = _changes(solved, end, question)
            if not any(is_possible_change(each, farthest(solved.model)) for each in changes):
                fits = (*fits, solved)
                return fits, ahead_of(solved, end), _torque_gains(fits, changes[0])
        return _with_changes(fits, ahead, gaussian, block.cut(), question)
    except (InputError, np.linalg.LinAlgError):
        return None


def joined(fits: Sequence[Fit]) -> LogState:
    """Return the log of all blocks of the window."""
    model = fits[0].model
    return reduce(lambda log, other: log.followed(model, other), (each.logs[0] for each in fits))


def ahead_of(solved: Fit, gaussian: Gaussian) -> Past:
    """Return the past of the block that follows.

    Args:
        solved: the fit of the block before, or of the window.
        gaussian: what is known at its end, as `Swept.end`, and then of changes.

    """
    model, [log], [rolled], values = solved.model, solved.logs, solved.rolled, solved.values
    return Past(
        replace(gaussian, rho2=0.0),
        rolled.ends[-1],
        log.states[-1].joints.coefficients[-ORDER:],
        np.concatenate([values[u.key(log.name)] for u in model.table]),
        linear_at(solved),
        log.noise.slow_places,
        log.slow_at_end,
    )


def _known_before(fits: Sequence[Fit], ahead: Past) -> Gaussian:
    """Return what is known at the start of the next block, with the changes in question."""
    model, [log] = fits[-1].model, fits[-1].logs
    sigma = model.walking_sigma * np.sqrt(log.blocks[-1].length)
    walking = boundary_size(model, log) + model.walking_columns
    gaussian = changed(ahead.gaussian, walking, sigma, np.zeros(len(sigma)), block=0)[0]
    gaussian = gaussian.condition(dict.fromkeys(_leaving(fits, gaussian), 0.0))
    return linked(gaussian, _at_end(fits[-1]), farthest(model), np.zeros(12))


def _following(fits: Sequence[Fit], ahead: Past, blocks: Sequence[Block]) -> LogState:
    """Return the log of blocks that follow."""
    log, model = joined(fits), fits[-1].model
    count, log = len(log.blocks), replace(log, past=ahead)
    for block in blocks:
        log = log.extended(model, block, ahead.start)
    return replace(log.part(count, len(log.blocks)), past=ahead).with_noise(converged=True)


def _fitted(
    before: Fit,
    log: LogState,
    gaussian: Gaussian,
    acting: Collection[str] = (),
    *,
    most: int = MOST_SWEEPS,
) -> Fit:
    """Return the fit of a log that follows another, with some of the changes in question."""
    assert log.past is not None
    past = gaussian.marginal(name for name in gaussian.places if name not in acting)
    past = past.condition(dict.fromkeys(_in_question(past), 0.0))
    log = replace(log, past=replace(log.past, gaussian=past))
    return fit(before.model, [log], values=before.values, most=most)


def _apart(
    fits: Sequence[Fit], ahead: Past, gaussian: Gaussian, block: Block
) -> tuple[tuple[Fit, ...], Past, Array] | None:
    """Return the result of `followed` if the momentum changed before the block."""
    last = fits[-1]
    log = _following(fits, ahead, [block])
    log = log.with_each(start=[state_of(last.model, log, last.values[PSI])])
    solved = _fitted(last, log, gaussian, [_at_end(last)])
    if not (solved.converged and is_explained(solved)):
        return None
    gaussian = gaussian.marginal(name for name in gaussian.places if name != _at_end(last))
    ahead = ahead_of(solved, _known_at_end(solved, gaussian))
    return (*fits[:-1], _opened_at_end(last), solved), ahead, NO_GAINS


def _with_changes(
    fits: Sequence[Fit], ahead: Past, gaussian: Gaussian, parts: Sequence[Block], question: Question
) -> tuple[tuple[Fit, ...], Past, Array] | None:
    """Return the result of `followed` if something changed between parts of a block or before.

    If it changed earlier, or before equal parts, it may have been inside of the block before: then
    it is none.
    """
    last, log, inner = fits[-1], _following(fits, ahead, parts), range(len(parts) - 1)
    if log.noise.slow_places:  # which changes are noise, only the noise of the window tells
        return None
    is_at_start, starts = len(parts) != 2, [ahead.start, *log.starts[1:]]
    for k in range(0 if is_at_start else 1, len(parts)):  # what a change has bent is no start
        starts[k] = state_of(last.model, log.part(k, k + 1), last.values[PSI])
    log = log.with_each(start=starts).opened(inner)
    wide = _fitted(last, log, gaussian, [_at_end(last)] if is_at_start else [], most=WIDE_SWEEPS)
    if not (wide.converged and is_explained(wide)):
        return None
    acting, possible = _acting(wide, gaussian, question), {log.change(k) for k in inner}
    if not acting or not possible.union([] if inner else [_at_end(last)]).issuperset(acting):
        return None
    opened = [k for k in inner if log.change(k) in acting]
    solved = _fitted(wide, wide.logs[0].opened(opened), gaussian, acting)
    if not (solved.converged and is_explained(solved) and _has_noise_of(fits, solved)):
        return None
    gaussian = gaussian.marginal(name for name in gaussian.places if name not in acting)
    end = _known_at_end(solved, gaussian, carry=[k for k in inner if k not in opened])
    last = last if inner else _opened_at_end(last)
    return (*fits[:-1], last, solved), ahead_of(solved, end), NO_GAINS


def _parts_beside_change(fits: Sequence[Fit], ahead: Past, block: Block) -> list[Block]:
    """Return the parts of a block before and behind a change.

    Behind it a sensor is far off what is predicted for the block. If none is, the parts are equal;
    if one is from the start on, it is the whole block.
    """
    log, values = _following(fits, ahead, [block]), fits[-1].values
    [rest], near, far = roll(fits[-1].model, log, values).residuals, list[float](), list[float]()
    for name, each in rest.items():
        if name in SENSORS and len(each):
            is_far = np.sqrt(np.mean(each**2, axis=1)) > FAR
            score = np.cumsum(np.where(is_far, 1, -1)[::-1])[::-1]  # far ones less others
            first, times = int(np.argmax(score)), [block.start, *block.samples[name].time.tolist()]
            if score[first] >= FEWEST_FAR:
                near.append(times[first])
                far.append(times[first + 1])
    if not far:
        return block.cut()
    before = max(time for time in near if time < min(far))
    edge = block.start if before == block.start else (before + min(far)) / 2
    edges = sorted({block.start, edge, block.end})
    return [block.part(a, b) for a, b in pairwise(edges)]


def _acting(wide: Fit, gaussian: Gaussian, question: Question) -> tuple[str, ...]:
    """Return the changes that act, of those in question and those inside of a block."""
    model, [log], [rolled], values = wide.model, wide.logs, wide.rolled, wide.values
    inner = range(len(log.blocks) - 1)
    total = _known_at_end(wide, gaussian, carry=inner)
    total = total.marginal(name for name in total.places if name != BOUNDARY)
    total = prior_of(model, [log], values).add(total)
    changes = {name: np.zeros(12) for name in _in_question(gaussian)}
    changes |= {log.change(k): rolled.jumps[k] for k in inner}
    sigma = dict.fromkeys(changes, farthest(model))
    best = question.answer(total, values | changes, sigma).best
    return tuple(name for name in best if name in changes)


def _opened_at_end(solved: Fit) -> Fit:
    """Return a fit that is open at its end."""
    [log] = solved.logs
    open_end = replace(Link.closed(solved.model.of_log(log.name)), is_open=True)
    return replace(solved, logs=[log.with_links([*log.links, open_end])])


def _at_end(solved: Fit) -> str:
    """Return the name of a change at the end of a fit."""
    [log] = solved.logs
    return log.change(len(log.blocks) - 1)


def _in_question(gaussian: Gaussian) -> list[str]:
    """Return the names of the changes that are in question."""
    return [name for name in gaussian.places if name.startswith(CHANGE)]


def _has_noise_of(fits: Sequence[Fit], solved: Fit) -> bool:
    """Return whether a fit has the noise of those before."""
    [log], window = solved.logs, [*fits, solved]
    residuals = [rest for each in window for rest in each.rolled[0].residuals]
    freedom = [each.logs[0].noise.freedom for each in window for _ in each.logs[0].blocks]
    return is_as_before(joined(window), residuals, freedom, len(log.blocks))


def _known_at_end(solved: Fit, gaussian: Gaussian, carry: Collection[int] = ()) -> Gaussian:
    """Return what is known at the end of a fit, if its past has the changes in question.

    Changes at the ends of some of its blocks are further ones.
    """
    model, [log], [rolled], values = solved.model, solved.logs, solved.rolled, solved.values
    assert log.past is not None
    before = past_of(model, replace(log, past=replace(log.past, gaussian=gaussian)), values)
    if solved.sweeps > 1:  # its derivatives may be those of the first sweep
        rolled = replace(rolled, jacobians={}, rows={})
    return sweep(model, log, rolled, values, carry=carry, before=before, forward_only=True).end


def _leaving(fits: Sequence[Fit], gaussian: Gaussian) -> list[str]:
    """Return the names of the changes that are no more in question: LINKS fits are behind them."""
    recent = {
        log.change(k) for each in fits[-LINKS:] for log in each.logs for k in range(len(log.blocks))
    }
    return [name for name in _in_question(gaussian) if name not in recent]


def _changes(solved: Fit, gaussian: Gaussian, question: Question) -> list[Gaussian]:
    """Return what is known of the changes in question, if the momentum is free, or as supposed."""
    model, logs, values = solved.model, solved.logs, solved.values
    total = gaussian.marginal(name for name in gaussian.places if name != BOUNDARY)
    total = prior_of(model, logs, values).add(total)
    supposed = question.held(values, ())
    given = [total.condition(held) for held in ({}, supposed)[: 1 + bool(supposed)]]
    return [each.marginal(_in_question(each)) for each in given]


def _torque_gains(fits: Sequence[Fit], changes: Gaussian) -> Array:
    """Return the sum of `gains_of_change` of the changes that are no more in question."""
    model, [log] = fits[-1].model, fits[-1].logs
    length, names = log.blocks[-1].length, _leaving(fits, changes)
    return sum((gains_of_change(model, changes, name, length) for name in names), NO_GAINS)
