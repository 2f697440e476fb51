"""The checks that every identification passes or fails.

An estimator computes its intervals under the assumption that the world is as modelled. Each check
here tests one consequence of this assumption with the data, and becomes one of
`Identification.checks`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from cpid_drake.estimation.events import most_changes
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import IMPROBABLE as IMPROBABLE
from cpid_drake.estimation.spectrum import slow_part
from cpid_drake.estimation.whiteness import MOST_CORRELATED, Whiteness
from cpid_drake.files.digits import significant
from cpid_drake.sensors.sensors import SENSORS

AGREEMENT, CONVERGENCE, NEAREST = "agreement", "convergence", "distance of the nearest rigid body"
"""Names of the checks that sources have one target, a fit is the best, and a rigid body has it."""

MOST_NOISE = 4.0
"""Ratio of the noise to the given one above which a check fails; hardware may have three times."""

SEEN = 1.1
"""Factor of the noise from which a warning says so."""

SLOW = 0.1
"""Share of slow noise in the variance from which a warning says so."""

MOST_OUTLIERS = 0.1
"""Share of outliers above which a check fails."""

ROUGH = 2.0
"""Factor to which residuals of rows in different units show the σ of an estimate."""

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


def fit_checks(
    converged: bool,
    outliers: float,
    noise: Mapping[str, float],
    tests: Mapping[str, Whiteness],
    changes: int = 0,
    logs: int = 1,
) -> Iterator[Check]:
    """Yield the checks of a fit.

    Args:
        converged: whether it reached its minimum.
        outliers: largest share of outliers, which are not used, in the samples of a sensor.
        noise: factors of the declared σ, by sensor or by "sensor of log".
        tests: whiteness of the residuals of each sensor.
        changes: number of changes of the momentum that the fit found. They must explain what looked
            like noise, and be rare, as the fit assumes: enough changes imitate any other cause.
        logs: number of logs.

    """
    sentence = "the estimator did not converge: its result is not the best fit"
    yield Check.of(CONVERGENCE, sentence, passed=converged)
    sentence = f"{100 * outliers:.0f} % of a sensor's samples are outliers"
    yield Check.of("share of outliers", sentence, outliers, MOST_OUTLIERS)
    largest = max(noise.values(), default=1.0)
    if changes:
        most = float(most_changes(logs))
        what = "are many" if changes > most else "leave residuals that are larger than noise"
        sentence = (
            f"{changes} changes of the momentum {what}: another cause, such as a force, a hidden "
            "wheel, a flexible grasp or correlated noise, may look like changes"
        )
        # The size of a few residuals is as uncertain as their correlation.
        larger = any(noise.get(n, 1.0) > max(SEEN, 1 + test.band) for n, test in tests.items())
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
    parts = [f"that of the {label_of(n)} {significant(factor)} times" for n, factor in loud.items()]
    sentence = "the noise is larger than the sensors' file declares: "
    sentence += f"{', '.join(parts)} the given one"
    yield Check.of(NOISE, sentence, largest, MOST_NOISE, not loud)


def halves_check(
    first: Gaussian,
    whole: Gaussian,
    cause: str,
    *,
    rests: float | None = None,
    freedom: int = 0,
) -> Check:
    """Return the check that the first half of the samples has the target of all of them.

    Of nested samples, the difference of two estimates has the difference of their covariances as
    covariance (Hausman 1978, Econometrica 46). What the rest hardly improves is left out.

    Args:
        first, whole: what is known of the target from the first half, and from all samples.
        cause: what another target means.
        rests: sum of squares of the residuals of all samples, if only they show the noise; the
            Gaussians then have errors of any size. The residuals without the difference show the
            noise, to `ROUGH` (Chow 1960, Econometrica 28).
        freedom: degrees of freedom of these residuals.

    """
    scale = np.linalg.norm(whole.R, axis=0)
    scale[scale == 0] = 1.0
    by_whole = first.R @ (np.linalg.pinv(whole.R / scale) / scale[:, None])
    U, ratio, _ = np.linalg.svd(by_whole)  # of σ after and before
    seen = ratio**2 < 0.99  # less is rounding and bends of the equations
    change = (U.T @ (first.z - first.R @ whole.solve()))[seen]
    statistic, count = float(np.sum(change**2 / (1 - ratio[seen] ** 2))), int(seen.sum())
    limit = float(chdtri(max(count, 1), IMPROBABLE))
    if rests is not None:
        left = freedom - count
        if count < 1 or left < 1:
            return Check.of("halves", "", passed=True)
        statistic *= left / max(rests - statistic, 1e-12 * rests, 1e-300)
        limit = ROUGH**2 * count * float(fdtri(count, left, 1 - IMPROBABLE))
    text = f"the first half of the samples has another target than all of them: {cause}"
    return Check.of("halves", text, statistic, limit)


def rejection_checks(
    rejected: Mapping[str, int], used: Mapping[str, int], where: str = ""
) -> Iterator[Check]:
    """Yield the checks that most samples of a sensor could be used, from their numbers."""
    for name, count in rejected.items():
        if count:
            total = count + used.get(name, 0)
            text = f"{where}{count} of {total} samples of {name} could not be used"
            yield Check.of(f"rejected share of {name}", text, count / total, 0.5)


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


def noise_warnings(
    factors: Mapping[str, float], spectra: Mapping[str, NDArray[np.float64]]
) -> tuple[str, ...]:
    """Return the warnings about noise that is larger than declared, and that is not white.

    Args:
        factors: see `fit_checks`.
        spectra: of the noise, by sensor or by "sensor of log".

    """
    said = list[str]()
    seen = {name: factor for name, factor in factors.items() if factor > SEEN}
    parts = [f"the {label_of(name)} {significant(factor)} times" for name, factor in seen.items()]
    if parts:
        text = "the residuals are larger than the declared noise"
        said.append(f"{text}: {', '.join(parts)} the given σ was assumed")
    slow = {name: slow_part(spectrum) for name, spectrum in spectra.items()}
    parts = [
        f"{100 * share:.0f} % of the {label_of(name)}'s over {significant(time)} s"
        for name, (share, time) in slow.items()
        if share > SLOW
    ]
    if parts:
        text = "noise is correlated in time, which the intervals contain"
        said.append(f"{text}: {', '.join(parts)}")
    return tuple(said)


def label_of(sensor: str) -> str:
    """Return the label of a sensor, or of a "sensor of log"."""
    name, of, log = sensor.partition(" ")
    label = SENSORS[name].quantity if name in SENSORS else name.replace("_", " ")
    return f"{label}{of}{log}"
