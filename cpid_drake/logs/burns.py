"""Burns of thrusters that are fixed on the base, and their log."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.logs.log import Samples


@dataclass(frozen=True, eq=False)
class Burn:
    """A burn with constant thrust.

    Attributes:
        time: its start [s].
        duration: its length [s].
        wrench_B: (6,) torque about B's origin, and force, in B [N·m, N].

    """

    time: float
    duration: float
    wrench_B: NDArray[np.float64]

    @property
    def end(self) -> float:
        """Time of its end [s]."""
        return self.time + self.duration


def log_of_burns(burns: Sequence[Burn]) -> Samples:
    """Return the log of burns, which may overlap: a sample [τ; f] at each change of the thrust."""
    times = np.array(sorted({t for burn in burns for t in (burn.time, burn.end)}))
    values = np.zeros((len(times), 6))
    for burn in burns:
        values[(times >= burn.time) & (times < burn.end)] += burn.wrench_B
    return Samples(times, values)
