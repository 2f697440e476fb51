"""What a log says at common instants: its sensors, each smoothed by a regression spline."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import angular_velocity
from cpid_drake.logs.log import Log, Samples, without_flips
from cpid_drake.logs.noise_estimation import FEWEST
from cpid_drake.logs.splines import in_gap, regression_spline
from cpid_drake.sensors.sensors import POSITIONS

COMPARED_LENGTH = 60.0
"""Length of the part of a log that is compared [s]: the one in which the joints move most."""

_LEAST = 1e-9  # smallest motion [rad, m, rad/s, m/s]


@dataclass(frozen=True, eq=False)
class Instants:
    """What a log says at common instants.

    Attributes:
        time: (N,) [s].
        values: by sensor, (N, width); attitudes are quaternions of any length, scalar first.
        rates: of encoders, attitude and position, their derivatives.
        moving: names of the sensors whose samples show a motion, and of the joints.
        is_free: whether no thruster fires, so that momentum is conserved.

    """

    time: Array
    values: Mapping[str, Array]
    rates: Mapping[str, Array]
    moving: frozenset[str]
    is_free: bool

    def changed(self, **changes: Callable[[Array], Array]) -> "Instants":
        """Return what a log says with other values of some sensors, and their derivatives."""

        def new(parts: Mapping[str, Array]) -> dict[str, Array]:
            changed = {
                name: change(parts[name]) for name, change in changes.items() if name in parts
            }
            return {**parts, **changed}

        return replace(self, values=new(self.values), rates=new(self.rates))

    def without(self, *sensors: str) -> "Instants":
        """Return what the log says without some sensors."""

        def rest(parts: Mapping[str, Array]) -> dict[str, Array]:
            return {name: value for name, value in parts.items() if name not in sensors}

        return replace(
            self, values=rest(self.values), rates=rest(self.rates), moving=self.moving - {*sensors}
        )

    def over(self, other: "Instants") -> "Instants":
        """Return what this log says, with the sensors of another one that it does not have."""
        values, rates = {**other.values, **self.values}, {**other.rates, **self.rates}
        return replace(self, values=values, rates=rates, moving=self.moving | other.moving)

    def at_every(self, step: int) -> "Instants":
        """Return what the log says at every second, third, … instant."""
        values = {name: value[::step] for name, value in self.values.items()}
        rates = {name: value[::step] for name, value in self.rates.items()}
        return replace(self, time=self.time[::step], values=values, rates=rates)

    def scaled(self, size: ArrayLike, *sensors: str) -> "Instants":
        """Return what a log says with the values of some sensors times a size."""
        return self.changed(**dict.fromkeys(sensors, partial(np.multiply, size)))

    @property
    def quaternion(self) -> Array:
        """(N, 4) attitudes; B's axes are those of W without an attitude."""
        still = np.tile([1.0, 0.0, 0.0, 0.0], (len(self.time), 1))
        return self.values.get("attitude", still)

    @property
    def R_WB(self) -> Array:
        """(N, 3, 3) attitudes."""
        return np.asarray(Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix())

    @property
    def turning(self) -> Array | None:
        """(N, 3) angular velocity in B that follows from the attitude."""
        if "attitude" not in self.values:
            return None
        return angular_velocity(self.quaternion, self.rates["attitude"])


@dataclass(frozen=True, eq=False)
class SmoothedLog:
    """A screened log whose sensors are smoothed by regression splines.

    Attributes:
        splines, times: by sensor, its spline and its stamps [s].
        moving, is_free: see `Instants`.

    """

    splines: Mapping[str, BSpline]
    times: Mapping[str, Array]
    moving: frozenset[str]
    is_free: bool

    @classmethod
    def of(cls, log: Log) -> "SmoothedLog | None":
        """Return a smoothed log: the part in which the joints move most, before thrusters fire.

        None if the joints have too few samples.
        """
        log, is_free = compared_part(log)
        splines, moving = {}, set()
        used = {name: s for name, s in log.items() if len(s) >= FEWEST}
        if "encoders" not in used or np.isnan(used["encoders"].value).any():
            return None
        for name, samples in used.items():
            if name == "attitude":
                samples = Samples(samples.time, without_flips(samples.value))
            splines[name] = regression_spline(samples)
            fitted = splines[name](samples.time)
            noise = np.sqrt(np.mean((samples.value - fitted) ** 2, axis=0))
            if name not in POSITIONS:  # a constant rate is a motion, a constant position is none
                fitted = fitted - fitted.mean(axis=0)
            size = np.sqrt(np.mean(fitted**2, axis=0))
            if name in ("encoders", "joint_rates"):
                moved = size > noise + _LEAST
                moving |= {f"{name} {joint}" for j, joint in enumerate(log.joint_names) if moved[j]}
            elif np.linalg.norm(size) > np.linalg.norm(noise) + _LEAST:
                moving.add(name)
        times = {name: samples.time for name, samples in used.items()}
        return cls(splines, times, frozenset(moving), is_free)

    def of_sensors(self, names: Collection[str]) -> "SmoothedLog":
        """Return what some of the sensors say."""
        splines = {name: spline for name, spline in self.splines.items() if name in names}
        moving = frozenset(each for each in self.moving if each.partition(" ")[0] in names)
        return replace(self, splines=splines, moving=moving)

    def instants(self, later: Mapping[str, float] = MappingProxyType({})) -> Instants | None:
        """Return what the log says at common instants outside of gaps; None if there are none.

        Args:
            later: by sensor, the time that is added to its stamps [s].

        """
        delays = {name: later.get(name, 0.0) for name in self.splines}
        start = max(self.times[name][0] + delay for name, delay in delays.items())
        end = min(self.times[name][-1] + delay for name, delay in delays.items())
        edge = (end - start) / 20  # where splines are less accurate
        time = np.linspace(start + edge, end - edge, 200)
        for name, delay in delays.items():
            time = time[~in_gap(self.times[name], time - delay)]
        if not (end > start and time.size >= FEWEST):
            return None
        values = {name: spline(time - delays[name]) for name, spline in self.splines.items()}
        rates = {
            name: self.splines[name](time - delays[name], 1)
            for name in POSITIONS.values()
            if name in self.splines
        }
        return Instants(time - time[0], values, rates, self.moving, self.is_free)


def instants_of(log: Log) -> Instants | None:
    """Return what a screened log says at common instants; None for too few samples."""
    smoothed = SmoothedLog.of(log)
    return None if smoothed is None else smoothed.instants()


def compared_part(log: Log) -> tuple[Log, bool]:
    """Return at most 3000 samples of each sensor, those that are compared, and `is_free`."""
    coasting = log.between(-np.inf, log.first_burn)
    is_free = len(coasting.encoders) >= FEWEST
    return _liveliest(coasting if is_free else log).thinned(3000), is_free


def _liveliest(log: Log) -> Log:
    """Return the part of a log in which its joints move most."""
    time, q = log.encoders.time, log.encoders.value
    if len(time) < FEWEST or time[-1] - time[0] <= COMPARED_LENGTH:
        return log
    # The time may be in another unit: a part has many samples in any case.
    step = float(np.median(np.diff(time)))
    count = max(int(COMPARED_LENGTH / step), 20 * FEWEST)
    pieces = np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) > count * step) + 1)
    cut = (np.array_split(piece, max(len(piece) // count, 1)) for piece in pieces)
    parts = [part for each in cut for part in each if len(part) >= FEWEST]
    if not parts:
        return log
    spread = np.array([np.std(q[part], axis=0) for part in parts])
    scaled = spread / np.maximum(spread.max(axis=0, initial=0.0), 1e-300)
    most = parts[int(scaled.sum(axis=1).argmax())]
    return log.between(time[most[0]], time[most[-1]])
