"""What the estimators require of the joints of a log, and of their positions."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from cpid_drake.errors import InputError
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.logs.screening import as_arrays, screen
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.spacecraft.spacecraft import Spacecraft


def other_joints(names: Iterable[str], spacecraft: Spacecraft) -> list[str]:
    """Return the names of joints that the spacecraft does not have."""
    return [name for name in names if name not in spacecraft.joint_names]


def left_out_warning(joints: Iterable[str]) -> str:
    """Return the warning about joints of a log that the spacecraft does not have."""
    return f"left out joints that the spacecraft does not have: {', '.join(joints)}"


def in_joint_order(measurements: Measurements, spacecraft: Spacecraft) -> Measurements:
    """Return measurements with their joints in the spacecraft's order, without other joints.

    The angle of a rotor (a balanced wheel) has no effect, so its positions may be missing (all
    NaN): the integral of its rates, from zero, replaces them.

    Raises:
        InputError: a joint of the spacecraft is missing; the positions of a joint that is not a
            rotor are missing; both the positions and the rates of a rotor are missing; shapes do
            not match.

    """
    have, wanted = measurements.joint_names, spacecraft.joint_names
    missing = [name for name in wanted if name not in have]
    if missing:
        raise InputError(
            f"there is no column 'q:{missing[0]}'; the spacecraft's joints are "
            f"{', '.join(wanted)}, the log's are {', '.join(map(repr, have))}; if the log has "
            "other names for its columns, give --columns (`cpid log map` writes such a file)"
        )
    measurements = as_arrays(measurements)
    order = [have.index(name) for name in wanted]
    of_joints = {
        name: Samples(samples.time, samples.value[:, order])
        for name, samples in measurements.items()
        if name in measurements.samples and SENSORS[name].quantity.width is None
    }
    everything = {**measurements.samples, **of_joints}
    measurements = Measurements(wanted, everything, measurements.column_map)
    time, value = measurements.encoders.time, measurements.encoders.value.copy()
    if not wanted:  # no joints: known at all times
        time = measurements.attitude.time
        value = np.empty((len(time), 0))
    for k in np.flatnonzero(np.isnan(value).all(axis=0) & (len(value) > 0)).tolist():
        if not spacecraft.tree.is_rotor(k):
            raise InputError(
                f"there is no column 'q:{wanted[k]}'; positions are optional for rotors only: "
                "wheels that are balanced about their axis and carry nothing"
            )
        value[:, k] = _turned(measurements, k, time)
    return measurements.updated({"encoders": Samples(time, value)})


def _turned(measurements: Measurements, k: int, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotor's angle at some times, the integral of its rates."""
    all_rates, name = measurements.joint_rates, measurements.joint_names[k]
    of_rotor = Samples(all_rates.time, all_rates.value[:, [k]])
    rates = screen(Measurements((name,), joint_rates=of_rotor)).measurements.joint_rates
    if not len(rates):
        raise InputError(f"there is neither a column 'q:{name}' nor rates 'qd:{name}' to integrate")
    time, rate = rates.time, rates.value[:, 0]
    later = np.maximum(times - time[-1], 0.0)  # at a constant rate after the last sample
    angle = np.interp(times, time, cumulative_trapezoid(rate, time, initial=0.0))
    return angle + later * rate[-1]


def limit_warnings(
    spacecraft: Spacecraft, lowest: NDArray[np.float64], highest: NDArray[np.float64]
) -> tuple[list[str], list[str]]:
    """Return warnings about joint positions beyond the joints' limits.

    Args:
        spacecraft: the known spacecraft.
        lowest, highest: (J,) extreme positions; infinite without samples.

    Returns:
        The warnings, and those about turning joints whose positions would be within the limits if
        they were in degrees.

    """
    plain, degrees = [], []
    low, high = spacecraft.limits.lowest, spacecraft.limits.highest
    turning = {body.joint for body in spacecraft.tree.bodies if not body.prismatic}
    sampled = lowest <= highest
    beyond = sampled & ((lowest < low - 0.1) | (highest > high + 0.1))
    for k in np.flatnonzero(beyond).tolist():
        joint, extreme = spacecraft.joint_names[k], max(lowest[k], highest[k], key=abs)
        unit = "rad" if k in turning else "m"
        text = (
            f"q:{joint} goes to {extreme:.4g}, beyond the model's limits {low[k]:.3g} to "
            f"{high[k]:.3g} {unit}"
        )
        if k in turning and abs(extreme) > 4 * np.pi and low[k] <= np.radians(extreme) <= high[k]:
            degrees.append(f"{text}: is it in degrees?")
        else:
            plain.append(text)
    return plain, degrees
