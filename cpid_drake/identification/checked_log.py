"""The checks of a log before the target is identified from it, whatever the log's length."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.identification.planar import placed
from cpid_drake.identification.requirements import (
    in_joint_order,
    left_out_warning,
    limit_warnings,
    other_joints,
)
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.logs.score import Comparison
from cpid_drake.logs.screening import screen
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

LONGEST_STEP = 3600.0
"""Usual step of the fastest sensor above which the stamps are not in seconds [s]."""

SLOWER = 100.0
"""The same for a sensor whose rate is declared, in declared steps."""


@dataclass(frozen=True, eq=False)
class CheckedLog:
    """Screened samples, joints in the spacecraft's order.

    Attributes:
        measurements: the samples.
        counts: number of samples by sensor.
        rejected: number of unusable samples by sensor, which are left out.
        warnings: joints that the spacecraft does not have, positions beyond the joints' limits, and
            positions that may be those of another point.
        comparisons: of positions with rates, and of the motion with the momentum.
        normal_B: (3,) normal in B of a table that carries the spacecraft; None without one.
        failures: failed checks: contradictions between positions, rates, and the conservation of
            momentum, and reasons why no table can have carried the spacecraft.
        unchecked: what could not be checked, each with the reason.
        first_burn: time at which thrusters first fire by the log of thrust [s]; infinite if never.
        states: the caller's exact states, which were not sampled by sensors; else None.

    """

    measurements: Measurements
    counts: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    normal_B: NDArray[np.float64] | None = None
    failures: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()
    first_burn: float = np.inf
    states: Telemetry | None = None
    comparisons: tuple[Comparison, ...] = ()

    @property
    def has_thrust(self) -> bool:
        """Whether thrusters fire, by the log of thrust."""
        return bool(np.isfinite(self.first_burn))


def log_of_states(telemetry: Telemetry) -> CheckedLog:
    """Return exact states as the samples of ideal sensors, all at the same times."""
    samples = {
        name: Samples(telemetry.time, SENSORS[name].quantity.ideal(telemetry)) for name in SENSORS
    }
    measurements = Measurements(telemetry.joint_names, samples)
    counts = {name: len(telemetry) for name in samples}
    return CheckedLog(measurements, counts=counts, states=telemetry)


def check_log(
    spacecraft: Spacecraft,
    data: Measurements,
    sensors: SensorSuite | None = None,
    planar: bool | None = None,
) -> CheckedLog:
    """Screen and check a log.

    Args:
        spacecraft: the known spacecraft.
        data: the log; its joints may be in any order.
        sensors: the sensors' errors, by which spikes and stuck sensors are found; None if they are
            not known.
        planar: whether a table carries the spacecraft; see `planar.placed`.

    Raises:
        InputError: the log lacks a joint of the spacecraft, or its times cannot be in s.

    """
    _refuse_slow(data, sensors)
    screened = screen(in_joint_order(data, spacecraft), sensors)
    measurements = screened.measurements
    counts = {name: len(samples) for name, samples in measurements.items()}
    fires = measurements.thrust.value.any(axis=1)
    first_burn = float(measurements.thrust.time[fires].min(initial=np.inf))
    positions = measurements.encoders.value
    lowest = positions.min(axis=0, initial=np.inf)
    highest = positions.max(axis=0, initial=-np.inf)
    spacecraft, notes, failures = placed(spacecraft, measurements, planar)
    tree = spacecraft.tree
    found = check_conventions(measurements, tree)
    beyond, degrees = limit_warnings(spacecraft, lowest, highest)
    agrees = not (found.better or found.unchecked)
    others = other_joints(data.joint_names, spacecraft)
    warnings = (
        *([left_out_warning(others)] if others else ()),
        *notes,
        *found.warnings,
        *beyond,
        *(degrees if agrees else ()),
    )
    failures = (*found.failures, *(() if agrees else degrees), *failures)
    return CheckedLog(
        measurements,
        counts,
        screened.rejected,
        warnings,
        tree.normal_B,
        failures,
        found.unchecked,
        first_burn,
        comparisons=found.comparisons,
    )


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
