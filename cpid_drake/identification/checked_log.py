"""The logs that an estimator is given, screened and checked once."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError, listed, prefix_errors
from cpid_drake.identification.planar import common_normal, normal_in_base, placed
from cpid_drake.logs.channels import Channel, ChannelReview, look_at
from cpid_drake.logs.common_clock import ACCURACY, delay_notes, file_delays, with_delays
from cpid_drake.logs.conventions import Findings, check_conventions
from cpid_drake.logs.log import Log, Samples, with_fixed_joints
from cpid_drake.logs.screening import LONGEST_GAP, as_arrays, screen
from cpid_drake.logs.unlogged_joints import lock_unlogged
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

SLOWER = 100.0
"""Usual step of the fastest sensor above which the stamps are not in seconds, in declared steps; it
is `LONGEST_GAP` without a declared rate."""


@dataclass(frozen=True, eq=False)
class CheckedLog:
    """Screened samples, joints in the spacecraft's order.

    Attributes:
        measurements: the samples.
        rejected: number of unusable samples by sensor, which are left out.
        notes: joints that the spacecraft does not have, what was found in the channels, and
            positions beyond the joints' limits.
        normal_B: (3,) normal in B of a table that carries the spacecraft; None without one.
        not_planar: reasons why no table can have carried the spacecraft, if one was said to.
        conventions: what comparing positions with rates, and the motion with the momentum, says.
        states: the caller's exact states, which were not sampled by sensors; else None.
        channels: what was found in every channel.
        sensors: the sensors' errors; None if they are not given.
        label: its name in messages; empty if it is the only log.
        other_clocks: sensors that are in another file than the encoders.

    """

    measurements: Log
    rejected: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    normal_B: Array | None = None
    not_planar: tuple[str, ...] = ()
    conventions: Findings = field(default_factory=Findings)
    states: Motion | None = None
    channels: tuple[Channel, ...] = ()
    sensors: SensorSuite | None = None
    label: str = ""
    other_clocks: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """The beginning of sentences about it."""
        return f"{self.label}: " if self.label else ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes, and what the conventions leave open, such as the point of the position."""
        return (*self.notes, *self.conventions.warnings)

    @property
    def failures(self) -> tuple[str, ...]:
        """Failed checks: contradictions between positions, rates and momentum, and no table."""
        return (*self.conventions.failures, *self.not_planar)

    @property
    def counts(self) -> dict[str, int]:
        """Number of samples by sensor."""
        return {name: len(samples) for name, samples in self.measurements.items()}

    def between(self, start: float, end: float) -> "CheckedLog":
        """Return the log with the samples of an interval [s] only."""
        return replace(self, measurements=self.measurements.between(start, end))


def log_of_states(telemetry: Motion) -> CheckedLog:
    """Return exact states as the samples of ideal sensors, all at the same times."""
    samples = {n: Samples(telemetry.time, SENSORS[n].ideal(telemetry)) for n in SENSORS}
    return CheckedLog(Log(telemetry.joint_names, samples), states=telemetry)


def check_logs(
    spacecraft: Spacecraft,
    data: Mapping[str, Motion | Log],
    suites: Mapping[str, SensorSuite | None],
    planar: bool | None,
    progress: Callable[[str], object],
) -> tuple[Spacecraft, dict[str, CheckedLog]]:
    """Return the checked logs of `identify`, and the spacecraft: on a table if they are of one.

    Joints that no log has are fixed; see `lock_unlogged`.

    Raises:
        InputError: see `check_log`; some logs are of a table and others not, or of another one.

    """
    logs, fixed = dict[str, CheckedLog](), tuple[str, ...]()
    if not any(isinstance(each, Motion) for each in data.values()):
        logged = {name for each in data.values() for name in each.joint_names}
        spacecraft, fixed = lock_unlogged(spacecraft, logged)
    for name, each in data.items():
        progress(f"checking {name}")
        label = name if len(data) > 1 else ""
        with prefix_errors(label):
            log = check_log(spacecraft, each, suites[name], planar)
        suite, notes = with_clock_errors(suites[name], log.other_clocks), () if logs else fixed
        logs[name] = replace(log, sensors=suite, label=label, notes=(*log.notes, *notes))
    normal_B = common_normal({name: log.normal_B for name, log in logs.items()})
    return (spacecraft if normal_B is None else spacecraft.on_table(normal_B)), logs


def check_log(
    spacecraft: Spacecraft | None,
    data: Motion | Log,
    sensors: SensorSuite | None = None,
    planar: bool | None = None,
) -> CheckedLog:
    """Screen and check a log; exact states need no checks.

    Args:
        spacecraft: the spacecraft model; None to check what a log alone shows.
        data: the log; the joints of measurements may be in any order.
        sensors: the sensors' errors, by which spikes and stuck sensors are found; None if they are
            not known.
        planar: whether a table carries the spacecraft; see `planar.placed`.

    Raises:
        InputError: the log lacks a joint of the spacecraft, or its times cannot be in s.

    """
    if isinstance(data, Motion):
        assert spacecraft is not None
        spacecraft.require_joints(data)
        is_placed = planar and spacecraft.tree.normal_B is None
        normal_B = normal_in_base(data.quaternion_WB) if is_placed else None
        return replace(log_of_states(data), normal_B=normal_B)
    _refuse_slow(data, sensors)
    channels = look_at(data) if spacecraft is None else in_joint_order(data, spacecraft)
    if channels.errors:
        raise InputError("; ".join(channels.errors))
    screened = screen(channels.log, sensors)
    measurements = screened.log
    notes: tuple[str, ...] = ()
    others, failures, beyond, tree = list[str](), notes, notes, None
    if spacecraft is not None:
        spacecraft, notes, failures = placed(spacecraft, measurements, planar)
        others = [name for name in data.joint_names if name not in spacecraft.joint_names]
        beyond = (*_beyond_limits(spacecraft, measurements.encoders.value),)
        tree = spacecraft.tree
    measurements, shifted, other_clocks = in_one_clock(measurements, measurements, tree)
    conventions = check_conventions(measurements, tree, by_momentum=False)
    conventions = replace(
        conventions, not_compared=(*conventions.not_compared, *channels.not_compared)
    )
    return CheckedLog(
        measurements,
        screened.rejected,
        (*left_out_warnings(others), *channels.warnings, *notes, *beyond, *shifted),
        None if tree is None else tree.normal_B,
        failures,
        conventions,
        channels=channels.table,
        other_clocks=other_clocks,
    )


def in_one_clock(
    log: Log, screened: Log, tree: KinematicTree | None
) -> tuple[Log, tuple[str, ...], tuple[str, ...]]:
    """Return a log whose files have one clock, what was changed, and the sensors of other files.

    Args:
        log: the log to change.
        screened, tree: its screened samples and the spacecraft model; see `file_delays`.

    """
    delays = file_delays(screened, tree)
    others = tuple(name for name, file in screened.clocks.items() if file in delays)
    return with_delays(log, delays), delay_notes(screened, delays), others


def with_clock_errors(suite: SensorSuite | None, sensors: Collection[str]) -> SensorSuite | None:
    """Return sensors' errors in which the stamps of some sensors, of other files, are not exact."""
    if suite is None or suite.unstated is None or not sensors:
        return suite  # the same hardware is the same object
    suite = replace(suite)
    for name, each in suite.present().items():
        if name in sensors and name != "joint_rates" and each.delay_ms is None:
            setattr(suite, name, replace(each, delay_ms=1e3 * ACCURACY))
    return suite


def left_out_warnings(joints: Sequence[str]) -> list[str]:
    """Return the warning about joints of a log that the spacecraft does not have, if there are."""
    text = f"left out joints that the spacecraft does not have: {', '.join(joints)}"
    return [text] if joints else []


def in_joint_order(measurements: Log, spacecraft: Spacecraft) -> ChannelReview:
    """Return the channels of a log with its joints in the spacecraft's order, without others.

    The angle of a rotor (a balanced wheel) has no effect, so its positions may be missing (all
    NaN): the integral of its rates, from zero, replaces them.

    Raises:
        InputError: a joint of the spacecraft is missing, or the log's joints are all others; the
            positions of a joint that is not a rotor are missing; both the positions and the rates
            of a rotor are missing; shapes do not match.

    """
    have, wanted = measurements.joint_names, spacecraft.joint_names
    missing = [name for name in wanted if name not in have]
    if missing:
        raise InputError(
            f"there is no column 'q:{missing[0]}'; the spacecraft's joints are "
            f"{', '.join(wanted)}, the log's are {', '.join(map(repr, have))}; if the log has "
            "other names for its columns, give --columns (`cpid log map` writes such a file)"
        )
    if have and not wanted:
        raise InputError(
            f"the spacecraft has no joints, but the log has {listed(have)}: this is another "
            "spacecraft, or a map of columns must say that they are not used: ignore_joints"
        )
    measurements = as_arrays(measurements)
    q = measurements.encoders.value
    travels = {n: float(np.ptp(q[:, k])) for k, n in enumerate(have) if len(q) and n not in wanted}
    measurements = with_fixed_joints(measurements, travels)
    order = [have.index(name) for name in wanted]
    of_joints = {
        name: Samples(samples.time, samples.value[:, order])
        for name, samples in measurements.items()
        if name in measurements.samples and SENSORS[name].width is None
    }
    everything = {**measurements.samples, **of_joints}
    ordered = replace(measurements, joint_names=wanted, samples=everything, motion={})
    channels = look_at(ordered, spacecraft)
    time, value = channels.log.encoders.time, channels.log.encoders.value.copy()
    if not wanted:  # no joints: known at all times
        time = np.unique(np.concatenate([channels.log.attitude.time, channels.log.gyro.time]))
        value = np.empty((len(time), 0))
    for k in np.flatnonzero(np.isnan(value).all(axis=0) & (len(value) > 0)).tolist():
        if not spacecraft.tree.is_rotor(k):
            raise InputError(
                f"there is no column 'q:{wanted[k]}'; positions are optional for rotors only: "
                "wheels that are balanced about their axis and carry nothing"
            )
        value[:, k] = _turned(channels.log, k, time)
    channels.log = channels.log.updated({"encoders": Samples(time, value)})
    return channels


def _turned(measurements: Log, k: int, times: Array) -> Array:
    """Return a rotor's angle at some times, the integral of its rates."""
    all_rates, name = measurements.joint_rates, measurements.joint_names[k]
    of_rotor = Samples(all_rates.time, all_rates.value[:, [k]])
    rates = screen(Log((name,), {"joint_rates": of_rotor})).log.joint_rates
    if not len(rates):
        raise InputError(f"there is neither a column 'q:{name}' nor rates 'qd:{name}' to integrate")
    time, rate = rates.time, rates.value[:, 0]
    later = np.maximum(times - time[-1], 0.0)  # at a constant rate after the last sample
    angle = np.interp(times, time, cumulative_trapezoid(rate, time, initial=0.0))
    return np.asarray(angle + later * rate[-1])


def _beyond_limits(spacecraft: Spacecraft, positions: Array) -> Iterator[str]:
    """Yield warnings about positions (N, J) beyond the joints' limits."""
    lowest, highest = positions.min(axis=0, initial=np.inf), positions.max(axis=0, initial=-np.inf)
    low, high = spacecraft.limits.lowest, spacecraft.limits.highest
    turning = {*range(len(low))} - spacecraft.tree.sliding
    moved = np.isfinite(lowest) & np.isfinite(highest)
    for k in turning:
        if moved[k] and high[k] - low[k] <= 2 * np.pi + 0.1:  # whole turns do not count
            turns = np.round((low[k] + high[k] - lowest[k] - highest[k]) / (4 * np.pi))
            lowest[k], highest[k] = np.array([lowest[k], highest[k]]) + 2 * np.pi * turns
    beyond = (lowest <= highest) & ((lowest < low - 0.1) | (highest > high + 0.1))
    for k in np.flatnonzero(beyond).tolist():
        extreme = max(lowest[k], highest[k], key=abs)
        text = (
            f"q:{spacecraft.joint_names[k]} goes to {extreme:.4g}, beyond the model's limits "
            f"{low[k]:.3g} to {high[k]:.3g} {'rad' if k in turning else 'm'}"
        )
        is_turn = k in turning and abs(extreme) > 4 * np.pi
        in_degrees = is_turn and low[k] <= np.radians(extreme) <= high[k]
        yield f"{text}: is it in degrees?" if in_degrees else text


def _refuse_slow(measurements: Log, sensors: SensorSuite | None) -> None:
    """Refuse samples whose stamps are so far apart that they cannot be in seconds."""
    steps = {
        name: float(np.median(np.diff(samples.time)))
        for name, samples in measurements.items()
        if len(samples) > 1
    }
    name = min(steps, key=lambda each: steps[each], default="")
    declared = {} if sensors is None else sensors.present()
    longest = SLOWER / declared[name].rate if name in declared else LONGEST_GAP
    if name and steps[name] > longest:
        raise InputError(
            f"the samples of {SENSORS[name].quantity} are {steps[name]:.3g} s apart if the time is "
            "in seconds: it must be in s (time.unit of a map of columns)"
        )
