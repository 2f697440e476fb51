"""Removes samples that are grossly wrong and counts them, from whole logs and from chunks of logs.

Screening uses only the samples themselves. It finds damaged values, wrong stamps, sensors that
repeat themselves, and spikes of many σ. Smaller errors, which only a comparison with the
spacecraft's motion can show, are left to the likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import THRUST, Log, Samples, concatenated_samples, without_flips
from cpid_drake.logs.noise_estimation import rounding
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import VALVE

QUATERNION_NORM = 1e-3
"""Largest deviation of the norm of an attitude's quaternion from 1: rounding to three decimals
causes 1e-3; an uninitialized message has the norm 0."""

LARGEST = 1e9
"""Largest value of any sensor [SI units]: a wheel at 3000 rpm needs five weeks to turn by 1e9 rad,
and larger values are damaged messages whose squares may overflow."""

LONGEST_GAP = 3600.0
"""Longest time between two stamps of a log [s]; with a longer one, a clock was wrong."""

LONGEST_DELAY = 1.0
"""Longest delay of a sensor, or of the log of thrust [s]. A stamp later than all others by more, or
by more than five steps of the slowest sensor, must be confirmed by other stamps; and stamps of one
topic do not go back so far."""

CONFIRMING = 3
"""Number of different stamps that confirm each other: a damaged one, or two, cannot end a log."""

SPIKE = 10.0
"""Smallest deviation of a spike, in σ: noise alone deviates so once in 1e12 samples."""

PROMINENCE = 30.0
"""Ratio of a spike's deviation to the upper quartile of those around it: noise that is larger than
given, jitter of stamps and fast motion make all samples deviate. In a million samples of noise, the
largest exceeds the upper quartile about 15 times."""

BRIDGE = 4.0
"""Ratio of a spike's deviation to that of its four neighbours from a parabola: a kink of the motion
bends its neighbours, too."""

NEIGHBOURHOOD = 16
"""Number of samples around a sample that show what is usual."""

REPEATS = 1e-9
"""Largest probability with which noise repeats the samples of a sensor that does not repeat itself:
one false alarm in two weeks at 1000 Hz."""


@dataclass(frozen=True, eq=False)
class Screened:
    """The result of screening.

    Attributes:
        log: the accepted samples.
        rejected: number of rejected samples of every sensor of the table, and of thrust if any.
        memory: what the screening of the next chunk needs: the latest accepted samples of every
            sensor, at most `NEIGHBOURHOOD`.

    """

    log: Log
    rejected: dict[str, int]
    memory: Log


def screen(log: Log, suite: SensorSuite | None = None, memory: Log | None = None) -> Screened:
    """Return the usable samples, and the number of unusable ones by sensor.

    These samples are unusable:

    - samples with an entry that is not finite, or that no sensor of the suite can have;
    - attitudes whose quaternion has a norm that differs from 1;
    - samples after a silence of all sensors, unless at least `CONFIRMING` different stamps follow
      it; samples with stamps more than `LONGEST_GAP` from most others; and samples that are not
      later than all before, such as those that repeat a stamp, in a file or on a bus: of several,
      the first counts, whatever the others say;
    - samples that repeat the one before more often than noise does;
    - spikes: single samples far from every line through samples on one side or on both sides.

    The log of thrust keeps its samples, except repeated ones. One that is not finite, not in order,
    or that contradicts another with its stamp is refused: a wrong one would hold on.

    Only sensors of the suite are screened for the last two. Quaternions are normalized; their sign,
    which has no meaning, is kept.

    A log may be screened in successive chunks, with the memory of each chunk for the next one. The
    result is that for the whole log, except for spikes among a sensor's last two samples of a
    chunk, which are accepted.

    Args:
        log: the samples, in order of arrival.
        suite: the sensors' errors; None if they are not known.
        memory: the memory after the previous chunk; None for the first chunk and for whole logs.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor; the valves of
            the log are not those of the suite, or the log has force and torque, too; or the log of
            thrust as above.

    """
    memory = memory or Log(log.joint_names)
    present = suite.present() if suite else {}
    log, again = _with_thrust(log, suite, memory)
    given = as_arrays(log)
    readable = {name: _readable(name, s, name in present) for name, s in given.items()}
    confirmed = _confirmed([samples.time for samples in readable.values()], memory.interval[1])
    kept, recent = dict[str, Samples](), dict[str, Samples]()
    for name, samples in readable.items():
        before = memory[name]
        good = np.isin(samples.time, confirmed)
        samples = samples if good.all() else samples.where(good)
        later = is_later(samples.time, before.last_time)
        samples = samples if later.all() else samples.where(later)
        everything = concatenated_samples([before, samples]) if len(before) else samples
        if len(samples) and suite is not None and name in present:
            keep = ~_unusable(name, everything, suite)
            keep[: len(before)] = True
            samples, everything = samples.where(keep[len(before) :]), everything.where(keep)
        # The copy releases the memory of all earlier samples.
        recent[name] = concatenated_samples([everything.where(slice(-NEIGHBOURHOOD, None))])
        kept[name] = samples
    rejected = {name: len(samples) - len(kept[name]) for name, samples in given.items()}
    if again:
        rejected[THRUST] = again
    held = log.samples.get(THRUST) or memory.samples.get(THRUST)
    if held:
        recent[THRUST] = concatenated_samples([held.where(slice(-1, None))])
    return Screened(given.updated(kept), rejected, Log(log.joint_names, recent))


def is_later(time: Array, since: float = -np.inf) -> NDArray[np.bool_]:
    """Return which stamps (N,) [s] are later than `since` and all before; others repeat or go back.

    This says everywhere which of several samples with one stamp counts.
    """
    latest = np.fmax.accumulate(np.append(since, time))[:-1]
    return np.asarray(time > latest)


def as_arrays(log: Log) -> Log:
    """Return a log whose times (N,) and values (N, width) are arrays of numbers.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor.

    """
    widths = {name: sensor.width_of(len(log.joint_names)) for name, sensor in SENSORS.items()}
    return log.updated({name: _arrays(name, log[name], width) for name, width in widths.items()})


def _arrays(name: str, given: Samples, width: int) -> Samples:
    try:
        time, value = np.asarray(given.time, float), np.asarray(given.value, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"log: '{name}' is not made of numbers: {error}") from error
    if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
        raise InputError(
            f"log: '{name}' needs times (N,) and values (N, {width}), "
            f"not {time.shape} and {value.shape}"
        )
    return Samples(time, value.reshape(time.size, width))


# -- thrust, whose samples hold until the next ----------------------------------------------------


def _with_thrust(log: Log, suite: SensorSuite | None, memory: Log) -> tuple[Log, int]:
    """Return a log with one series of thrust, and how many of its samples repeat or are late.

    The series is that of forces, or of the openings (N, V) of valves.

    Raises:
        InputError: the valves of the log are not those of the suite, an opening is not possible,
            the log has force and torque, too; or samples are not finite numbers in the order of
            time.

    """
    if SENSORS.keys() >= log.samples.keys():
        return log, 0
    valves, thrusters = log.valves, None if suite is None else suite.thrusters
    since = memory.thrust.last_time
    if not valves or thrusters is None:
        if THRUST not in log.samples:
            return log, 0
        width = len(thrusters.valves) if thrusters else 6
        held = _held(THRUST, log.thrust, width, since)
        return log.updated({THRUST: held}), len(log.thrust) - len(held)
    missing, unknown = thrusters.valves.keys() - valves, valves.keys() - thrusters.valves
    if missing:
        raise InputError(f"the log has no column '{VALVE}{min(missing)}' of a valve of the sensors")
    if unknown:
        raise InputError(
            f"the sensors' thrusters have no valve '{min(unknown)}', which the log has: describe "
            "it, or leave out its column"
        )
    if THRUST in log.samples:
        raise InputError("the log has both valves and the force of all thrusters: keep one of them")
    each = {name: _held(VALVE + name, valves[name], 1, since) for name in thrusters.valves}
    again = max(len(valves[name]) - len(samples) for name, samples in each.items())
    for name, samples in each.items():
        if (samples.value < 0).any():
            raise InputError(f"'{VALVE}{name}': openings must be numbers from 0")
    time = np.unique(np.concatenate([samples.time for samples in each.values()]))
    openings = np.hstack([samples.held_at(time) for samples in each.values()])
    changes = np.append(True, (openings[1:] != openings[:-1]).any(axis=1))
    others = {n: s for n, s in log.samples.items() if not n.startswith(VALVE)}
    others[THRUST] = Samples(time[changes], openings[changes])
    return Log(log.joint_names, others, log.column_map), again


def _held(name: str, given: Samples, width: int, since: float) -> Samples:
    """Return samples that hold until the next, without repeated ones and those up to `since`."""
    log = _arrays(name, given, width)
    usable = np.isfinite(log.time) & np.isfinite(log.value).all(axis=1)
    if not usable.all():
        raise InputError(
            f"log: '{name}' at {log.time[(~usable).argmax()]:.6g} s is not finite: give "
            "the value that holds from then on"
        )
    again = (np.diff(log.time) == 0) & (log.value[1:] == log.value[:-1]).all(axis=1)
    log = log.where(np.append(True, ~again)[: len(log)] & (log.time > since))
    if not (np.diff(log.time) > 0).all():
        k = int((np.diff(log.time) <= 0).argmax())
        raise InputError(
            f"log: '{name}' at {log.time[k + 1]:.6g} s comes after that at "
            f"{log.time[k]:.6g} s: give one sample at a time, in the order of time"
        )
    return log


# -- stamps ---------------------------------------------------------------------------------------


def _confirmed(stamps: Sequence[Array], newest: float) -> Array:
    """Return the stamps of all sensors that confirm each other, or that are not late."""
    confirmed = [newest] if np.isfinite(newest) else []
    pool = np.unique(np.concatenate([*stamps, confirmed]))
    with np.errstate(over="ignore"):  # between absurd stamps, a step is infinite
        steps = [np.median(np.abs(np.diff(time))) for time in stamps if time.size > 1]
        silence = max(LONGEST_DELAY, 5 * float(max(steps, default=0.0)))
        group = np.append(0, np.cumsum(np.diff(pool) > silence))[: pool.size]
    if not pool.size:
        return pool
    count = np.bincount(group)
    is_good = count >= CONFIRMING
    if confirmed:
        is_good[: group[np.searchsorted(pool, newest)] + 1] = True
    else:
        is_good[count.argmax()] = True
    pool = pool[is_good[group]]
    part = np.append(0, np.cumsum(np.diff(pool) > LONGEST_GAP))  # the clock is wrong in others
    of_newest = part[np.searchsorted(pool, newest)] if confirmed else np.bincount(part).argmax()
    return np.asarray(pool[part == of_newest])


# -- values ---------------------------------------------------------------------------------------


def _readable(name: str, samples: Samples, is_known: bool) -> Samples:
    """Return the samples that are finite and possible for the sensor, attitudes normalized."""
    time, value = samples.time, samples.value
    usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
    if is_known:
        usable &= (np.abs(value) < LARGEST).all(axis=1)
    if name == "attitude":
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(value, axis=1)
        usable &= np.abs(norm - 1) < QUATERNION_NORM
        value = value / np.where(usable, norm, 1.0)[:, None]
    samples = Samples(time, value)
    return samples if usable.all() else samples.where(usable)


def _unusable(name: str, samples: Samples, suite: SensorSuite) -> NDArray[np.bool_]:
    """Return which samples repeat the one before, or are spikes."""
    time, value = samples.time, samples.value
    sigma = float(suite.sigmas(name).max())
    step = max(suite[name].step, 0.0 if suite.decimals is None else 10.0**-suite.decimals)
    if name == "attitude":
        value = without_flips(value)
        sigma /= 2  # A rotation by δ changes the entries of a quaternion by δ/2 at most.
    bad = _repeated(value, np.resize(suite[name].sigmas, min(value.shape[1], 3)), step)
    rows = np.flatnonzero(~bad)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        bad[rows] = _spikes(time[rows], value[rows], sigma)
    return bad


def _repeated(value: Array, noise: Array, step: float) -> NDArray[np.bool_]:
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
    chance = np.minimum(max(step, rounding(value)) / (2 * np.sqrt(np.pi) * noise), 1.0)
    with np.errstate(divide="ignore"):  # an axis that a table holds has no noise
        rarity = float(np.log(chance[: varies.sum()]).sum())
    return np.asarray(count > (np.log(REPEATS) / rarity if rarity < 0 else np.inf))


def _spikes(time: Array, value: Array, sigma: float) -> NDArray[np.bool_]:
    """Return which samples (N,) are spikes in at least one entry.

    The deviation of a sample is its least distance from the lines through two samples on its left,
    on its right, or on both sides, and from the cubic through these four: a step or a kink of the
    motion leaves it small. The first two and the last two samples cannot be judged, and are
    accepted.
    """
    is_spike = np.zeros(time.size, dtype=bool)
    if time.size < 5:
        return is_spike
    t = [time[k : time.size - 4 + k, None] for k in range(5)]
    x = [value[k : time.size - 4 + k] for k in range(5)]
    paths = [
        x[i] + (x[j] - x[i]) * ((t[2] - t[i]) / (t[j] - t[i]))
        for i, j in ((0, 1), (3, 4), (1, 3), (0, 4))
    ]
    # Third divided differences; that of the neighbours is their distance from a parabola.
    sides = (0, 1, 3, 4)
    weight = [1 / np.prod([t[i] - t[j] for j in sides if j != i], axis=0) for i in sides]
    bend = np.abs(sum(w * x[i] for w, i in zip(weight, sides))) / np.sum(np.abs(weight), axis=0)
    paths.append(sum(w * x[i] / (t[2] - t[i]) for w, i in zip(weight, sides)))
    paths[-1] *= np.prod([t[2] - t[i] for i in sides], axis=0)
    deviation = np.min([np.abs(x[2] - path) for path in paths], axis=0)
    rows = np.flatnonzero((deviation > SPIKE * sigma).any(axis=1))
    if not rows.size:
        return is_spike
    window = np.clip(
        rows[:, None] + np.arange(-NEIGHBOURHOOD // 2, NEIGHBOURHOOD // 2 + 1), 0, len(x[2]) - 1
    )
    limit = np.maximum(SPIKE * sigma, PROMINENCE * np.quantile(deviation[window], 0.75, axis=1))
    limit = np.maximum(limit, BRIDGE * bend[rows])
    gap, steps = t[3] - t[1], t[1] - t[0] + t[4] - t[3]  # across a gap, nothing is known
    far = (deviation[rows] > limit).any(axis=1) & (gap <= 3 * steps)[rows, 0]
    is_spike[rows[far] + 2] = True
    return is_spike
