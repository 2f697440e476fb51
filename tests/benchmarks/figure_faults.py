"""Faults of sensors: spikes, dropouts and sensors that stick."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import ATTITUDE, SENSORS
from cpid_drake.sensing.suite import SensorSuite


class Fault(Protocol):
    """A change of the samples of one sensor."""

    def apply(
        self, measurements: Measurements, suite: SensorSuite, rng: np.random.Generator
    ) -> Measurements:
        """Return the measurements with the fault."""
        ...


@dataclass(frozen=True)
class Spikes:
    """Single samples of one sensor that are wrong in one entry, drawn at random.

    For attitude the entry is a rotation about one axis of B.

    Attributes:
        sensor: name of the sensor.
        share: probability that a sample is wrong.
        sizes: smallest and largest size, in σ of one sample; log-uniform between them, of either
            sign.

    """

    sensor: str
    share: float = 0.01
    sizes: tuple[float, float] = (50.0, 1000.0)

    def apply(
        self, measurements: Measurements, suite: SensorSuite, rng: np.random.Generator
    ) -> Measurements:
        """Return the measurements with spikes."""
        samples = measurements[self.sensor]
        is_attitude = SENSORS[self.sensor].quantity is ATTITUDE
        width = 3 if is_attitude else samples.value.shape[1]
        n = len(samples)
        size = np.exp(rng.uniform(*np.log(self.sizes), n)) * rng.choice([-1.0, 1.0], n)
        entry, hit = rng.integers(width, size=n), rng.random(n) < self.share
        sigma = np.broadcast_to(suite.sigmas(self.sensor), (width,))
        error = np.zeros((n, width))
        error[hit, entry[hit]] = (size * sigma[entry])[hit]
        if is_attitude:
            R_BS = suite[self.sensor].R_BS
            turned = Rotation.from_quat(samples.value, scalar_first=True)
            turned = turned * Rotation.from_rotvec(error @ R_BS.T)
            value = turned.as_quat(scalar_first=True)
        else:
            value = samples.value + error
        return measurements.updated({self.sensor: Samples(samples.time, value)})


@dataclass(frozen=True)
class Dropout:
    """A sensor without samples between two times [s]."""

    sensor: str
    start: float = 4.0
    end: float = 5.0

    def apply(
        self, measurements: Measurements, suite: SensorSuite, rng: np.random.Generator
    ) -> Measurements:
        """Return the measurements without the samples in [start, end)."""
        samples = measurements[self.sensor]
        kept = (samples.time < self.start) | (samples.time >= self.end)
        return measurements.updated({self.sensor: samples.where(kept)})


@dataclass(frozen=True)
class Stuck:
    """A sensor that repeats its last sample, with new stamps, between two times [s]."""

    sensor: str
    start: float = 4.0
    end: float = 5.0

    def apply(
        self, measurements: Measurements, suite: SensorSuite, rng: np.random.Generator
    ) -> Measurements:
        """Return the measurements with the last sample before `start` repeated until `end`."""
        samples = measurements[self.sensor]
        first = int(np.searchsorted(samples.time, self.start))
        value = samples.value.copy()
        value[(samples.time >= self.start) & (samples.time < self.end)] = value[first - 1]
        return measurements.updated({self.sensor: Samples(samples.time, value)})
