"""The estimates from the samples up to each time, from one pass through a log that is fitted."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.sweep import BOUNDARY, sweep
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.identification.result import Identification

MOST_ESTIMATES = 50
"""Number of estimates of a log, at most."""


def over_time(
    found: Fit, held: Mapping[str, NDArray[np.float64]], estimator: str
) -> Sequence[tuple[float, Identification]]:
    """Return times [s] and estimates, without checks: what earlier samples say at the fit's values.

    Args:
        found: the fit of one log.
        held: unknowns that are held, with their values less those of the fit.
        estimator: name of the estimator.

    """
    [log], [rolled], model = found.logs, found.rolled, found.model
    ends = range(len(log.blocks) - 1)[:: -(-len(log.blocks) // MOST_ESTIMATES)]
    swept = sweep(model, log, rolled, found.values, forward_only=True, stops=ends)
    prior, form = prior_of(model, [log], found.values), relative_parameterization(model.mass)
    counts = np.cumsum([sum(map(len, block.samples.samples.values())) for block in log.blocks])
    estimates = []
    for k in ends:
        known = swept.stops[k]
        target = known.marginal(name for name in known.places if name != BOUNDARY).add(prior)
        target = target.condition({name: v for name, v in held.items() if name in target.places})
        estimate = Identification.of_solution(
            form,
            known_target(model, found.values[PSI], target, count=int(counts[k])),
            sensors=model.suite,
            sample_count=int(counts[k]),
            estimator=estimator,
        )
        estimates.append((log.blocks[k].end, estimate))
    return estimates
