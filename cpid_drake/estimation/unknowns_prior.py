"""What is known of all unknowns without samples."""

from collections.abc import Sequence

import numpy as np

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import loss_weight
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import PSI, Model


def prior_of(
    model: Model,
    logs: Sequence[LogState],
    values: Values,
    weighed_at: Values | None = None,
) -> Gaussian:
    """Return what is known without samples, about the present values.

    See `hardware_prior_of`.
    """
    prior = hardware_prior_of(model, logs, values, weighed_at)
    return prior.add(model.cone.prior(PSI, values[PSI]))


def hardware_prior_of(
    model: Model,
    logs: Sequence[LogState],
    values: Values,
    weighed_at: Values | None = None,
) -> Gaussian:
    """Return what is known without samples but the target's sizes, about the present values.

    Args:
        model, logs, values: see `fit`.
        weighed_at: values from which priors with heavy tails get their weights, which stay during
            a step as those of the samples do; default: the present values.

    """
    weighed_at = values if weighed_at is None else weighed_at
    sizes, R, z = {}, [], []
    for name, (_, unknown) in model.unknowns_of(log.name for log in logs).items():
        if unknown.walk or unknown.name == PSI:  # the prior of what walks is in the sweep
            continue
        sizes[name], sigma = unknown.size, unknown.sigma
        if unknown.may_fail:
            sigma = sigma / loss_weight(weighed_at[name])
        R.append(1 / sigma)
        z.append((unknown.mean - values[name]) / sigma)
    diagonal = np.concatenate([np.empty(0), *R])
    right = np.concatenate([np.empty(0), *z])
    prior = Gaussian.of_rows(sizes, np.column_stack([np.diag(diagonal), right]))
    for row in model.rows:
        prior = prior.add(row.minus(np.concatenate([values[name] for name in row.places])))
    return prior
