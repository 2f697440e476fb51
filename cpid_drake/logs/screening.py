"""Removes samples that are grossly wrong and counts them, from whole logs and from chunks of logs.

Screening uses only the samples themselves. It finds damaged values, wrong stamps, sensors that
repeat themselves, and spikes of many σ. Smaller errors, which only a comparison with the
spacecraft's motion can show, are left to the likelihood.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.log import THRUST, Log, Samples
from cpid_drake.logs.noise_estimation import rounding
from cpid_drake.logs.stamps import usable_stamps
from cpid_drake.sensors.sensors import ATTITUDE, SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import VALVE

QUATERNION_NORM = 1e-3
"""Largest deviation of the norm of an attitude's quaternion from 1: rounding to three decimals
causes 1e-3; an uninitialized message has the norm 0."""

LARGEST = 1e9
"""Largest value of any sensor [SI units]: a wheel at 3000 rpm needs five weeks to turn by 1e9 rad,
and larger values are damaged messages whose squares may overflow."""

SPIKE = 10.0
"""Smallest deviation of a spike, in σ: noise alone deviates so once in 1e12 samples."""

PROMINENCE = 30.0
"""Ratio of a spike's deviation to the upper quartile of those around it: noise that is larger than
given, jitter of stamps and fast motion make all samples deviate. In a million samples of noise, the
largest exceeds the upper quartile about 15 times."""

BRIDGE = 4.0
"""Ratio of a spike's deviation to that of its four neighbours from a parabola."""

WINDOW = 16
"""Number of samples around a sample that show what is usual."""

REPEATS = 1e-9
"""Largest probability with which noise repeats the samples of a sensor that does not repeat itself:
one false alarm in two weeks at 1000 Hz."""


@dataclass(frozen=True, eq=False)
class ScreeningMemory:
    """What screening remembers from one chunk to the next; its size is bounded.

    Attributes:
        recent: by sensor, its latest accepted samples, at most `WINDOW`.
        unconfirmed: the latest stamps that were too late, at most 8 [s].

    """

    recent: Mapping[str, Samples] = field(default_factory=dict)
    unconfirmed: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def last(self, name: str) -> float:
        """Return the stamp of a sensor's latest accepted sample [s]; −inf before the first."""
        return float(self.recent[name].time[-1]) if name in self.recent else -np.inf

    @property
    def newest(self) -> float:
        """Stamp of the latest accepted sample of all sensors [s]; −inf before the first."""
        return max(map(self.last, self.recent), default=-np.inf)


@dataclass(frozen=True, eq=False)
class Screened:
    """The result of screening.

    Attributes:
        measurements: the accepted samples.
        rejected: number of rejected samples of every sensor of the table.
        memory: what the screening of the next chunk needs.

    """

    measurements: Log
    rejected: dict[str, int]
    memory: ScreeningMemory


def as_arrays(measurements: Log) -> Log:
    """Return measurements whose times (N,) and values (N, width) are arrays of numbers.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor.

    """
    joints = len(measurements.joint_names)
    return measurements.updated(
        {name: _arrays(name, s, SENSORS[name].width(joints)) for name, s in measurements.items()}
    )


def _arrays(name: str, given: Samples, width: int) -> Samples:
    try:
        time, value = np.asarray(given.time, float), np.asarray(given.value, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"measurements: '{name}' is not made of numbers: {error}") from error
    if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
        raise InputError(
            f"measurements: '{name}' needs times (N,) and values (N, {width}), "
            f"not {time.shape} and {value.shape}"
        )
    return Samples(time, value.reshape(time.size, width))


def held(name: str, given: Samples, width: int) -> Samples:
    """Return samples that hold until the next, without repeated ones.

    Raises:
        InputError: they are not finite numbers, or not in the order of time. Without such a sample,
            a wrong value would hold on.

    """
    log = _arrays(name, given, width)
    usable = np.isfinite(log.time) & np.isfinite(log.value).all(axis=1)
    if not usable.all():
        k = int((~usable).argmax())
        raise InputError(
            f"measurements: '{name}' at {log.time[k]:.6g} s is not finite: give the value that "
            "holds from then on"
        )
    again = np.zeros(len(log), dtype=bool)
    again[1:] = (np.diff(log.time) == 0) & (log.value[1:] == log.value[:-1]).all(axis=1)
    log = log.where(~again)
    if not (np.diff(log.time) > 0).all():
        k = int((np.diff(log.time) <= 0).argmax())
        raise InputError(
            f"measurements: '{name}' at {log.time[k + 1]:.6g} s comes after that at "
            f"{log.time[k]:.6g} s: give one sample at a time, in the order of time"
        )
    return log


def with_thrust(measurements: Log, suite: SensorSuite | None) -> Log:
    """Return measurements with one log of thrust: of forces, or of the openings (N, V) of valves.

    Raises:
        InputError: the valves of the log are not those of the suite, an opening is not possible,
            the log has force and torque, too; or for the same reasons as `held`.

    """
    valves, thrusters = measurements.valves, None if suite is None else suite.thrusters
    if not valves or thrusters is None:
        if THRUST not in measurements.samples:
            return measurements
        width = len(thrusters.valves) if thrusters else 6
        return measurements.updated({THRUST: held(THRUST, measurements.thrust, width)})
    missing, unknown = thrusters.valves.keys() - valves, valves.keys() - thrusters.valves
    if missing:
        raise InputError(f"the log has no column '{VALVE}{min(missing)}' of a valve of the sensors")
    if unknown:
        raise InputError(
            f"the sensors' thrusters have no valve '{min(unknown)}', which the log has: describe "
            "it, or leave out its column"
        )
    if THRUST in measurements.samples:
        raise InputError("the log has both valves and the force of all thrusters: keep one of them")
    logs = {name: held(VALVE + name, log, 1) for name, log in valves.items()}
    for name, log in logs.items():
        if (log.value < 0).any():
            raise InputError(f"'{VALVE}{name}': openings must be numbers from 0")
    time = np.unique(np.concatenate([log.time for log in logs.values()]))
    openings = np.hstack([logs[name].held_at(time) for name in thrusters.valves])
    changes = np.append(True, (openings[1:] != openings[:-1]).any(axis=1))
    samples = {n: s for n, s in measurements.samples.items() if not n.startswith(VALVE)}
    samples[THRUST] = Samples(time[changes], openings[changes])
    return Log(measurements.joint_names, samples, measurements.column_map)


def screen(
    measurements: Log,
    suite: SensorSuite | None = None,
    memory: ScreeningMemory | None = None,
) -> Screened:
    """Return the usable samples, and the number of unusable ones by sensor.

    These samples are unusable:

    - samples with an entry that is not finite, or that no sensor of the suite can have;
    - attitudes whose quaternion has a norm that differs from 1;
    - samples with wrong stamps: see `stamps.usable_stamps`;
    - samples that repeat the one before more often than noise does;
    - spikes: single samples far from every line through samples on one side or on both sides.

    The log of thrust keeps its samples; see `held`.

    Only sensors of the suite are screened for the last two. Quaternions are normalized; their sign,
    which has no meaning, is kept.

    A log may be screened in successive chunks, with the memory of each chunk for the next one. The
    result is that for the whole log, except for spikes among a sensor's last two samples of a
    chunk, which are accepted.

    Args:
        measurements: the samples, in order of arrival.
        suite: the sensors' errors; None if they are not known.
        memory: the memory after the previous chunk; None for the first chunk and for whole logs.

    Raises:
        InputError: for the same reasons as `as_arrays` and `with_thrust`.

    """
    memory = memory or ScreeningMemory()
    present = suite.present() if suite else {}
    given = as_arrays(with_thrust(measurements, suite))
    readable = {name: _readable(name, s, name in present) for name, s in given.items()}
    stamps = {name: samples.time for name, samples in readable.items()}
    indices, unconfirmed = usable_stamps(
        stamps, {name: s.time for name, s in memory.recent.items()}, memory.unconfirmed
    )
    kept: dict[str, Samples] = {}
    recent = dict(memory.recent)
    for name, samples in readable.items():
        samples = samples if indices[name].size == len(samples) else samples.where(indices[name])
        if len(samples):
            everything, known = samples, 0
            if name in recent:
                known, everything = len(recent[name]), _together(recent[name], samples)
            if suite is not None and name in present:
                keep = ~_unusable(name, everything, suite)
                keep[:known] = True
                samples, everything = samples.where(keep[known:]), everything.where(keep)
            # The copy releases the memory of all earlier samples.
            last = everything.where(slice(-WINDOW, None))
            recent[name] = Samples(last.time.copy(), last.value.copy())
        kept[name] = samples
    rejected = {name: len(samples) - len(kept[name]) for name, samples in given.items()}
    return Screened(given.updated(kept), rejected, ScreeningMemory(recent, unconfirmed))


def _readable(name: str, samples: Samples, known: bool) -> Samples:
    """Return the samples that are finite and possible for the sensor, attitudes normalized."""
    time, value = samples.time, samples.value
    if not time.size:
        return samples
    usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
    if known:
        usable &= (np.abs(value) < LARGEST).all(axis=1)
    if SENSORS[name].quantity is ATTITUDE:
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(value, axis=1)
        usable &= np.abs(norm - 1) < QUATERNION_NORM
        value = value / np.where(usable, norm, 1.0)[:, None]
    samples = Samples(time, value)
    return samples if usable.all() else samples.where(usable)


def _together(before: Samples, after: Samples) -> Samples:
    time = np.concatenate([before.time, after.time])
    return Samples(time, np.concatenate([before.value, after.value]))


def _unusable(name: str, samples: Samples, suite: SensorSuite) -> NDArray[np.bool_]:
    """Return which samples repeat the one before, or are spikes."""
    time, value = samples.time, samples.value
    sigma = float(suite.sigmas(name).max())
    step = max(suite[name].step, 0.0 if suite.decimals is None else 10.0**-suite.decimals)
    if SENSORS[name].quantity is ATTITUDE:
        value = _without_flips(value)
        sigma /= 2  # A rotation by δ changes the entries of a quaternion by δ/2 at most.
    bad = repeated(value, np.resize(suite[name].sigmas, min(value.shape[1], 3)), step)
    rows = np.flatnonzero(~bad)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        bad[rows] = spikes(time[rows], value[rows], sigma)
    return bad


def _without_flips(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4) of the same attitudes, without jumps of sign."""
    flips = np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0
    if not flips.any():
        return quaternion
    sign = np.cumprod(np.append(1.0, np.where(flips, -1.0, 1.0)))
    return np.asarray(quaternion * sign[:, None])


def repeated(
    value: NDArray[np.float64], noise: NDArray[np.float64], step: float
) -> NDArray[np.bool_]:
    """Return which samples (N, width) repeat the one before more often than noise does.

    Args:
        value: the samples; entries that are constant do not count.
        noise: σ of the white noise of independent entries; without noise, nothing is wrong.
        step: quantization of the values; rounding in a file is seen from the values.

    """
    same = np.append(False, (value[1:] == value[:-1]).all(axis=1))
    varies = np.ptp(value, axis=0) > 0 if len(value) else np.zeros(0, dtype=bool)
    if not same.any() or not noise.all() or not varies.any():
        return np.zeros(len(value), dtype=bool)
    rows = np.arange(len(value))
    count = rows - np.maximum.accumulate(np.where(same, 0, rows))
    # The density of the difference of two errors at zero is 1/(2√π σ).
    step = max(step, rounding(value))
    chance = np.minimum(step / (2 * np.sqrt(np.pi) * noise), 1.0)
    chance = chance[: varies.sum()]  # an axis that a table holds has no noise
    with np.errstate(divide="ignore"):
        rarity = float(np.log(chance).sum())
    return np.asarray(count > (np.log(REPEATS) / rarity if rarity < 0 else np.inf))


def spikes(
    time: NDArray[np.float64], value: NDArray[np.float64], sigma: float
) -> NDArray[np.bool_]:
    """Return which samples (N,) are spikes in at least one entry.

    The deviation of a sample is its least distance from the lines through two samples on its left,
    on its right, or on both sides, and from the cubic through these four: a step or a kink of the
    motion leaves it small. The first two and the last two samples cannot be judged, and are
    accepted.

    Args:
        time: (N,) increasing stamps [s].
        value: (N, width) samples; attitudes as quaternions without jumps of sign.
        sigma: σ of every entry.

    """
    found = np.zeros(time.size, dtype=bool)
    if time.size < 5:
        return found
    t = [time[k : time.size - 4 + k, None] for k in range(5)]
    x = [value[k : time.size - 4 + k] for k in range(5)]
    deviation = np.full(x[2].shape, np.inf)
    for i, j in ((0, 1), (3, 4), (1, 3), (0, 4)):
        line = x[i] + (x[j] - x[i]) * ((t[2] - t[i]) / (t[j] - t[i]))
        deviation = np.minimum(deviation, np.abs(x[2] - line))
    others = (0, 1, 3, 4)
    cubic = sum(
        x[i] * np.prod([(t[2] - t[j]) / (t[i] - t[j]) for j in others if j != i], axis=0)
        for i in others
    )
    deviation = np.minimum(deviation, np.abs(x[2] - cubic))
    rows = np.flatnonzero((deviation > SPIKE * sigma).any(axis=1))
    if not rows.size:
        return found
    window = np.clip(rows[:, None] + np.arange(-WINDOW // 2, WINDOW // 2 + 1), 0, len(x[2]) - 1)
    limit = np.maximum(SPIKE * sigma, PROMINENCE * np.quantile(deviation[window], 0.75, axis=1))
    rows = rows + 2
    for around in ((-2, -1, 1, 2), (-3, -2, -1, 1), (-1, 1, 2, 3)):
        limit = np.maximum(limit, BRIDGE * bend(time, value, rows[:, None] + around))
    gap = time[rows + 1] - time[rows - 1]
    sides = time[rows - 1] - time[rows - 2] + time[rows + 2] - time[rows + 1]
    far = np.any(deviation[rows - 2] > limit, axis=1)
    found[rows[far & (gap <= 3 * sides)]] = True
    return found


def bend(
    time: NDArray[np.float64], value: NDArray[np.float64], rows: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return how far each four samples (n, 4) are from a parabola (n, width); zero at the ends.

    It is their third divided difference, divided by that of values ±1 with alternating signs.
    """
    inside = np.all((rows >= 0) & (rows < time.size), axis=1)
    t, x = time[rows.clip(0, time.size - 1)], value[rows.clip(0, time.size - 1)]
    apart = t[:, :, None] - t[:, None] + np.eye(4)
    weight = 1 / apart.prod(axis=2)
    size = np.abs(np.einsum("nk,nki->ni", weight, x)) / np.abs(weight).sum(axis=1)[:, None]
    return np.where(inside[:, None], size, 0.0)
