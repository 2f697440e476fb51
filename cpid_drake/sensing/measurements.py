"""Samples of every sensor at the sensor's own times."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one sensor: time (N,) [s] and value (N, width)."""

    time: NDArray[np.float64]
    value: NDArray[np.float64]

    def __len__(self) -> int:
        return self.time.size

    def where(self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "Samples":
        """Return the samples that a mask, indices or a slice select."""
        return Samples(self.time[keep], self.value[keep])


@dataclass(frozen=True, eq=False, init=False)
class Measurements:
    """The samples of all sensors; those of one sensor are `self[name]`, or the attribute `name`.

    Samples are in SI units and radians, as the sensor's `Quantity` defines. A sensor of the table
    that is absent has no samples: times (0,) and values (0, width).

    Args:
        joint_names: the joints, in the order of columns of joint sensors.
        samples: the samples, by the sensors' names in `SENSORS`.
        named: samples by sensor, as keywords; they replace those in `samples`.

    """

    joint_names: tuple[str, ...]
    samples: Mapping[str, Samples] = field(default_factory=dict)

    def __init__(
        self,
        joint_names: tuple[str, ...],
        samples: Mapping[str, Samples] | None = None,
        **named: Samples,
    ) -> None:
        object.__setattr__(self, "joint_names", tuple(joint_names))
        object.__setattr__(self, "samples", {**(samples or {}), **named})
        unknown = [name for name in self.samples if name not in SENSORS]
        if unknown:
            raise TypeError(f"no sensor '{unknown[0]}'; the sensors are {', '.join(SENSORS)}")

    def __getitem__(self, name: str) -> Samples:
        if name in self.samples:
            return self.samples[name]
        return Samples(np.empty(0), np.empty((0, SENSORS[name].width(len(self.joint_names)))))

    def __getattr__(self, name: str) -> Samples:
        if name not in SENSORS:
            raise AttributeError(f"measurements have no sensor '{name}'")
        return self[name]

    def items(self) -> Iterator[tuple[str, Samples]]:
        """Yield name and samples of every sensor of the table, absent ones included."""
        return ((name, self[name]) for name in SENSORS)

    def updated(self, samples: Mapping[str, Samples]) -> "Measurements":
        """Return measurements in which `samples` replace those of the same sensors."""
        return Measurements(self.joint_names, {**self.samples, **samples})

    def between(self, start: float, end: float) -> "Measurements":
        """Return the samples with start ≤ time ≤ end [s]."""
        return self.updated(
            {name: s.where((s.time >= start) & (s.time <= end)) for name, s in self.items()}
        )


def sample_times(rate: float, duration: float, start: float = 0.0) -> NDArray[np.float64]:
    """Return a sensor's sampling times from `start` to `duration`, both included [s]."""
    return start + np.arange(int(np.floor((duration - start) * rate + 1e-9)) + 1) / rate


def ideal_measurements(
    suite: SensorSuite,
    joint_names: tuple[str, ...],
    motion: Callable[[NDArray[np.float64]], Telemetry],
    duration: float,
) -> Measurements:
    """Return the samples of sensors without errors, at their own times in [0, duration].

    Args:
        suite: the sensors; only their rates are used.
        joint_names: the joints.
        motion: returns the true telemetry at increasing times (N,).
        duration: [s].

    """
    sensors = suite.present()
    if not sensors:
        return Measurements(joint_names)
    times = {name: sample_times(sensor.rate, duration) for name, sensor in sensors.items()}
    everything = np.concatenate(list(times.values()))
    keys = np.round(everything * 1e9).astype(np.int64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    telemetry = motion(everything[first])
    samples, start = {}, 0
    for name, t in times.items():
        rows = inverse[start : start + t.size]
        samples[name] = Samples(t, SENSORS[name].quantity.ideal(telemetry)[rows])
        start += t.size
    return Measurements(joint_names, samples)
