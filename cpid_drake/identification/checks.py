"""The checks that every identification passes or fails.

An estimator computes its intervals under the assumption that the world is as modelled. Each check
here tests one consequence of this assumption with the data, and becomes one of
`Identification.checks`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.estimation.whiteness import MOST_CORRELATED
from cpid_drake.identification.problem import MOST_NOISE
from cpid_drake.identification.result import Check
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.sensing.sensors import SENSORS

SEEN = 1.1
"""Factor of the noise from which a warning says so."""

MOST_UNEXPLAINED = 0.1
"""Share of the samples that nothing explains, above which a check fails."""

LARGER_NOISE = "the noise is larger than the sensors' file declares"
"""The beginning of the failed check of larger noise, which makes other causes seem likely."""

IMPOSSIBLE = 1e-4
"""Probability of an estimate so far from every rigid body below which a check fails."""

SMALLEST_VIOLATION = 1e-4
"""A change of the parameters by this share of their scale fails no check: it is rounding."""

MOST_REJECTED = 0.5
"""Share of unusable samples of one sensor above which a check fails."""

ROUNDING = 1e-9
"""A change of the inertia by this share of the inertia about C fails no check."""

NEAREST = "distance of the nearest rigid body"
"""Name of the check that some rigid body has the estimate."""

_SIGMAS = 4.0  # of a single quantity that no rigid body can have

_NOT_NEGATIVE = {
    "m": {0: 1.0},
    "Ixx": {4: 1.0},
    "Iyy": {5: 1.0},
    "Izz": {6: 1.0},
    "Ixx + Iyy - Izz": {4: 1.0, 5: 1.0, 6: -1.0},
    "Ixx - Iyy + Izz": {4: 1.0, 5: -1.0, 6: 1.0},
    "-Ixx + Iyy + Izz": {4: -1.0, 5: 1.0, 6: 1.0},
}
"""Sums of parameters that no rigid body makes negative: indices and factors of the parameters."""


def checked(found: SolvedIdentification) -> SolvedIdentification:
    """Return an identification with the checks of its residuals, its noise and its body."""
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
    white = found.whiteness
    limit, sentence = MOST_NOISE, f"the fit misses the samples by {found.misfit:.2g} times the "
    if found.misfit <= MOST_NOISE and found.rows is not None:
        limit = 1.0
        sentence = (
            f"the momentum balance misses the samples by {found.misfit:.2g} times their errors: "
            "the spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
        )
    elif found.misfit <= MOST_NOISE and white is not None and not white.is_white:
        limit = 1.0
        sentence += (
            f"assumed noise, and its residuals are correlated ({white.lag_one:+.2f}), so noise "
            "does not explain them"
        )
    else:
        sentence += "assumed noise"
    yield Check.of("misfit", sentence, found.misfit, limit)
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
    coloured = {name for name, test in tests.items() if test.fails or not test.is_white}
    larger = {name: factor for name, factor in found.noise.items() if factor > MOST_NOISE}
    for name, factor in larger.items():
        if name not in coloured:
            sensor, _, log = name.partition(" of ")
            part = f"that of the {SENSORS[sensor].label} {factor:.2g} times"
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
    return f"{SENSORS[name].label}{of}{log}"


def _of_the_body(found: SolvedIdentification) -> Iterator[Check]:
    """Yield the checks that a rigid body has the estimate, within its covariance."""
    parameters, covariance = found.parameters, found.covariance
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # NaN stays NaN
    shown = np.isfinite(parameters)
    if not np.isfinite(sigma[shown]).all():
        if found.sensors is not None or not 0 < found.solution.row_count <= found.rank:
            yield Check("uncertainty", "the uncertainty of the estimate could not be computed")
        return  # as many rows as unknowns: no residuals show the noise
    # The inertia of a small body far from C is a small difference of large numbers.
    about_C = ROUNDING * np.nan_to_num(abs(parameters[0]) * np.nansum(parameters[1:4] ** 2))
    for text, entries in _NOT_NEGATIVE.items():
        places, signs = list(entries), np.array(list(entries.values()))
        value = signs @ parameters[places]
        own = np.sqrt(max(signs @ covariance[np.ix_(places, places)] @ signs, 0.0))
        rounding = SMALLEST_VIOLATION * np.abs(parameters[places]).max() * (len(places) > 1)
        if min(places) >= 4:
            rounding += about_C
        if shown[places].all() and value + _SIGMAS * own < -rounding:
            sentence = f"no rigid body has the estimate: {text} = {value:.4g} ± {2 * own:.2g}"
            yield Check.of(NEAREST, sentence, -value / own if own else np.inf, _SIGMAS)
            return
    if not found.is_observable:
        sentence = "no rigid body agrees with what is known of the target, within its uncertainty"
        if found.consistency is not None:
            yield Check.of(NEAREST, sentence, passed=found.consistency.is_possible)
        return
    problems = "; ".join(found.infeasibilities)
    if problems and found.consistent is None:
        yield Check(NEAREST, f"no rigid body is near the estimate: {problems}")
        return
    nearest = parameters if found.consistent is None else found.consistent.to_vector()
    change = parameters - nearest
    is_rounding = (
        not problems
        or np.abs(change / parameter_scale(nearest)).max() < SMALLEST_VIOLATION
        or (np.abs(change[4:]).max() < about_C and abs(change[0]) < ROUNDING * nearest[0])
    )
    sigma = np.maximum(sigma, np.finfo(float).tiny)
    scaled = covariance / sigma / sigma[:, None]
    distance = float(change / sigma @ np.linalg.pinv(scaled, hermitian=True) @ (change / sigma))
    sentence = (
        f"no rigid body has the estimate within its uncertainty ({problems}): the momentum, the "
        "spacecraft's model, units, signs or frames are not as assumed"
    )
    limit = float(chdtri(10, IMPOSSIBLE))
    yield Check.of(NEAREST, sentence, 0.0 if is_rounding else distance, limit)
