"""One more block, solved alone: all before it is its past, and stays as it is.

The fit of one more block behind a Gaussian of all others is the fit of all blocks, if these are
linear about the new values, if the noise is as before, and if nothing changed between blocks. So it
is a filter, while these conditions hold; else the window of the last blocks is solved anew. A
change of momentum at one of the last ends is an unknown of its own in the past, which is
conditioned on zero: how much samples behind the end ask for it needs no other fit.

Source: Bierman 1977, ch. V (square-root information filter).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.elimination import changed, linked
from cpid_drake.estimation.evidence import Question, is_possible_change
from cpid_drake.estimation.fit import Fit, fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.linearity import WELL_KNOWN, inertia_error, is_linear
from cpid_drake.estimation.log_state import LogState, farthest
from cpid_drake.estimation.noise import is_as_before
from cpid_drake.estimation.past import Past
from cpid_drake.estimation.process import added
from cpid_drake.estimation.roll import past_of
from cpid_drake.estimation.sweep import BOUNDARY, boundary_size, sweep
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.estimation.unknowns_prior import prior_of
from cpid_drake.estimation.weights import noise_sums
from cpid_drake.files.errors import InputError

LINKS = 3
"""Changes at so many of the last ends are in question."""

MOST_SWEEPS = 4
"""Most sweeps of one block: else the window is solved."""

SAME_NOISE = 0.15
"""Relative change of the size of white forces for which blocks before need not be solved anew."""

_CHANGE = "change at "  # name of an unknown change, before its time [s]


def followed(
    fits: Sequence[Fit], ahead: Past, block: Block, question: Question
) -> tuple[Fit, Past] | None:
    """Return the fit of one more block alone, and what is known ahead of it; None if it is none.

    Args:
        fits: of the blocks of the window, each of those behind the past of the next.
        ahead: what is known at their end; see `ahead_of`.
        block: the samples that follow without a gap.
        question: what is compared with changes of the momentum.

    """
    try:
        found, changes = _one_more(fits, ahead, block)
        if not found.converged or not _is_as_before(found, fits):
            return None
        known = _known_at_end(found, changes)
        if _may_change(found, known, question):
            return None
    except (InputError, np.linalg.LinAlgError):
        return None
    return found, ahead_of(found, known)


def joined(fits: Sequence[Fit]) -> LogState:
    """Return the log of all blocks of the window."""
    model = fits[0].model
    return reduce(lambda log, other: log.followed(model, other), (each.logs[0] for each in fits))


def ahead_of(found: Fit, known: Gaussian) -> Past:
    """Return the past of the block that follows.

    Args:
        found: the fit of the block before, or of the window.
        known: what is known at its end, as `Swept.end`, and then of changes.

    """
    model, [log], [rolled], values = found.model, found.logs, found.rolled, found.values
    first = {u.name: values[u.name] for u in model.table if u.scope != "log"}
    if log.past and inertia_error(found) < WELL_KNOWN:  # the past says little before
        first = {**log.past.first}
    own = noise_sums(log, rolled.residuals, log.freedom)
    return Past(
        replace(known, rho2=0.0),
        rolled.ends[-1],
        log.joints[-1].coefficients[-ORDER:],
        np.concatenate([values[u.key(log.name)] for u in model.table]),
        first,
        added(log.past.noise if log.past else {}, own),
        log.slow,
        log.edges[-1],
    )


def _one_more(fits: Sequence[Fit], ahead: Past, block: Block) -> tuple[Fit, Gaussian]:
    """Return the fit of one more block, and its past with the changes that are in question."""
    last, before = fits[-1], joined(fits)
    model, values = last.model, last.values
    sigma = model.walking_sigma * np.sqrt(before.blocks[-1].length)
    walking = boundary_size(model, before) + model.walking_columns
    known = changed(ahead.gaussian, walking, sigma, np.zeros(len(sigma)), block=0)[0]
    past = replace(ahead, gaussian=known.condition(dict.fromkeys(_changes(known), 0.0)))
    log = replace(before, past=past).extended(model, block, ahead.start)
    log = replace(log.part(len(before.blocks), len(log.blocks)), past=past, is_known=True)
    found = fit(model, [log], values=values, most=MOST_SWEEPS)
    gone = _changes(known)[: 1 - LINKS]
    known = known.condition(dict.fromkeys(gone, 0.0))
    name = f"{_CHANGE}{block.start}"
    return found, linked(known, name, farthest(model), np.zeros(12))


def _changes(known: Gaussian) -> list[str]:
    """Return the names of the changes that are in question."""
    return [name for name in known.places if name.startswith(_CHANGE)]


def _is_as_before(found: Fit, fits: Sequence[Fit]) -> bool:
    """Return whether fits before are linear about the values of this one, with the same noise."""
    [log], targets = found.logs, np.array([each.values[PSI] for each in fits])
    if not is_linear(found, targets):
        return False
    for each in fits:
        [before] = each.logs
        for name in {*log.noise, *before.noise}:
            ratio = log.noise.get(name, 1.0) / before.noise.get(name, 1.0)
            if abs(np.log(ratio)) > SAME_NOISE:
                return False
    window = [*fits, found]
    residuals = [rest for each in window for rest in each.rolled[0].residuals]
    return is_as_before(joined(window), residuals)


def _known_at_end(found: Fit, changes: Gaussian) -> Gaussian:
    """Return what is known at the end of the block, if the past has the changes in question."""
    model, [log], [rolled], values = found.model, found.logs, found.rolled, found.values
    assert log.past is not None
    log = replace(log, past=replace(log.past, gaussian=changes))
    before = past_of(model, log, values)
    if found.sweeps > 1:  # its derivatives are those of the first sweep
        rolled = replace(rolled, linear={}, rows={})
    return sweep(model, log, rolled, values, before=before, forward_only=True).end


def _may_change(found: Fit, known: Gaussian, question: Question) -> bool:
    """Return whether something may have changed at one of the last ends."""
    model, logs, values = found.model, found.logs, found.values
    total = known.marginal(name for name in known.places if name != BOUNDARY)
    total = prior_of(model, logs, values).add(total)
    asked = question.without_contradicted(found.gaussian, values, model)
    zero = dict.fromkeys(asked.candidates, np.zeros(6))
    for momenta in (asked.given, *([zero] if zero else [])):
        about = total.condition({name: each - values[name] for name, each in momenta.items()})
        if is_possible_change(about.marginal(_changes(about)), farthest(model)):
            return True
    return False
