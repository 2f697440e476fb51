"""The checks of a log before the target is identified from it, whatever the log's length."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.identification.planar import placed
from cpid_drake.identification.requirements import (
    JointOrder,
    left_out_warning,
    limit_warnings,
    other_joints,
)
from cpid_drake.sensing.files.consistency import check_consistency
from cpid_drake.sensing.files.motion_checks import MotionFindings, check_motion
from cpid_drake.sensing.measurement_stream import (
    MeasurementStream,
    Stream,
    in_one_chunk,
    joined,
    stream_of,
    time_interval,
)
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.screening import Screened, screen
from cpid_drake.sensing.sensors import SENSORS, STANDARD_SENSORS
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

LONGEST_HEAD = 20_000
"""Number of samples of one sensor that are kept in memory of a stream.

A shorter log is kept as a whole. The number suffices to estimate the noise of the sensors, and to
find wrong units and conventions. Of a longer log, the part is kept in which the arm moves most.
"""


LONGEST_STEP = 3600.0
"""Usual step of the fastest sensor above which the stamps are not in seconds [s]."""

SLOWER = 100.0
"""The same for a sensor whose rate is declared, in declared steps."""


@dataclass(frozen=True, eq=False)
class CheckedLog:
    """Screened samples, joints in the spacecraft's order.

    Attributes:
        head: all samples if the log is not long, else the part in which the arm moves most.
        stream: all samples.
        is_long: whether the stream has more samples than the head.
        counts: number of samples by sensor.
        rejected: number of unusable samples by sensor, which are left out.
        warnings: joints that the spacecraft does not have, weak contradictions in the log,
            and positions beyond the joints' limits.
        normal_B: (3,) normal in B of a table that carries the spacecraft; None without one.
        failures: failed checks: contradictions between positions, rates, and the conservation of
            momentum, and reasons why no table can have carried the spacecraft.
        unchecked: what could not be checked, each with the reason.
        first_burn: time at which thrusters first fire by the log of thrust [s]; infinite if never.
        states: the caller's exact states, which were not sampled by sensors; else None.

    """

    head: Measurements
    stream: MeasurementStream
    is_long: bool = False
    counts: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    normal_B: NDArray[np.float64] | None = None
    failures: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()
    first_burn: float = np.inf
    states: Telemetry | None = None

    @property
    def has_thrust(self) -> bool:
        """Whether thrusters fire, by the log of thrust."""
        return bool(np.isfinite(self.first_burn))

    @cached_property
    def measurements(self) -> Measurements:
        """All samples in memory, for estimators that need them at once."""
        return joined(self.stream) if self.is_long else self.head


def log_of_states(telemetry: Telemetry) -> CheckedLog:
    """Return exact states as the samples of ideal sensors, all at the same times."""
    samples = {
        name: Samples(telemetry.time, SENSORS[name].quantity.ideal(telemetry))
        for name in STANDARD_SENSORS
    }
    measurements = Measurements(telemetry.joint_names, samples)
    counts = {name: len(telemetry) for name in samples}
    return CheckedLog(measurements, stream_of(measurements), counts=counts, states=telemetry)


def check_log(
    spacecraft: Spacecraft,
    data: Measurements | MeasurementStream,
    sensors: SensorSuite | None = None,
    planar: bool | None = None,
) -> CheckedLog:
    """Screen and check a log; read a stream once.

    Measurements, and streams with at most `LONGEST_HEAD` samples of every sensor, are kept in
    memory.

    Args:
        spacecraft: the known spacecraft.
        data: the log; its joints may be in any order.
        sensors: the sensors' errors, by which spikes and stuck sensors are found; None if they are
            not known.
        planar: whether a table carries the spacecraft; see `planar.placed`.

    Raises:
        InputError: the log lacks a joint of the spacecraft, or its times cannot be in s.

    """
    in_memory = isinstance(data, Measurements)
    chunks = in_one_chunk(data) if isinstance(data, Measurements) else data
    recent, most = deque[Measurements](), -np.inf
    head: tuple[Measurements, ...] = ()
    counts, rejected = Counter[str](), Counter[str]()
    is_long, first_burn = False, np.inf
    lowest: NDArray[np.float64] = np.full(len(spacecraft.joint_names), np.inf)
    highest = -lowest
    for screened in _screened(spacecraft, chunks, sensors):
        chunk = screened.measurements
        recent.append(chunk)
        while not in_memory and _largest_count(list(recent)[1:]) > LONGEST_HEAD:
            recent.popleft()
        moved = _motion(spacecraft, recent)
        if moved > most or not is_long:
            head, most = tuple(recent), moved
        counts.update({name: len(samples) for name, samples in chunk.items()})
        rejected.update(screened.rejected)
        fires = chunk.thrust.value.any(axis=1)
        first_burn = min(first_burn, chunk.thrust.time[fires].min(initial=np.inf))
        is_long = not in_memory and max(counts.values()) > LONGEST_HEAD
        positions = chunk.encoders.value
        lowest = np.fmin(lowest, positions.min(axis=0, initial=np.inf))
        highest = np.fmax(highest, positions.max(axis=0, initial=-np.inf))
    beginning = joined(head) if head else Measurements(spacecraft.joint_names)
    joints = [body for body in spacecraft.tree.bodies if body.joint >= 0]
    sliding = [spacecraft.joint_names[body.joint] for body in joints if body.prismatic]
    consistency = check_consistency(beginning, sliding)
    spacecraft, notes, failures = placed(spacecraft, beginning, planar)
    tree = spacecraft.tree
    motion = MotionFindings(unchecked=["unit and point of the position, signs of joints (table)"])
    if tree.normal_B is None or tree.normal_C is not None:  # else its centre of mass may rise
        motion = check_motion(tree, spacecraft.joint_names, beginning)
    beyond, degrees = limit_warnings(spacecraft, lowest, highest)
    agrees = not (motion.errors or motion.warnings or motion.unchecked)
    unchecked = list(motion.unchecked)
    interval = time_interval(beginning)
    if is_long and interval is not None:
        unchecked.append(
            "units and conventions before {:.4g} s and after {:.4g} s (the log is long; the arm "
            "moves most between them)".format(*interval)
        )
    others = other_joints(data.joint_names, spacecraft)
    warnings = (
        *([left_out_warning(others)] if others else ()),
        *notes,
        *consistency.warnings,
        *motion.warnings,
        *beyond,
        *(degrees if agrees else ()),
    )
    failures = (
        *consistency.errors,
        *motion.errors,
        *(() if agrees else degrees),
        *failures,
    )
    stream: MeasurementStream = stream_of(beginning)
    if is_long:
        stream = Stream(
            spacecraft.joint_names,
            lambda: (s.measurements for s in _screened(spacecraft, chunks, sensors)),
        )
    return CheckedLog(
        beginning,
        stream,
        is_long,
        counts,
        rejected,
        warnings,
        tree.normal_B,
        failures,
        tuple(unchecked),
        float(first_burn),
    )


def _largest_count(pieces: Sequence[Measurements]) -> int:
    """Return the largest number of samples of one sensor in several pieces."""
    counts = Counter[str]()
    for piece in pieces:
        counts.update({name: len(samples) for name, samples in piece.items()})
    return max(counts.values(), default=0)


def _motion(spacecraft: Spacecraft, pieces: Iterable[Measurements]) -> float:
    """Return the variance of the positions of all joints but rotors, summed."""
    angles = np.concatenate([piece.encoders.value for piece in pieces])
    joints = [k for k in range(angles.shape[1]) if not spacecraft.tree.is_rotor(k)]
    return float(angles[:, joints].var(axis=0).sum()) if len(angles) else 0.0


def _screened(
    spacecraft: Spacecraft, chunks: MeasurementStream, sensors: SensorSuite | None
) -> Iterator[Screened]:
    """Yield the screened samples of every chunk."""
    order, memory = JointOrder(spacecraft), None
    for chunk in chunks:
        if memory is None:
            _refuse_slow(chunk, sensors)
        screened = screen(order(chunk), sensors, memory)
        memory = screened.memory
        yield screened


def _refuse_slow(measurements: Measurements, sensors: SensorSuite | None) -> None:
    """Refuse samples whose stamps are so far apart that they cannot be in seconds.

    Raises:
        InputError: the usual step of the fastest sensor is longer than `LONGEST_STEP`, or than
            `SLOWER` steps of the declared rate.

    """
    steps = {
        name: float(np.median(np.diff(samples.time)))
        for name, samples in measurements.items()
        if len(samples) > 1
    }
    name = min(steps, key=lambda each: steps[each], default="")
    declared = {} if sensors is None else sensors.present()
    longest = SLOWER / declared[name].rate if name in declared else LONGEST_STEP
    if name and steps[name] > longest:
        raise InputError(
            f"the samples of {SENSORS[name].label} are {steps[name]:.3g} s apart if the time is in "
            "seconds: it must be in s (time.unit of a map of columns)"
        )
