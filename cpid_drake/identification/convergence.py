"""Convergence: estimates from growing parts of a log."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.identify import identify
from cpid_drake.identification.requests import Evidence
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.sensing.measurement_stream import MeasurementStream, Stream, time_interval
from cpid_drake.sensing.measurements import Measurements

_SHORTEST_PART = 10.0
"""Shortest part of a long log from which the target is identified [s]."""


Estimates = Sequence[tuple[float, SolvedIdentification]]
"""Identifications from the samples up to some times [s]; those that are not possible are absent."""


def converge(evidence: Evidence, progress: Callable[[str], None] = lambda step: None) -> Estimates:
    """Identify from growing parts of the samples, in the same way as from all samples.

    Args:
        evidence: the samples and how they were identified.
        progress: called before every part with a short description of the part.

    """
    result, inputs, data = evidence.found, evidence.inputs, evidence.log.data
    parts = [samples.time for _, samples in evidence.log.excerpt.measurements.items()]
    end = max(float(time[-1]) for time in parts if time.size)
    count = ESTIMATORS[result.estimator].reports
    times: NDArray[np.float64] = end * np.arange(1, count + 1) / count
    if not isinstance(data, Measurements):
        # Each part of a long log is half of the next, so all of them take as long as the whole log.
        halves = [end * 0.5**k for k in reversed(range(count))]
        times = np.array([time for time in halves if time >= min(_SHORTEST_PART, end)])
        count = len(times)
    estimates = []
    for k, time in enumerate(times):
        progress(f"identifying from the first {time:.4g} of {end:.4g} s")
        try:
            found = evidence.found
            if k < count - 1:
                found = identify(
                    inputs.spacecraft,
                    beginning_of(data, float(time)),
                    estimator=result.estimator,
                    rows=result.rows,
                    sensors=inputs.sensors,
                    momentum=inputs.momentum,
                    known_bodies=inputs.known_bodies,
                    prior=inputs.prior,
                    planar=result.table is not None,
                )
        except InputError:  # too few samples, or nothing moves yet
            continue
        estimates.append((float(time), found))
    return estimates


def beginning_of(
    data: Measurements | MeasurementStream, end: float
) -> Measurements | MeasurementStream:
    """Return the samples up to the time `end` [s] of a log that starts at zero."""
    if isinstance(data, Measurements):
        return data.between(0.0, end)

    def read() -> Iterator[Measurements]:
        for chunk in data:
            interval = time_interval(chunk)
            if interval is not None and interval[0] > end:
                return
            yield chunk.between(0.0, end)

    return Stream(data.joint_names, read)
