"""Removes samples that are grossly wrong and counts them, from whole logs and from chunks of logs.

Screening uses only the samples themselves. It finds damaged values, wrong stamps, stuck sensors and
spikes of many σ. Smaller errors, which only a comparison with the spacecraft's motion can show, are
left to the likelihood.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import THRUST, Measurements, Samples
from cpid_drake.sensing.repeats import Expected, find_repeats
from cpid_drake.sensing.screening_limits import ScreeningLimits, ScreeningMemory, SensorMemory
from cpid_drake.sensing.sensors import (
    ATTITUDE,
    JOINT_POSITIONS,
    JOINT_RATES,
    SENSORS,
    SensorErrors,
)
from cpid_drake.sensing.spikes import find_spikes
from cpid_drake.sensing.stamps import usable_stamps
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.sensing.thrusters import VALVE

__all__ = ["Screened", "ScreeningLimits", "ScreeningMemory", "as_arrays", "screen"]

DEFAULT_LIMITS = ScreeningLimits()


@dataclass(frozen=True, eq=False)
class Screened:
    """The result of screening.

    Attributes:
        measurements: the accepted samples.
        rejected: number of rejected samples of every sensor of the table.
        memory: what the screening of the next chunk needs.

    """

    measurements: Measurements
    rejected: dict[str, int]
    memory: ScreeningMemory


def as_arrays(measurements: Measurements) -> Measurements:
    """Return measurements whose times (N,) and values (N, width) are arrays of numbers.

    Raises:
        InputError: samples are not numbers, or their shapes do not match the sensor.

    """
    samples = {}
    for name, given in measurements.items():
        width = SENSORS[name].width(len(measurements.joint_names))
        try:
            time, value = np.asarray(given.time, float), np.asarray(given.value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"measurements: '{name}' is not made of numbers: {error}") from error
        if time.ndim != 1 or (time.size and value.shape != (time.size, width)):
            raise InputError(
                f"measurements: '{name}' needs times (N,) and values (N, {width}), "
                f"not {time.shape} and {value.shape}"
            )
        samples[name] = Samples(time, value.reshape(time.size, width))
    return measurements.updated(samples)


def with_valves(measurements: Measurements, suite: SensorSuite | None) -> Measurements:
    """Return measurements in which the openings of all valves (N, V) are the log of thrust.

    Without thrusters in the suite, the log is as it is.

    Raises:
        InputError: the valves of the log are not those of the suite, a time or an opening is not
            possible, or the log has force and torque, too.

    """
    valves, thrusters = measurements.valves, suite and suite.thrusters
    if not valves or thrusters is None:
        return measurements
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
    for name, samples in valves.items():
        time, value = np.asarray(samples.time, float), np.asarray(samples.value, float)
        if not (np.isfinite(time).all() and (np.diff(time) > 0).all() and (value >= 0).all()):
            raise InputError(
                f"'{VALVE}{name}': times must increase, and openings must be numbers from 0"
            )
    time = np.unique(np.concatenate([samples.time for samples in valves.values()]))
    openings = np.hstack([valves[name].held_at(time) for name in thrusters.valves])
    changes = np.append(True, (openings[1:] != openings[:-1]).any(axis=1))
    samples = {n: s for n, s in measurements.samples.items() if not n.startswith(VALVE)}
    samples[THRUST] = Samples(time[changes], openings[changes])
    return Measurements(measurements.joint_names, samples)


def usable_thrust(measurements: Measurements, suite: SensorSuite | None = None) -> Measurements:
    """Return measurements whose samples of thrust have increasing times.

    A sample of the same time and value as the one before is left out.

    Raises:
        InputError: samples of thrust are not finite numbers, or are not in the
            order of time. Without such a sample, a wrong thrust would hold on.

    """
    if THRUST not in measurements.samples:
        return measurements
    log = measurements.thrust
    try:
        time, value = np.asarray(log.time, float), np.asarray(log.value, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"measurements: '{THRUST}' is not made of numbers: {error}") from error
    width = len(suite.thrusters.valves) if suite and suite.thrusters else 6
    if time.ndim != 1 or value.shape != (time.size, width):
        raise InputError(
            f"measurements: '{THRUST}' needs times (N,) and values (N, {width}), "
            f"not {time.shape} and {value.shape}"
        )
    usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
    if not usable.all():
        k = int((~usable).argmax())
        raise InputError(
            f"measurements: '{THRUST}' at {time[k]:.6g} s is not finite: give the torque and force "
            "that hold from then on"
        )
    again = np.zeros(len(time), dtype=bool)
    again[1:] = (time[1:] == time[:-1]) & (value[1:] == value[:-1]).all(axis=1)
    time, value = time[~again], value[~again]
    if not (time[1:] > time[:-1]).all():
        k = int((time[1:] <= time[:-1]).argmax())
        raise InputError(
            f"measurements: '{THRUST}' at {time[k + 1]:.6g} s comes after that at {time[k]:.6g} s: "
            "give one sample at a time, in the order of time"
        )
    return measurements.updated({THRUST: Samples(time, value)})


def screen(
    measurements: Measurements,
    suite: SensorSuite | None = None,
    memory: ScreeningMemory | None = None,
    limits: ScreeningLimits = DEFAULT_LIMITS,
) -> Screened:
    """Return the usable samples, and the number of unusable ones by sensor.

    These samples are unusable:

    - samples with an entry that is not finite, or that no sensor of the suite can have;
    - attitudes whose quaternion has a norm that differs from 1;
    - samples with wrong stamps: see `stamps.usable_stamps`;
    - repeated samples of a stuck sensor, or of a transport that sends the last sample again: see
      `repeats.find_repeats`;
    - spikes: see `spikes.find_spikes`.

    The log of thrust keeps its samples; see `usable_thrust`.

    Only sensors of the suite are screened for the last two. Quaternions are normalized; their sign,
    which has no meaning, is kept.

    A log may be screened in successive chunks, with the memory of each chunk for the next one. The
    result is that for the whole log, except for suspicious samples at the end of a chunk: a spike
    among a sensor's last two samples, and repeats that only later samples show to be wrong, are
    accepted.

    Args:
        measurements: the samples, in order of arrival.
        suite: the sensors' errors; None if they are not known.
        memory: the memory after the previous chunk; None for the first chunk and for whole logs.
        limits: limits of screening.

    Raises:
        InputError: for the same reasons as `as_arrays`, `with_valves` and `usable_thrust`.

    """
    memory = memory or ScreeningMemory()
    present = suite.present() if suite else {}
    given = as_arrays(usable_thrust(with_valves(measurements, suite), suite))
    readable = {name: _readable(name, s, name in present, limits) for name, s in given.items()}
    stamps = {name: samples.time for name, samples in readable.items()}
    indices, unconfirmed = usable_stamps(stamps, memory, limits)
    kept: dict[str, Samples] = {}
    sensors = dict(memory.sensors)
    # Joint rates come first: they show whether repeated joint positions are stuck.
    for name in sorted(readable, key=lambda name: SENSORS[name].quantity is not JOINT_RATES):
        samples, index = readable[name], indices[name]
        if index.size < len(samples):
            samples = samples.where(index)
        if len(samples):
            seen = memory.sensors.get(name)
            errors = present.get(name)
            if suite is None or errors is None:
                sensors[name] = _remembered(samples, seen, limits)
            else:
                rates = _joint_rates(name, kept, memory, suite)
                samples, sensors[name] = _screened(name, samples, seen, suite, rates, limits)
        kept[name] = samples
    rejected = {name: len(samples) - len(kept[name]) for name, samples in given.items()}
    return Screened(given.updated(kept), rejected, ScreeningMemory(sensors, unconfirmed))


def _readable(name: str, samples: Samples, known: bool, limits: ScreeningLimits) -> Samples:
    """Return the samples that are finite and possible for the sensor, attitudes normalized."""
    time, value = samples.time, samples.value
    if not time.size:
        return samples
    usable = np.isfinite(time) & np.isfinite(value).all(axis=1)
    if known:
        usable &= (np.abs(value) < limits.largest_value).all(axis=1)
    if SENSORS[name].quantity is ATTITUDE:
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(value, axis=1)
        usable &= np.abs(norm - 1) < limits.quaternion_norm
        value = value / np.where(usable, norm, 1.0)[:, None]
    samples = Samples(time, value)
    return samples if usable.all() else samples.where(usable)


def _remembered(
    samples: Samples, seen: SensorMemory | None, limits: ScreeningLimits
) -> SensorMemory:
    """Return the memory of a sensor whose values are not screened."""
    recent = _latest(_joined(seen, samples), limits)
    width = samples.value.shape[1]
    return SensorMemory(recent, np.zeros(width, dtype=np.intp), np.zeros(width, dtype=bool))


def _joined(seen: SensorMemory | None, samples: Samples) -> Samples:
    if seen is None:
        return samples
    time = np.concatenate([seen.recent.time, samples.time])
    return Samples(time, np.concatenate([seen.recent.value, samples.value]))


def _latest(samples: Samples, limits: ScreeningLimits) -> Samples:
    # The copy releases the memory of all earlier samples.
    recent = slice(-limits.window, None)
    return Samples(samples.time[recent].copy(), samples.value[recent].copy())


def _screened(
    name: str,
    samples: Samples,
    seen: SensorMemory | None,
    suite: SensorSuite,
    rates: tuple[Samples, float] | None,
    limits: ScreeningLimits,
) -> tuple[Samples, SensorMemory]:
    """Return the samples of one sensor that are neither stuck nor spikes, and its memory."""
    everything = _joined(seen, samples)
    known = len(everything) - len(samples)
    time, value, errors = everything.time, everything.value, suite[name]
    sigma, noise = float(suite.sigmas(name).max()), errors.sigmas
    quantity = SENSORS[name].quantity
    if quantity is ATTITUDE:
        value = _without_flips(value)
        sigma /= 2  # A rotation by δ changes the entries of a quaternion by δ/2 at most.
    else:
        noise = np.broadcast_to(noise, value.shape[1:])
    expected = Expected(sigma, noise, _step(errors, suite), quantity is JOINT_POSITIONS)
    if rates is not None:
        travelled = _travelled(rates[0], time, limits)
        expected = replace(expected, travelled=travelled, rate_sigma=rates[1])
    repeats = find_repeats(time, value, known, seen, expected, limits)
    keep = ~repeats.stuck
    rows = np.flatnonzero(keep)
    if rows.size < keep.size:
        keep[rows] = ~find_spikes(time[rows], value[rows], sigma, limits)
    else:
        keep = ~find_spikes(time, value, sigma, limits)
    keep[:known] = True
    accepted = Samples(time, value)
    if not keep.all():
        accepted, samples = accepted.where(keep), samples.where(keep[known:])
    memory = SensorMemory(_latest(accepted, limits), repeats.count, repeats.varied)
    return samples, memory


def _step(errors: SensorErrors, suite: SensorSuite) -> float:
    """Return the coarsest step of a sensor's values, by quantization or rounding; 0 for none."""
    return max(errors.step, 0.0 if suite.rounding is None else 10.0**-suite.rounding)


def _without_flips(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4) of the same attitudes, without jumps of sign."""
    flips = np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0
    if not flips.any():
        return quaternion
    sign = np.cumprod(np.append(1.0, np.where(flips, -1.0, 1.0)))
    return np.asarray(quaternion * sign[:, None])


def _joint_rates(
    name: str, kept: dict[str, Samples], memory: ScreeningMemory, suite: SensorSuite
) -> tuple[Samples, float] | None:
    """Return the screened samples of joint rates and their σ, for a sensor of joint positions."""
    if SENSORS[name].quantity is not JOINT_POSITIONS:
        return None
    for other, samples in kept.items():
        if SENSORS[other].quantity is JOINT_RATES and other in suite.present() and len(samples):
            joined = _joined(memory.sensors.get(other), samples)
            return joined, float(suite.sigmas(other).max())
    return None


def _travelled(
    rates: Samples, time: NDArray[np.float64], limits: ScreeningLimits
) -> NDArray[np.float64]:
    """Return the least displacements (N, width) from the first sample of rates to some times.

    Between two samples, the slower one counts, and none if they differ in sign or are far apart.
    """
    steps = np.diff(rates.time)[:, None]
    first, second = rates.value[:-1], rates.value[1:]
    slower = np.sign(first) * np.minimum(np.abs(first), np.abs(second))
    slower[(first * second <= 0) | (steps > limits.longest_silence)] = 0.0
    travelled = np.zeros_like(rates.value)
    np.cumsum(slower * steps, axis=0, out=travelled[1:])
    return np.stack([np.interp(time, rates.time, column) for column in travelled.T], axis=1)
