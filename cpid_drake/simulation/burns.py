"""Burns of thrusters that are fixed on the base, and their log."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.constraints import Limits, Vector
from cpid_drake.logs.log import Samples


@dataclass(eq=False)
class Burn:
    """A burn of thrusters on the base, with constant thrust.

    Attributes:
        time: its start [s].
        duration: its length [s].
        force_B: (3,) force in B [N].
        p_BF_B: (3,) the point of the base at which the force acts, from B's origin in B [m].
        torque_B: (3,) torque that acts besides, in B [N·m].

    """

    time: Annotated[float, Limits(ge=0)]
    duration: Annotated[float, Limits(gt=0)]
    force_B: Vector = field(default_factory=lambda: np.zeros(3))
    p_BF_B: Vector = field(default_factory=lambda: np.zeros(3))
    torque_B: Vector = field(default_factory=lambda: np.zeros(3))

    @property
    def wrench_B(self) -> Array:
        """(6,) torque about B's origin, and force, in B [N·m, N]."""
        torque = self.torque_B + np.cross(self.p_BF_B, self.force_B)
        return np.concatenate([torque, self.force_B])

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
