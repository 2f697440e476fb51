"""The check that forces and torques change no more than their random walks may.

The steps of what walks are unknowns with a prior, as constant errors are. If something else acts,
such as wheels that are not in the log, they follow it as well as they can, and are larger than
their prior says. The χ² of the smoothed steps is a sum of squares, each with a variance of at most
one. For a given mean it is largest with as many squares of variance one as the mean says.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.least_squares import improbable
from cpid_drake.estimation.sweep import sweep, walked
from cpid_drake.files.digits import significant
from cpid_drake.identification.checks import Check

WALKS = "random walks"
"""Name of the check."""


@dataclass(frozen=True)
class Walk:
    """The steps of an unknown that walks.

    Attributes:
        log: name of the log.
        name: of the unknown.
        square: χ² of the smoothed steps.
        mean: of this χ², if they are as stated; 1 or more.

    """

    log: str
    name: str
    square: float
    mean: float

    @property
    def limit(self) -> float:
        """The χ² above which the steps are improbable."""
        return improbable(self.mean)


def walks_of(fit: Fit) -> Iterator[Walk]:
    """Yield the steps of all that walks in each log."""
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        model = fit.model.of_log(log.name)
        if not log.links or not model.walking:
            continue
        times = np.array([log.interval(k) for k in range(len(log.links))])
        # Σ u² / (σ² Δt)
        squares = (np.array([link.walk for link in log.links]) / model.walking_sigma) ** 2 / times[
            :, None
        ]
        if float(np.sum(squares)) <= improbable(1):  # as few as one are not improbable
            yield Walk(log.name, model.walking[0].name, float(np.sum(squares)), 1.0)
            continue
        swept = sweep(model, log, rolled, fit.values)
        posterior = swept.end.add(prior_of(model, [log], fit.values))
        for name, (square, mean) in walked(model, log, swept, posterior).items():
            yield Walk(log.name, name, square, max(mean, 1.0))


def walk_checks(fit: Fit) -> tuple[Check, ...]:
    """Return the check of the steps of all that walks; none if nothing does."""
    walks = list(walks_of(fit))
    if not walks:
        return ()
    worst = max(walks, key=lambda each: each.square / each.limit)
    of_log = f" of {worst.log}" if len(fit.logs) > 1 else ""
    sensor, _, kind = worst.name.rpartition(".")
    what = f"{kind} of the {sensor}" if sensor else kind
    cause = (
        f"state {kind}_random_walk of the {sensor}"
        if sensor
        else "something acts that changes faster, such as wheels or cables; state its noise as "
        "torque_noise or acceleration_noise"
    )
    sentence = (
        f"the {what.replace('_', ' ')}{of_log} changes "
        f"{significant((worst.square / worst.mean) ** 0.5)} times as much as its random walk: "
        f"{cause}, or look for the cause"
    )
    return (Check.of(WALKS, sentence, worst.square, worst.limit),)
