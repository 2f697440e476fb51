"""The gate that every answer passes: reasons not to trust an identification.

An estimator computes its intervals under the assumption that the world is as modelled. Each check
here tests one consequence of this assumption with the data. An answer that fails a check is marked
by a sentence in `Identification.doubts`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.identification.problem import MOST_NOISE
from cpid_drake.identification.result import Identification
from cpid_drake.sensing.sensors import SENSORS

SEEN = 1.1
"""Factor of the noise from which a warning says so."""

MOST_UNEXPLAINED = 0.1
"""Share of the samples that nothing explains, above which a check fails."""

LARGER_NOISE = "the noise is larger than the sensors' file declares"
"""The beginning of the failed check of larger noise, which makes other causes seem likely."""

IMPOSSIBLE = 1e-4
"""Probability of an estimate so far from every rigid body below which the answer is doubted."""

SMALLEST_VIOLATION = 1e-4
"""A change of the parameters by this share of their scale is not a doubt: rounding causes it."""

MOST_REJECTED = 0.5
"""Share of unusable samples of one sensor above which the answer is doubted."""

ROUNDING = 1e-9
"""A change of the inertia by this share of the inertia about C is not a doubt."""

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


def checked(found: Identification) -> Identification:
    """Return an identification with the failed checks of its residuals, its noise and its body."""
    doubts = [*found.doubts, *_of_the_fit(found)]
    if found.solution.rank:  # else no number is shown
        doubts += _of_the_body(found)
    doubts.sort(key=lambda doubt: LARGER_NOISE not in doubt)  # it explains the others
    return replace(found, doubts=tuple(doubts))


def _of_the_fit(found: Identification) -> Iterator[str]:
    """Yield doubts about the residuals and the solver."""
    if not found.converged:
        yield "the estimator did not converge: its result is not the best fit"
    white = found.whiteness
    coloured = white is not None and not white.is_white
    if found.misfit > MOST_NOISE:
        yield f"the fit misses the samples by {found.misfit:.2g} times the assumed noise"
    elif found.misfit > 1 and found.rows is not None:
        yield (
            f"the momentum balance misses the samples by {found.misfit:.2g} times their errors: "
            "the spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
        )
    elif found.misfit > 1 and white is not None and coloured:
        yield (
            f"the fit misses the samples by {found.misfit:.2g} times the assumed noise, and its "
            f"residuals are correlated ({white.lag_one:+.2f}), so noise does not explain them"
        )
    if found.unexplained > MOST_UNEXPLAINED:
        yield f"nothing explains {100 * found.unexplained:.0f} % of the log"
    yield from _of_the_noise(found)
    for name, count in found.rejected.items():
        if found.sample_count and count > MOST_REJECTED * (count + found.sample_count):
            yield f"{count} samples of {name} could not be used"


def _of_the_noise(found: Identification) -> Iterator[str]:
    """Yield failed checks of sensors whose residuals are not their noise."""
    tests = found.tests
    larger = {name: factor for name, factor in found.noise.items() if factor > MOST_NOISE}
    coloured = [name for name, test in tests.items() if test.fails or not test.is_white]
    noisier: dict[str, list[str]] = {}
    for name, factor in larger.items():
        if name not in coloured:
            sensor, _, log = name.partition(" of ")
            part = f"that of the {SENSORS[sensor].label} {factor:.2g} times"
            noisier.setdefault(f"{log}: " if log else "", []).append(part)
    for where, parts in noisier.items():
        yield f"{where}{LARGER_NOISE}: {', '.join(parts)} the given one"
    for name in coloured:
        if tests[name].fails or name in larger:
            yield (
                f"the residuals of the {label_of(name)} are correlated from sample to sample "
                f"({tests[name].lag_one:+.2f}) and weigh as much as "
                f"{found.noise.get(name, 1.0):.2g} times the given noise: their cause is not in "
                "the intervals"
            )


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


def _of_the_body(found: Identification) -> Iterator[str]:
    """Yield doubts because no rigid body has the estimate, within its covariance."""
    parameters, covariance = found.parameters, found.covariance
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # NaN stays NaN
    shown = np.isfinite(parameters)
    if not np.isfinite(sigma[shown]).all():
        if found.sensors is None and 0 < found.solution.row_count <= found.solution.rank:
            return  # as many rows as unknowns: no residuals show the noise
        yield "the uncertainty of the estimate could not be computed"
        return
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
            yield f"no rigid body has the estimate: {text} = {value:.4g} ± {2 * own:.2g}"
            return
    if not found.is_observable:
        if found.consistency is not None and not found.consistency.is_possible:
            yield "no rigid body agrees with what is known of the target, within its uncertainty"
        return
    problems = found.raw().infeasibilities()
    if not problems:
        return
    if found.consistent is None:
        yield f"no rigid body is near the estimate: {'; '.join(problems)}"
        return
    nearest = found.consistent.to_vector()
    change = parameters - nearest
    if np.abs(change / parameter_scale(nearest)).max() < SMALLEST_VIOLATION:
        return
    if np.abs(change[4:]).max() < about_C and abs(change[0]) < ROUNDING * nearest[0]:
        return
    sigma = np.maximum(sigma, np.finfo(float).tiny)
    scaled = covariance / sigma / sigma[:, None]
    distance = float(change / sigma @ np.linalg.pinv(scaled, hermitian=True) @ (change / sigma))
    if distance > chdtri(10, IMPOSSIBLE):
        yield (
            f"no rigid body has the estimate within its uncertainty ({'; '.join(problems)}): the "
            "momentum, the spacecraft's model, units, signs or frames are not as assumed"
        )
