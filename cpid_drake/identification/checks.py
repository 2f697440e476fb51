"""The checks that every identification passes or fails.

An estimator computes its intervals under the assumption that the world is as modelled. Each check
here tests one consequence of this assumption with the data, and becomes one of
`Identification.checks`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.whiteness import MOST_CORRELATED
from cpid_drake.identification.consistency import with_consistency
from cpid_drake.identification.result import Check
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.sensors.sensors import SENSORS

SUSPECTED = 0.1
"""Probability from which an error, or a momentum, that may act is mentioned."""

MOST_NOISE = 4.0
"""Ratio of the noise to the given one above which a check fails; hardware may have three times."""

SEEN = 1.1
"""Factor of the noise from which a warning says so."""

MOST_UNEXPLAINED = 0.1
"""Share of the samples that nothing explains, above which a check fails."""

LARGER_NOISE = "the noise is larger than the sensors' file declares"
"""The beginning of the failed check of larger noise, which makes other causes seem likely."""

MOST_REJECTED = 0.5
"""Share of unusable samples of one sensor above which a check fails."""

NEAREST = "distance of the nearest rigid body"
"""Name of the check that some rigid body has the estimate."""


def checked(found: SolvedIdentification, tree: KinematicTree) -> SolvedIdentification:
    """Return an identification with the checks of its residuals, its noise and its body.

    Args:
        found: the identification.
        tree: the known spacecraft.

    """
    found = with_consistency(found, tree)
    checks = [*found.checks, *_of_the_fit(found)]
    if found.rank:  # else no number is shown
        checks += _of_the_body(found)
    # The larger noise explains the other failures.
    checks.sort(key=lambda check: (check.passed, LARGER_NOISE not in check.sentence))
    return replace(found, checks=tuple(checks))


def _of_the_fit(found: SolvedIdentification) -> Iterator[Check]:
    """Yield the checks of the solver and of the residuals."""
    sentence = "the estimator did not converge: its result is not the best fit"
    yield Check.of("convergence", sentence, passed=found.converged)
    sentence = (
        f"the momentum balance misses the samples by {found.misfit:.2g} times their errors: the "
        "spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
    )
    yield Check.of("misfit", sentence, found.misfit, MOST_NOISE)
    sentence = f"nothing explains {100 * found.unexplained:.0f} % of the log"
    yield Check.of("unexplained share", sentence, found.unexplained, MOST_UNEXPLAINED)
    yield from _of_the_noise(found)
    for name, count in found.rejected.items():
        if found.sample_count:
            share = count / (count + found.sample_count)
            sentence = f"{count} samples of {name} could not be used"
            yield Check.of(f"rejected share of {name}", sentence, share, MOST_REJECTED)


def _of_the_noise(found: SolvedIdentification) -> Iterator[Check]:
    """Yield the checks that the residuals of each sensor are its noise."""
    noisier: dict[str, list[str]] = {}
    tests = found.tests
    # A negative correlation shows no cause: unknowns of blocks take what is slow.
    coloured = {n for n, t in tests.items() if t.fails or t.lag_one > max(t.band, 0.1)}
    larger = {name: factor for name, factor in found.noise.items() if factor > MOST_NOISE}
    for name, factor in larger.items():
        if name not in coloured:
            sensor, _, log = name.partition(" of ")
            part = f"that of the {label_of(sensor)} {factor:.2g} times"
            noisier.setdefault(f"{log}: " if log else "", []).append(part)
    for where, parts in noisier.items():
        sentence = f"{where}{LARGER_NOISE}: {', '.join(parts)} the given one"
        yield Check.of("noise", sentence, max(larger.values()), MOST_NOISE)
    for name, test in tests.items():
        sentence = (
            f"the residuals of the {label_of(name)} are correlated from sample to sample "
            f"({test.lag_one:+.2f}) and weigh as much as {found.noise.get(name, 1.0):.2g} times "
            "the given noise: their cause is not in the intervals"
        )
        limit = max(test.band, 0.1) if name in larger else MOST_CORRELATED
        fails = test.fails or (name in coloured and name in larger)
        yield Check.of(f"correlation of {name}", sentence, test.lag_one, limit, not fails)


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
    if probability <= SUSPECTED or is_given:
        return (), ()
    text = f"{where}the total momentum may not be zero (probability {probability:.2g})"
    return (f"{text}; the intervals include it",), ()


def noise_warnings(factors: Mapping[str, float]) -> tuple[str, ...]:
    """Return the warning about noise that is larger than declared.

    Args:
        factors: of the declared σ, by sensor or by "sensor of log".

    """
    seen = {name: factor for name, factor in factors.items() if factor > SEEN}
    parts = [f"the {label_of(name)} {factor:.2g} times" for name, factor in seen.items()]
    if not parts:
        return ()
    text = "the residuals are larger than the noise, or correlated in time"
    return (f"{text}: {', '.join(parts)} the given σ was assumed",)


def label_of(sensor: str) -> str:
    """Return the label of a sensor, or of a "sensor of log"."""
    name, of, log = sensor.partition(" ")
    label = SENSORS[name].label if name in SENSORS else name.replace("_", " ")
    return f"{label}{of}{log}"


def _of_the_body(found: SolvedIdentification) -> Iterator[Check]:
    """Yield the checks that a rigid body has the estimate, within its covariance."""
    shown = np.isfinite(found.parameters)
    if not np.isfinite(np.diag(found.covariance)[shown]).all():
        if found.sensors is not None or not 0 < found.solution.row_count <= found.rank:
            yield Check("uncertainty", "the uncertainty of the estimate could not be computed")
        return  # as many rows as unknowns: no residuals show the noise
    problems = "; ".join(found.infeasibilities)
    sentence = "no rigid body agrees with the estimate within its uncertainty"
    sentence += f" ({problems})" if problems else ""
    sentence += ": the momentum, the spacecraft's model, units, signs or frames are not as assumed"
    consistency = found.consistency
    if consistency is None:
        yield Check.of(NEAREST, sentence, passed=not problems)
    else:
        yield Check.of(NEAREST, sentence, consistency.distance, consistency.radius)
