"""Whether the first halves of the logs have the target of the whole logs.

A body that is not as declared, or a joint that slips, is taken up by the unknowns of half a log as
by those of all of it, but by others: no residual shows it.
"""

import numpy as np

from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.identification.checks import Check, halves_check

_CAUSE = "a joint or the grasp slips, or a body, a clock or a force is not as modelled"


def part_checks(found: Fit, held: Values) -> tuple[Check, ...]:
    """Return the check of the first halves; none if a log is too short.

    Args:
        found: a fit.
        held: unknowns that are held, with their values less those of the fit.

    """
    beginning = _beginning(found)
    if beginning is None:
        return ()
    psi, held = found.values[PSI], {n: v for n, v in held.items() if n in beginning.places}
    first = known_target(found.model, psi, beginning.condition(held)).known
    whole = found.gaussian.condition(held).marginal([PSI]).moved(-psi)
    return (halves_check(first, whole, _CAUSE),)


def _beginning(found: Fit) -> Gaussian | None:
    """Return the Gaussian of the first halves of all logs; None if a log is too short."""
    known = prior_of(found.model, found.logs, found.values)
    for log, rolled in zip(found.logs, found.rolled, strict=True):
        middle = (log.blocks[0].start + log.blocks[-1].end) / 2
        k = sum(block.end <= middle for block in log.blocks)
        if not 0 < k < len(log.blocks):
            return None
        parts = log.part(0, k), rolled.part(0, k), _values_at(found, log, k)
        known = known.add(sweep(found.model, *parts, forward_only=True).gaussian)
    return known


def _values_at(found: Fit, log: LogState, k: int) -> Values:
    """Return the values at the end of the first k blocks of a log."""
    values, later = dict(found.values), np.sum(log.walks[k:], axis=0)
    for unknown in found.model.of_log(log.name).walking:
        step, later = np.split(later, [unknown.size])
        values[unknown.key(log.name)] = values[unknown.key(log.name)] - step
    return values
