"""Noise that is larger, or more correlated in time, than the sensors are said to have.

Correlated noise acts on the estimate like white noise with the same power at low frequencies.
Therefore σ of each sensor is multiplied by a factor of its own. The factors of fast sensors are
seen in their samples before the fit. Those of the others are seen in the residuals of the fit,
which is then repeated with them. Errors of the model in the residuals widen the intervals in the
same way; the gate judges the residuals of the first fit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.identification.problem import MOST_NOISE, Problem
from cpid_drake.sensing.measurement_stream import longest_steady
from cpid_drake.sensing.noise_colour import SMALLEST, noise_factors
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite

LARGER_NOISE = "the noise is larger than the sensors' file declares"
"""The beginning of the doubt about larger noise, which makes other causes seem likely."""

_CERTAIN = 3.0  # σ of χ² above which residuals are larger than the noise


@dataclass(frozen=True, eq=False)
class SeenNoise:
    """A problem with sensors that are as noisy as their samples.

    Attributes:
        problem: the problem.
        sensors: its sensors.
        warnings: sentences about sensors that are noisier than given, and about their estimate.
        doubts: sentences about sensors that are much noisier than given.

    """

    problem: Problem
    sensors: SensorSuite
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def with_seen_noise(problem: Problem) -> SeenNoise:
    """Return the problem with the noise that the samples of fast sensors show."""
    problem, sensors, warnings = problem.with_sensors()
    factors = noise_factors(longest_steady(problem.log.head), sensors)
    if not factors:
        return SeenNoise(problem, sensors, warnings)
    parts = [f"the {SENSORS[name].label} {factor:.2g} times" for name, factor in factors.items()]
    text = f"the samples show more noise, or noise that is correlated in time: {', '.join(parts)}"
    much = {name: factor for name, factor in factors.items() if factor > MOST_NOISE}
    seen = with_larger_noise(problem, sensors, factors)
    warnings = (*warnings, f"{text} the given σ was assumed")
    return replace(seen, warnings=warnings, doubts=(larger_noise(much),) if much else ())


def with_larger_noise(
    problem: Problem, sensors: SensorSuite, factors: Mapping[str, float]
) -> SeenNoise:
    """Return the problem with σ of some of its sensors multiplied, by name."""
    noisier = sensors.noisier(factors)
    return SeenNoise(replace(problem, sensors=noisier), noisier)


def larger_noise(factors: Mapping[str, float]) -> str:
    """Return the doubt about sensors whose noise is larger by these factors, by name."""
    parts = [f"that of the {label_of(name)} {factor:.2g} times" for name, factor in factors.items()]
    return f"{LARGER_NOISE}: {', '.join(parts)} the given one"


def label_of(sensor: str) -> str:
    """Return the label of a sensor by its name, which is empty if it is not known which one."""
    return SENSORS[sensor].label if sensor else "least white sensor"


def residual_factors(tests: Mapping[str, Whiteness], channels: int = 3) -> dict[str, float]:
    """Return by how much σ of sensors must be larger to explain their residuals, by name.

    Args:
        tests: whiteness of the residuals in σ, by sensor.
        channels: number of entries of a residual.

    """
    factors = {}
    for name, white in tests.items():
        square = white.rms**2
        if square < 1 + _CERTAIN * np.sqrt(2 / max(white.count * channels, 1)):
            square = min(square, 1.0)
        factor = np.sqrt(square * (1.0 if white.is_white else white.correlation_time))
        if factor > SMALLEST:
            factors[name] = float(factor)
    return factors
