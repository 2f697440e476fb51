"""Even selections of bounded size from series of any length, for figures and pages."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.measurement_stream import MeasurementStream
from cpid_drake.sensing.measurements import Measurements, Samples


class EvenSelection:
    """Every k-th sample of a series that is added part by part.

    k is doubled whenever the selection exceeds its size, so that it has between `most` / 2 and
    `most` samples if the series is longer than `most`.

    Args:
        most: largest number of samples, at least 2.

    Attributes:
        every: k.
        count: number of samples of the series so far.

    """

    def __init__(self, most: int) -> None:
        self.every = 1
        self.count = 0
        self._most = most
        self._parts: list[Samples] = []

    def add(self, part: Samples) -> None:
        """Add the next samples of the series; `value` may have further dimensions."""
        kept = part.where(slice(-self.count % self.every, None, self.every))
        self.count += len(part)
        if not len(kept):
            return
        # A copy: a view would keep the whole part in memory.
        self._parts.append(Samples(kept.time.copy(), kept.value.copy()))
        while sum(map(len, self._parts)) > self._most:
            self._parts = [self._joined().where(slice(None, None, 2))]
            self.every *= 2

    def samples(self) -> Samples | None:
        """Return the selection; None if nothing was added."""
        return self._joined() if self._parts else None

    def _joined(self) -> Samples:
        times, values = ([getattr(p, name) for p in self._parts] for name in ("time", "value"))
        return Samples(np.concatenate(times), np.concatenate(values))


@dataclass(frozen=True, eq=False)
class Excerpt:
    """An even selection of the samples of every sensor.

    Attributes:
        measurements: the selection.
        counts: number of all samples by sensor.
        every: by sensor, k if the selection contains every k-th sample.

    """

    measurements: Measurements
    counts: Mapping[str, int]
    every: Mapping[str, int]

    def period(self, name: str) -> float:
        """Return the median time between neighbouring samples of a sensor [s]; NaN without any."""
        times: NDArray[np.float64] = self.measurements[name].time
        return float(np.median(np.diff(times))) / self.every[name] if len(times) > 1 else np.nan


def excerpt_of(data: Measurements | MeasurementStream, most: int = 4000) -> Excerpt:
    """Return at most `most` samples of every sensor of a stream, and all of measurements."""
    if isinstance(data, Measurements):
        lengths = {name: len(samples) for name, samples in data.items()}
        return Excerpt(data, lengths, dict.fromkeys(lengths, 1))
    selections: dict[str, EvenSelection] = {}
    for chunk in data:
        for name, samples in chunk.items():
            selections.setdefault(name, EvenSelection(most)).add(samples)
    kept = {name: selection.samples() for name, selection in selections.items()}
    return Excerpt(
        Measurements(data.joint_names, {name: s for name, s in kept.items() if s is not None}),
        {name: selection.count for name, selection in selections.items()},
        {name: selection.every for name, selection in selections.items()},
    )
