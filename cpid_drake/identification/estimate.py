"""What a fit knows of the target, of constant errors and of the momentum, in a result's terms.

All functions read a Gaussian of x − values, from all logs, priors included. A momentum that is
known is a condition on this Gaussian; see `at_momentum`.
"""

from typing import Any

import numpy as np

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation import gaussian as gaussians
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, undetermined
from cpid_drake.identification.effects import EffectEstimate

IN_PLANE = (2, 3, 4)
"""Entries of a momentum (L, v) that a table leaves free."""


def at_momentum(gaussian: Gaussian, values: Values, momentum: TotalMomentum, log: str) -> Gaussian:
    """Return what is known if a log has this momentum; the same if it is unknown."""
    if momentum.is_unknown:
        return gaussian
    key = f"{MOMENTUM}|{log}"
    return gaussian.condition(
        {key: np.concatenate([momentum.L_WScm_W, momentum.v_WScm_W]) - values[key]}
    )


def solution_of(
    model: Model, values: Values, gaussian: Gaussian, *, cost: float = np.nan, count: int = 0
) -> LeastSquaresSolution:
    """Return the target's ψ about the nominal mass of the known bodies.

    Args:
        model, values, gaussian: as in all functions here, of one log or of many.
        cost, count: sum of squares of the samples' residuals, and their number.

    """
    _, sizes = undetermined(model, values[PSI], gaussian)
    target = gaussian.marginal([PSI]).moved(-values[PSI])
    return gaussians.solution_of(target, values[PSI], sizes, residual_sum=cost, row_count=count)


def effects_of(
    model: Model, values: Values, gaussian: Gaussian, log: str
) -> tuple[EffectEstimate, ...]:
    """Return the estimates of constant errors of a log; of those that walk, the last value."""
    errors = model.constants.errors
    unknowns = [u for u in model.table if u.name in errors and u.key(log) in gaussian.places]
    if not unknowns:
        return ()
    both = gaussian.marginal([each.key(log) for each in unknowns])
    step, sigma = both.solve(), np.sqrt(np.diag(both.covariance()))
    has_others = sum(name.startswith(f"{MOMENTUM}|") for name in values) > 1
    found = []
    for unknown in unknowns:
        place = both.places[unknown.key(log)]
        value, name = values[unknown.key(log)] + step[place], log if unknown.scope == "log" else ""
        found.append(
            EffectEstimate.of(errors[unknown.name], value, sigma[place], name if has_others else "")
        )
    return tuple(found)


def momentum_of(model: Model, values: Values, gaussian: Gaussian, log: str) -> dict[str, Any]:
    """Return a result's fields of L at the start of a log, and v_WScm if positions are measured.

    There are none if the momentum is known.
    """
    key = f"{MOMENTUM}|{log}"
    if key not in gaussian.places:
        return {}
    found = gaussian.marginal([key])
    count = 6 if "position" in model.suite.present() else 3
    entries = np.array(IN_PLANE[: count // 2] if model.tree.normal_B is not None else range(count))
    value, covariance = values[key] + found.solve(), found.covariance()
    return {
        "momentum_estimate": value[entries],
        "momentum_covariance": covariance[np.ix_(entries, entries)],
    }
