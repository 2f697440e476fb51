"""The limits of screening, and what it remembers from one chunk of samples to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.measurements import Samples


@dataclass(frozen=True)
class ScreeningLimits:
    """All limits of screening.

    No limit is a rate or an acceleration: the samples around a sample show how fast the motion is.
    Screening therefore works with arms and with wheels, at any sample rate.
    """

    quaternion_norm: float = 1e-3
    """Largest deviation of the norm of an attitude's quaternion from 1. Rounding to three decimals
    causes 1e-3; an uninitialized message has the norm 0."""

    largest_value: float = 1e9
    """Largest value of any sensor [SI units]. A wheel at 3000 rpm needs five weeks to turn by 1e9
    rad, and larger values are damaged messages whose squares may overflow."""

    longest_gap: float = 3600.0
    """Longest time between two samples of one log [s]; with a longer one, a clock was wrong."""

    longest_silence: float = 1.0
    """A stamp later than all others by more than this time [s] must be confirmed by other stamps.
    One second is longer than the delay between sensors of one spacecraft."""

    silent_intervals: float = 5.0
    """Lower limit of the silence in sample intervals of the sensor: a slow sensor misses a few
    samples without an error of its clock."""

    confirming_stamps: int = 3
    """Number of different stamps that confirm each other after a silence: a single damaged stamp,
    or two, cannot end the log."""

    one_message: float = 1e-4
    """Stamps that differ by less than this time [s] may come from one message with one damaged
    stamp, and do not confirm each other. The sample interval at 1000 Hz is ten times as long."""

    spike: float = 5.0
    """Largest roughness (see `spikes.roughness`) of samples without spikes, in σ. The roughness is
    a weighted mean of errors: noise alone exceeds 5 once in 1e12 samples, and rounding reaches
    only 1.7. A spike of at least 40 σ always exceeds 5."""

    prominence: float = 30.0
    """A spike is rougher than the samples around it by at least this factor. Noise that is larger
    than the given σ, jitter of the stamps and motion that is fast for the sample rate make all
    samples rough; in noise, the roughest of a million exceeds the upper quartile about 15 times."""

    longest_spike: int = 2
    """Largest number of successive samples that can be spikes: three deviating samples in a row may
    be a short motion of the joints, which only the likelihood can judge."""

    bridge: float = 4.0
    """A spike deviates from the cubic polynomials through four good samples around it by more than
    this factor times the roughness of these four. Beside a step of the motion, the factor is only
    1.5."""

    window: int = 16
    """Number of samples around a sample that show what roughness is usual. Five of them must be
    spikes to hide a spike: with 5 % of spikes this happens once in 1000."""

    repeat_probability: float = 1e-9
    """A noisy sensor that repeats a value is stuck if noise would repeat it as often with a smaller
    probability: one false alarm in two weeks at 1000 Hz."""

    abrupt: float = 5.0
    """A sensor without noise is stuck if its motion stops from one sample to the next, with a bend
    this many times that of the samples before. A motion that slows down has about equal bends."""


def _empty() -> NDArray[np.float64]:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class SensorMemory:
    """What screening remembers of one sensor.

    Attributes:
        recent: the latest accepted samples, at most `ScreeningLimits.window`; attitudes are
            normalized.
        repeats: (width,) how often each entry of the latest sample has been repeated.
        varied: (width,) whether each entry has ever changed.

    """

    recent: Samples
    repeats: NDArray[np.intp]
    varied: NDArray[np.bool_]

    @property
    def last(self) -> float:
        """Stamp of the latest accepted sample [s]."""
        return float(self.recent.time[-1])


@dataclass(frozen=True, eq=False)
class ScreeningMemory:
    """What screening remembers from one chunk to the next; its size is bounded.

    Attributes:
        sensors: the memory of every sensor that has accepted samples.
        unconfirmed: the latest stamps that were too late, at most 8 [s].

    """

    sensors: Mapping[str, SensorMemory] = field(default_factory=dict)
    unconfirmed: NDArray[np.float64] = field(default_factory=_empty)

    @property
    def newest(self) -> float:
        """Stamp of the latest accepted sample of all sensors [s]; −inf before the first."""
        return max((sensor.last for sensor in self.sensors.values()), default=-np.inf)
