"""What the sensors gave: samples of every sensor at its own times."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.sensing.suite import SENSOR_NAMES, SensorSuite


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one sensor: time (N,) [s] and value (N, width)."""

    time: NDArray[np.float64]
    value: NDArray[np.float64]

    def __len__(self) -> int:
        return self.time.size

    def where(self, keep: ArrayLike) -> "Samples":
        """Return the samples that a mask or index selects."""
        return Samples(self.time[keep], self.value[keep])


@dataclass(frozen=True, eq=False)
class Measurements:
    """What the sensors gave, each at its own times; a sensor that is not there has no samples.

    Attributes:
        joint_names: the joints, in the order of columns.
        attitude: unit quaternions (w, x, y, z) of R_WB.
        gyro: angular velocity of B in W, expressed in B [rad/s].
        position: B's origin in W [m].
        velocity: of B's origin, in W [m/s].
        encoders: joint positions [rad or m].
        joint_rates: [rad/s or m/s].

    """

    joint_names: tuple[str, ...]
    attitude: Samples
    gyro: Samples
    position: Samples
    velocity: Samples
    encoders: Samples
    joint_rates: Samples

    def between(self, start: float, end: float) -> "Measurements":
        """Return the samples with start ≤ time ≤ end [s]."""
        picked = {}
        for name in SENSOR_NAMES:
            samples = getattr(self, name)
            picked[name] = samples.where((samples.time >= start) & (samples.time <= end))
        return replace(self, **picked)


def sample_times(rate: float, duration: float, start: float = 0.0) -> NDArray[np.float64]:
    """Return a sensor's instants from `start` to the end, both included [s]."""
    return start + np.arange(int(np.floor((duration - start) * rate + 1e-9)) + 1) / rate


def sample_widths(joint_names: tuple[str, ...]) -> dict[str, int]:
    """Return the width of every sensor's samples, in the order of `SENSOR_NAMES`."""
    return dict(zip(SENSOR_NAMES, (4, 3, 3, 3, len(joint_names), len(joint_names))))


def perfect_value(name: str, telemetry: Telemetry) -> NDArray[np.float64]:
    """Return (N, width): what a sensor of this name would give without any error."""
    if name == "attitude":
        return telemetry.quaternion_WB
    if name == "gyro":
        return rotate(np.swapaxes(telemetry.R_WB, -1, -2), telemetry.w_WB)
    return {
        "position": telemetry.p_WB,
        "velocity": telemetry.v_WB,
        "encoders": telemetry.q,
        "joint_rates": telemetry.qdot,
    }[name]


def perfect_measurements(
    suite: SensorSuite,
    joint_names: tuple[str, ...],
    motion: Callable[[NDArray[np.float64]], Telemetry],
    duration: float,
) -> Measurements:
    """Return what the sensors would give without error, at their own times in [0, duration].

    Args:
        suite: the sensors; only their rates are used.
        joint_names: the joints.
        motion: returns the true telemetry at increasing times (N,).
        duration: [s].

    """
    samples = {
        name: Samples(np.empty(0), np.empty((0, width)))
        for name, width in sample_widths(joint_names).items()
    }
    sensors = suite.present()
    times = {name: sample_times(sensor.rate, duration) for name, sensor in sensors.items()}
    if times:
        everything = np.concatenate(list(times.values()))
        keys = np.round(everything * 1e9).astype(np.int64)
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        telemetry = motion(everything[first])
        start = 0
        for name, t in times.items():
            mine = inverse[start : start + t.size]
            samples[name] = Samples(t, perfect_value(name, telemetry)[mine])
            start += t.size
    return Measurements(tuple(joint_names), **samples)
