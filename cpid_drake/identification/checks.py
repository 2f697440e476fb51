"""The checks that every identification passes or fails.

An estimator computes its intervals under the assumption that the world is as modelled. Each check
here tests one consequence of this assumption with the data, and becomes one of
`Identification.checks`.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cpid_drake.estimation.events import most_changes
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.whiteness import MOST_CORRELATED
from cpid_drake.files.digits import significant
from cpid_drake.identification.observed import Observed
from cpid_drake.identification.words import LARGER_NOISE, label_of

CONSERVATION = "conservation of momentum"
"""Name of the check that residuals of rows are no more than samples and integration explain."""

BIAS = "bias by noise in rows"
"""Name of the check that noise inside of rows moves no estimate by its σ."""

AGREEMENT, CONVERGENCE, NEAREST = "agreement", "convergence", "distance of the nearest rigid body"
"""Names of the checks that sources have one target, a fit is the best, and a rigid body has it."""

MOST_NOISE = 4.0
"""Ratio of the noise to the given one above which a check fails; hardware may have three times."""

MOST_OUTLIERS = 0.1
"""Share of outliers above which a check fails."""

NOISE = "noise"
"""Name of the check of larger noise, which makes other causes seem likely."""


@dataclass(frozen=True)
class Check:
    """A consequence of the assumptions behind an estimate that was tested with the data.

    Attributes:
        name: what was checked.
        sentence: what the failure means; empty if the check passed.
        statistic: what was compared with the limit; None if it is not one finite number.
        limit: where the check begins to fail.
        passed: whether the data agree with the assumptions.

    """

    name: str
    sentence: str
    statistic: float | None = None
    limit: float | None = None
    passed: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        sentence: str,
        statistic: float | None = None,
        limit: float | None = None,
        passed: bool | None = None,
    ) -> "Check":
        """Return a check; by default it passes if its statistic is at most its limit."""
        if passed is None:
            passed = statistic is not None and limit is not None and bool(statistic <= limit)
        shown = float(statistic) if statistic is not None and np.isfinite(statistic) else None
        return cls(name, "" if passed else sentence, shown, limit, passed)


def fit_checks(converged: bool, observed: Observed) -> Iterator[Check]:
    """Yield the checks of a fit that reached its minimum or not.

    Changes of the momentum must explain what looked like noise, and be rare, as the fit assumes:
    enough changes imitate any other cause.

    Args:
        converged: whether it did.
        observed: what its samples show.

    """
    tests, noise, changes = observed.tests, observed.noise, len(observed.changes)
    sentence = "the estimator did not converge: its result is not the best fit"
    yield Check.of(CONVERGENCE, sentence, passed=converged)
    outliers = observed.worst_share
    sentence = f"{100 * outliers:.0f} % of a sensor's samples are outliers"
    yield Check.of("share of outliers", sentence, outliers, MOST_OUTLIERS)
    others = dict(noise)  # of which no correlation is said
    if changes:
        most = float(most_changes(max(len(observed.gaps), 1)))
        what = "are many" if changes > most else "leave residuals that are larger than noise"
        sentence = (
            f"{changes} changes of the momentum {what}: another cause, such as a force, a hidden "
            "wheel, a flexible grasp or correlated noise, may look like changes"
        )
        # The size of a few residuals is as uncertain as their correlation.
        larger = any(
            noise.get(n, 1.0) > max(LARGER_NOISE, 1 + test.band) for n, test in tests.items()
        )
        fails = changes > most or larger
        yield Check.of("changes of the momentum", sentence, changes, most, not fails)
    loud = {name: factor for name, factor in noise.items() if factor > MOST_NOISE}
    for name, test in tests.items():
        # A negative correlation shows no cause: unknowns of blocks take what is slow.
        fails = test.fails or (name in loud and test.lag_one > 0 and not test.is_white)
        sentence = (
            f"the residuals of the {label_of(name)} are correlated from sample to sample "
            f"({test.lag_one:+.2f}) and weigh as much as {significant(noise.get(name, 1.0))} times "
            "the given noise: their cause is not in the intervals"
        )
        yield Check.of(f"correlation of {name}", sentence, test.lag_one, MOST_CORRELATED, not fails)
        if fails:
            loud.pop(name, None)
            others.pop(name, None)
    largest = max(others.values(), default=1.0)
    parts = [f"that of the {label_of(n)} {significant(factor)} times" for n, factor in loud.items()]
    sentence = "the noise is larger than the sensors' file declares: "
    sentence += f"{', '.join(parts)} the given one"
    yield Check.of(NOISE, sentence, largest, MOST_NOISE, not loud)


def momentum_words(
    probability: float, *, is_given: bool, cannot: str = "", where: str = ""
) -> tuple[tuple[str, ...], tuple[Check, ...]]:
    """Return the warnings and failed checks about a momentum that may not be zero.

    Args:
        probability: of a momentum that is not as given, or not zero.
        is_given: whether the caller has given it.
        cannot: name of the rows that cannot estimate it; empty if it was estimated.
        where: beginning of all sentences.

    """
    text = f"{where}the samples contradict a total momentum of zero"
    if probability >= NAMED and cannot:
        text += f", and {cannot} cannot estimate it: identify with --momentum unknown and"
        text += " another estimator, such as least_squares with --rows standard"
        return (), (Check("momentum", text),)
    if probability >= NAMED and is_given:
        text += ", which may bias the estimate: identify with --momentum unknown"
        return (), (Check("momentum", text),)
    if probability >= NAMED:
        return (f"{text}, so the momentum was estimated; say so with --momentum unknown",), ()
    if probability <= 1 - NAMED or is_given:
        return (), ()
    text = f"{where}the total momentum may not be zero (probability {probability:.2g})"
    return (f"{text}; the intervals include it",), ()
