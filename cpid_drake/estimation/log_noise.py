"""The noise of a log's sensors and white forces, and where it is among the unknowns of a block."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import places_of
from cpid_drake.estimation.process import Process


@dataclass(frozen=True, eq=False)
class LogNoise:
    """The noise of a log.

    Attributes:
        processes: of each sensor and white force whose noise is not as declared.
        converged: whether they have been estimated at a fit with noise of their own, or where there
            are none.
        freedom: degrees of freedom of one residual that is not far off, by sensor; none before the
            noise was estimated.

    """

    processes: dict[str, Process] = field(default_factory=dict)
    converged: bool = False
    freedom: dict[str, float] = field(default_factory=dict)

    @property
    def is_estimated(self) -> bool:
        """Whether it was estimated, from residuals near the best fit."""
        return bool(self.freedom)

    def factors(self, length: float) -> dict[str, float]:
        """Return its size in a time [s], as factors of the sensors' declared σ."""
        factors = dict.fromkeys(self.freedom, 1.0)
        return factors | {n: float(np.sqrt(p.within(length))) for n, p in self.processes.items()}

    @cached_property
    def slow_places(self) -> dict[str, slice]:
        """Places of sensors with slow noise in `BlockState.slow`."""
        return places_of({n: p.size for n, p in self.processes.items() if p.slow})

    @cached_property
    def slow_size(self) -> int:
        """Number of entries of slow noise."""
        return sum(process.size for process in self.processes.values())

    @property
    def slow_sigma(self) -> Array:
        """(s,) their σ."""
        return np.array([p.slow**0.5 for p in self.processes.values() for _ in range(p.size)])
