"""What the estimators require of the joints of a log, and of their positions."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.screening import as_arrays, screen
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.spacecraft.spacecraft import Spacecraft


def other_joints(names: Iterable[str], spacecraft: Spacecraft) -> list[str]:
    """Return the names of joints that the spacecraft does not have."""
    return [name for name in names if name not in spacecraft.joint_names]


def left_out_warning(joints: Iterable[str]) -> str:
    """Return the warning about joints of a log that the spacecraft does not have."""
    return f"left out joints that the spacecraft does not have: {', '.join(joints)}"


class JointOrder:
    """Puts the joints of measurements into the spacecraft's order, and leaves out other joints.

    The angle of a rotor (a balanced wheel) has no effect, so its positions may be missing (all
    NaN): the integral of its rates, from zero, replaces them. The integrals continue from one chunk
    of a log to the next.

    Args:
        spacecraft: the known spacecraft.

    """

    def __init__(self, spacecraft: Spacecraft) -> None:
        self._spacecraft = spacecraft
        self._rotors: dict[int, tuple[float, float, float]] = {}  # time, rate and angle at the end

    def __call__(self, measurements: Measurements) -> Measurements:
        """Return the next chunk with its joints in the spacecraft's order.

        Raises:
            InputError: a joint of the spacecraft is missing; the positions of a joint that is not a
                rotor are missing; both the positions and the rates of a rotor are missing; shapes
                do not match.

        """
        have, wanted = measurements.joint_names, self._spacecraft.joint_names
        missing = [name for name in wanted if name not in have]
        if missing:
            raise InputError(
                f"there is no column 'q:{missing[0]}'; the spacecraft's joints are "
                f"{', '.join(wanted)}, the log's are {', '.join(map(repr, have))}; if the log "
                "has other names for its columns, give --columns (`cpid telemetry map` writes such "
                "a file)"
            )
        measurements = as_arrays(measurements)
        order = [have.index(name) for name in wanted]
        of_joints = {
            name: Samples(samples.time, samples.value[:, order])
            for name, samples in measurements.items()
            if name in measurements.samples and SENSORS[name].quantity.width is None
        }
        measurements = Measurements(wanted, {**measurements.samples, **of_joints})
        positions = measurements.encoders
        if not wanted:  # no joints: known at all times
            times = measurements.attitude.time
            positions = Samples(times, np.empty((len(times), 0)))
        value = positions.value
        missing_angles = np.flatnonzero(np.isnan(value).all(axis=0) & (len(value) > 0))
        if missing_angles.size:
            value = value.copy()
        for k in missing_angles.tolist():
            value[:, k] = self._angle(k, measurements)
        return measurements.updated({"encoders": Samples(positions.time, value)})

    def _angle(self, k: int, measurements: Measurements) -> NDArray[np.float64]:
        """Return a rotor's angle at the times of the encoders, the integral of its rates."""
        name = self._spacecraft.joint_names[k]
        if not self._spacecraft.tree.is_rotor(k):
            raise InputError(
                f"there is no column 'q:{name}'; positions are optional for rotors only: "
                "wheels that are balanced about their axis and carry nothing"
            )
        all_rates = measurements.joint_rates
        of_rotor = Samples(all_rates.time, all_rates.value[:, [k]])
        rates = screen(Measurements((name,), joint_rates=of_rotor)).measurements.joint_rates
        time, rate, before = rates.time, rates.value[:, 0], 0.0
        if k in self._rotors:
            latest, latest_rate, before = self._rotors[k]
            time, rate = np.append(latest, time), np.append(latest_rate, rate)
        if not len(time):
            raise InputError(
                f"there is neither a column 'q:{name}' nor rates 'qd:{name}' to integrate"
            )
        turned = before + cumulative_trapezoid(rate, time, initial=0.0)
        self._rotors[k] = float(time[-1]), float(rate[-1]), float(turned[-1])
        wanted = measurements.encoders.time
        later = np.maximum(wanted - time[-1], 0.0)  # at a constant rate after the last sample
        return np.interp(wanted, time, turned) + later * rate[-1]


def in_joint_order(measurements: Measurements, spacecraft: Spacecraft) -> Measurements:
    """Return measurements with their joints in the spacecraft's order; see `JointOrder`.

    Raises:
        InputError: for the same reasons as `JointOrder`.

    """
    return JointOrder(spacecraft)(measurements)


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
