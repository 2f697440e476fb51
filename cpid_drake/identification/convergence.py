"""Convergence: estimates from growing parts of a log."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.identify import identify
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.identification.result import Identification

Estimates = Sequence[tuple[float, Identification]]
"""Identifications from the samples up to some times [s]; those that are not possible are absent."""


def converge(evidence: Evidence, progress: Callable[[str], None] = lambda step: None) -> Estimates:
    """Identify from growing parts of the samples, in the same way as from all samples.

    Args:
        evidence: the samples and how they were identified.
        progress: called before every part with a short description of the part.

    """
    result, inputs, data = evidence.found, evidence.inputs, evidence.log.data
    _, end = data.interval
    count = ESTIMATORS[result.estimator].reports
    times: NDArray[np.float64] = end * np.arange(1, count + 1) / count
    estimates = []
    for k, time in enumerate(times):
        progress(f"identifying from the first {time:.4g} of {end:.4g} s")
        try:
            found = evidence.found
            if k < count - 1:
                found = identify(
                    inputs.spacecraft,
                    data.between(0.0, float(time)),
                    estimator=result.estimator,
                    rows=result.rows,
                    sensors=inputs.sensors,
                    momentum=inputs.momentum,
                    known_bodies=inputs.known_bodies,
                    prior=inputs.prior,
                    planar=result.is_planar,
                )
        except InputError:  # too few samples, or nothing moves yet
            continue
        estimates.append((float(time), found))
    return estimates
