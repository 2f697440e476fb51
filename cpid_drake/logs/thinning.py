"""Even selections of bounded size from series of any length, for figures and pages."""

import numpy as np

from cpid_drake.logs.log import Samples


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
