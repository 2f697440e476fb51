"""Convergence: estimates from growing parts of a log."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.identify import identify
from cpid_drake.identification.requests import Evidence
from cpid_drake.identification.result import Identification


@dataclass(frozen=True, eq=False)
class Convergence:
    """Estimates from the samples so far, at K times.

    Attributes:
        time: (K,) [s].
        parameters: (K, 10); NaN while not known.
        intervals: (K, 10, 2) 95 % intervals.
        estimates: (time, identification) at the times for which there is one.

    """

    time: NDArray[np.float64]
    parameters: NDArray[np.float64]
    intervals: NDArray[np.float64]
    estimates: tuple[tuple[float, Identification], ...]


def converge(
    evidence: Evidence, progress: Callable[[str], None] = lambda step: None
) -> Convergence:
    """Identify from growing parts of the samples, in the same way as from all samples.

    Args:
        evidence: the samples and how they were identified.
        progress: called before every part with a short description of the part.

    """
    request, result = evidence.request, evidence.result
    parts = [samples.time for _, samples in evidence.measurements.items()]
    end = max(float(time[-1]) for time in parts if time.size)
    count = ESTIMATORS[result.estimator].reports
    times = end * np.arange(1, count + 1) / count
    parameters, bands = np.full((count, 10), np.nan), np.full((count, 10, 2), np.nan)
    estimates = []
    for k, time in enumerate(times):
        progress(f"identifying from the first {time:.4g} of {end:.4g} s")
        try:
            found = evidence.found
            if k < count - 1:
                found = identify(
                    evidence.spacecraft,
                    evidence.measurements.between(0.0, float(time)),
                    estimator=result.estimator,
                    rows=result.rows,
                    sensors=evidence.sensors,
                    momentum=TotalMomentum.named(request.momentum),
                )
        except InputError:  # too few samples, or nothing moves yet
            continue
        parameters[k] = found.parameters
        bands[k] = found.intervals
        estimates.append((float(time), found))
    return Convergence(times, parameters, bands, tuple(estimates))
