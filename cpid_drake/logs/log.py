"""Samples of every sensor at the sensor's own times."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.files.errors import listed
from cpid_drake.sensors.sensors import SENSORS, Gyro, SensorErrors, VectorSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import VALVE

if TYPE_CHECKING:
    from cpid_drake.logs.column_map import ColumnMap

THRUST = "thrust"
"""Name of the samples of logged thrust."""

THRUST_COLUMNS = ("thrust_tx", "thrust_ty", "thrust_tz", "thrust_fx", "thrust_fy", "thrust_fz")
"""Columns in files of logged thrust, in the order of its samples: torque, force."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one sensor: time (N,) [s] and value (N, width)."""

    time: Array
    value: Array

    def __len__(self) -> int:
        return len(self.time)

    @property
    def last_time(self) -> float:
        """Time of the last sample [s]; −inf without samples."""
        return float(self.time[-1]) if len(self) else -np.inf

    def where(self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "Samples":
        """Return the samples that a mask, indices or a slice select."""
        return Samples(self.time[keep], self.value[keep])

    def held_at(self, times: ArrayLike, side: Literal["left", "right"] = "right") -> Array:
        """Return the values (..., width) at times (...) [s] if each holds until the next sample.

        They are zero before the first sample.

        Args:
            times: [s].
            side: "right" for the values just after the times, "left" for those just before.

        """
        number = np.searchsorted(self.time, times, side=side)
        return np.concatenate([np.zeros((1, self.value.shape[1])), self.value])[number]


@dataclass(frozen=True, eq=False)
class Log:
    """The samples of all sensors; those of one sensor are `self[name]`, or the attribute `name`.

    Samples are in SI units and radians, as `Sensor.unit` says. A sensor of the table
    that is absent has no samples: times (0,) and values (0, width). Logged thrust is no sensor, and
    has samples of the name `THRUST`; see `thrust`.

    Attributes:
        joint_names: the joints, in the order of columns of joint sensors.
        samples: the samples, by the sensors' names in `SENSORS`, by `THRUST`, and of each valve by
            `VALVE` and its name.
        column_map: how the samples were read from columns; None for the package's own columns.
        motion: of a simulation, the true motion at the samples of sensors whose errors need it.
        notes: by sensor, what was found while its samples were read.
        clocks: by sensor, the file whose clock its stamps have, if there are several; see
            `common_clock`.

    """

    joint_names: tuple[str, ...]
    samples: Mapping[str, Samples] = field(default_factory=dict)
    column_map: "ColumnMap | None" = None
    motion: Mapping[str, Motion] = field(default_factory=dict)
    notes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.samples:
            if name not in SENSORS and name != THRUST and not name.startswith(VALVE):
                raise TypeError(f"no sensor '{name}'; the sensors are {', '.join(SENSORS)}")

    def __getitem__(self, name: str) -> Samples:
        if name in self.samples:
            return self.samples[name]
        width = 6 if name == THRUST else SENSORS[name].width_of(len(self.joint_names))
        return Samples(np.empty(0), np.empty((0, width)))

    def __getattr__(self, name: str) -> Samples:
        if name not in SENSORS:
            raise AttributeError(f"a log has no sensor '{name}'")
        return self[name]

    def __repr__(self) -> str:
        first, last = self.interval
        counts = listed([f"{name} {len(s)}" for name, s in self.samples.items() if len(s)])
        what = f"{first:.6g} to {last:.6g} s: {counts}" if counts else "no samples"
        return f"Log({what}; joints: {listed(self.joint_names) or 'none'})"

    def items(self) -> Iterator[tuple[str, Samples]]:
        """Yield name and samples of every sensor of the table, absent ones included."""
        return ((name, self[name]) for name in SENSORS)

    def messages(self) -> list[tuple[str, float, Array]]:
        """Return all samples as (name, time [s], value), in the order of their times."""
        texts = [
            (name, time, value)
            for name, each in self.samples.items()
            for time, value in zip(each.time.tolist(), each.value, strict=True)
        ]
        return sorted(texts, key=lambda message: message[1])

    @property
    def thrust(self) -> Samples:
        """The log of thrust: [τ; f] (N, 6), each of which holds from its time to the next.

        The torque about B's origin [N·m] and the force [N] on the base, both in B; if the suite has
        thrusters, the openings (N, V) of the valves. There is no thrust before the first sample.
        """
        return self[THRUST]

    @property
    def valves(self) -> dict[str, Samples]:
        """The logged openings (N, 1) of each valve, by its name."""
        named = ((name, s) for name, s in self.samples.items() if name.startswith(VALVE))
        return {name.removeprefix(VALVE): samples for name, samples in named}

    @property
    def last_time(self) -> float:
        """Time of the latest sample, also of thrust [s]; −inf without samples."""
        return max((samples.last_time for samples in self.samples.values()), default=-np.inf)

    @property
    def interval(self) -> tuple[float, float]:
        """Times of the first and of the last sample of all sensors [s]; (∞, −∞) without samples."""
        first = min((float(s.time[0]) for _, s in self.items() if len(s)), default=np.inf)
        return first, max(samples.last_time for _, samples in self.items())

    def updated(self, samples: Mapping[str, Samples]) -> "Log":
        """Return a log in which `samples` replace those of the same sensors."""
        return replace(self, samples={**self.samples, **samples}, motion={})

    def between(self, start: float, end: float) -> "Log":
        """Return the samples with start ≤ time ≤ end [s], and the thrust held at the start."""
        kept = {name: s.where((s.time >= start) & (s.time <= end)) for name, s in self.items()}
        return self.updated(kept | self.thrust_between(start, end))

    def blocks(self, seconds: float = 60.0) -> Iterator["Log"]:
        """Yield the samples in intervals of `seconds` [s] from the first one on.

        Intervals without samples are left out. The arrays are not copied. Times must increase.
        """
        start, since = self.interval[0], -np.inf
        times = [(s.time - start) / seconds for _, s in self.items()]
        numbers = np.unique(np.floor(np.concatenate(times)))
        for limit in [*(start + seconds * (numbers[:-1] + 1)), np.inf][: numbers.size]:
            kept = {}
            for name, samples in self.items():
                first, last = np.searchsorted(samples.time, [since, limit])
                kept[name] = samples.where(slice(first, last))
            thrust = self.thrust_between(since, float(np.nextafter(limit, -np.inf)))
            yield self.updated(kept | thrust)
            since = limit

    def after(self, zero: float) -> "Log":
        """Return the samples with a time that is counted from `zero` [s]."""
        return self.updated({k: Samples(s.time - zero, s.value) for k, s in self.samples.items()})

    def thinned(self, most: int = 4000) -> "Log":
        """Return every k-th sample of a sensor with more than `most` samples, for figures."""
        return self.updated(
            {name: s.where(slice(None, None, -(-len(s) // most) or 1)) for name, s in self.items()}
        )

    @property
    def first_burn(self) -> float:
        """Time at which thrusters first fire by thrust or valves [s]; infinite if never."""
        logs = [self.thrust, *self.valves.values()]
        return min(float(s.time[s.value.any(axis=1)].min(initial=np.inf)) for s in logs)

    @property
    def has_thrust(self) -> bool:
        """Whether a log of thrust says that thrusters fired."""
        return bool(self.thrust.value.any())

    def thrust_between(self, start: float, end: float) -> dict[str, Samples]:
        """Return the log of thrust from start to end [s], by `THRUST`; nothing without a log.

        The sample that holds at the start becomes one at the start.
        """
        if THRUST not in self.samples:
            return {}
        log = self.thrust
        first = int(np.searchsorted(log.time, start, side="right")) - 1
        last = int(np.searchsorted(log.time, end, side="right"))
        kept = log.where(slice(max(first, 0), last))
        return {THRUST: Samples(np.maximum(kept.time, start), kept.value)}


def concatenated_samples(pieces: Sequence[Samples]) -> Samples:
    """Return a copy of consecutive samples of one sensor, at least one piece, as one."""
    return Samples(
        np.concatenate([piece.time for piece in pieces]),
        np.concatenate([piece.value for piece in pieces]),
    )


def concatenated(pieces: Sequence[Log]) -> Log:
    """Return consecutive pieces of one log, at least one, as one."""
    names = dict.fromkeys(name for piece in pieces for name in piece.samples)
    samples = {name: concatenated_samples([piece[name] for piece in pieces]) for name in names}
    return Log(pieces[0].joint_names, samples)


def with_fixed_joints(log: Log, travels: Mapping[str, float]) -> Log:
    """Return a log with a note on joints that the spacecraft lacks, and that move in the log.

    Args:
        log: the log.
        travels: how far each of these joints moves, in the log's unit.

    """
    moved = [f"{joint} by {travel:.3g}" for joint, travel in travels.items() if travel > 0.02]
    if not moved:
        return log
    text = f"joints moved that the spacecraft does not have, as if they were fixed: {listed(moved)}"
    notes = {**log.notes, "encoders": (*log.notes.get("encoders", ()), text)}
    return replace(log, notes=notes)


def without_flips(quaternion: Array) -> Array:
    """Return quaternions (N, 4) of the same attitudes, without jumps of their sign."""
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0
    signs = np.cumprod(np.append(1.0, 1 - 2.0 * flips))[: len(quaternion)]
    return np.asarray(quaternion * signs[:, None])


def turns(quaternion: Array) -> Array:
    """Return the rotation vectors (N - 1, 3), in B, from attitude to attitude (N, 4)."""
    R = Rotation.from_quat(quaternion, scalar_first=True)
    return np.asarray((R[:-1].inv() * R[1:]).as_rotvec())


def first_sample(errors: SensorErrors) -> int:
    """Return the number k of a sensor's first sample, at the time k / rate after the start.

    It is 1 for a gyro that integrates, since no time has passed before the start, else 0.
    """
    return int(isinstance(errors, Gyro) and errors.integrates)


def sample_times(rate: float, duration: float) -> Array:
    """Return a sensor's sampling times from zero to `duration`, both included [s]."""
    return np.arange(int(np.floor(duration * rate + 1e-9)) + 1) / rate


def ideal_log(
    suite: SensorSuite,
    joint_names: tuple[str, ...],
    motion: Callable[[Array], Motion],
    duration: float,
) -> Log:
    """Return the samples of sensors without errors, at their own times in [0, duration].

    A sample of a gyro that integrates is the mean of the angular velocity since the sample before,
    by Simpson's rule over steps of at most 0.02 s.

    Args:
        suite: the sensors. Used are their rates, `Gyro.integrates`, and whether they have a lever
            arm, or the encoders an error once a turn.
        joint_names: the joints.
        motion: returns the true motion at increasing times (N,).
        duration: [s].

    """
    sensors = suite.present()
    if not sensors:
        return Log(joint_names)
    shares = {name: _shares(errors) for name, errors in sensors.items()}
    times, instants = {}, {}
    for name, errors in sensors.items():
        times[name] = sample_times(errors.rate, duration)[first_sample(errors) :]
        numbers = np.arange(times[name].size)[:, None] + shares[name][0]
        instants[name] = numbers / errors.rate
    everything = np.concatenate([each.ravel() for each in instants.values()])
    keys = np.round(everything * 1e9).astype(np.int64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    at_instants = motion(everything[first])
    samples, true, start = {}, {}, 0
    for name, errors in sensors.items():
        rows = inverse[start : start + instants[name].size]
        start += rows.size
        value, weights = SENSORS[name].ideal(at_instants)[rows], shares[name][1]
        if weights.size > 1:
            value = np.einsum("s,nsi->ni", weights, value.reshape(-1, weights.size, 3))
        samples[name] = Samples(times[name], value)
        turns = name == "joint_rates" and suite.encoders and suite.encoders.eccentricity_mrad
        if turns or (isinstance(errors, VectorSensor) and errors.lever_arm_mm):
            true[name] = at_instants.select(rows)
    return Log(joint_names, samples, motion=true)


def _shares(errors: SensorErrors) -> tuple[Array, Array]:
    """Return instants (S,) in units of a sensor's period, and weights (S,) of a sample's mean."""
    if not first_sample(errors):
        return np.zeros(1), np.ones(1)
    steps = 2 * int(np.ceil(1 / (errors.rate * 0.02)))
    weights = np.ones(steps + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    return np.arange(steps + 1) / steps, weights / weights.sum()
