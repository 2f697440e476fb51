"""Checks of a log before the target is identified from it."""

import numpy as np
from scipy.integrate import cumulative_trapezoid

from cpid_drake.dynamics.rows import ROW_FAMILIES, RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.problem import Estimator
from cpid_drake.sensing.files.consistency import check_consistency
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.screening import as_arrays, screen
from cpid_drake.sensing.sensors import SENSORS, STANDARD_SENSORS
from cpid_drake.sensing.splines import measured_by
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


def measurements_of_states(telemetry: Telemetry) -> Measurements:
    """Return exact states as the samples of ideal sensors, all at the same times."""
    samples = {
        name: Samples(telemetry.time, SENSORS[name].quantity.ideal(telemetry))
        for name in STANDARD_SENSORS
    }
    return Measurements(telemetry.joint_names, samples)


def in_joint_order(measurements: Measurements, spacecraft: Spacecraft) -> Measurements:
    """Return measurements with their joints in the spacecraft's order.

    The angle of a rotor (a balanced wheel) has no effect, so its positions may be missing (all
    NaN): the integral of its rates, from zero, replaces them.

    Raises:
        InputError: the joints are not those of the spacecraft; the positions of a joint that is not
            a rotor are missing; both the positions and the rates of a rotor are missing; shapes do
            not match.

    """
    have, wanted = measurements.joint_names, spacecraft.joint_names
    missing = [name for name in wanted if name not in have]
    unknown = [name for name in have if name not in wanted]
    if missing or unknown:
        parts = []
        if missing:
            parts.append(f"there is no column 'q:{missing[0]}'")
        if unknown:
            parts.append(f"the spacecraft has no joint '{unknown[0]}'")
        raise InputError(f"{', and '.join(parts)}; its joints are {', '.join(wanted)}")
    measurements = as_arrays(measurements)
    order = [have.index(name) for name in wanted]
    of_joints = {
        name: Samples(samples.time, samples.value[:, order])
        for name, samples in measurements.samples.items()
        if SENSORS[name].quantity.width is None
    }
    measurements = Measurements(wanted, {**measurements.samples, **of_joints})
    positions = measurements.encoders
    value = positions.value
    missing_angles = np.flatnonzero(np.isnan(value).all(axis=0) & (len(value) > 0))
    if missing_angles.size:
        value = value.copy()
    for k in missing_angles.tolist():
        if not spacecraft.tree.is_rotor(k):
            raise InputError(
                f"there is no column 'q:{wanted[k]}'; positions are optional for rotors only: "
                "wheels that are balanced about their axis and carry nothing"
            )
        all_rates = measurements.joint_rates
        of_rotor = Samples(all_rates.time, all_rates.value[:, [k]])
        rates = screen(Measurements((wanted[k],), joint_rates=of_rotor))[0].joint_rates
        if not len(rates):
            raise InputError(
                f"there is neither a column 'q:{wanted[k]}' nor rates 'qd:{wanted[k]}' to integrate"
            )
        turned = cumulative_trapezoid(rates.value[:, 0], rates.time, initial=0.0)
        value[:, k] = np.interp(positions.time, rates.time, turned)
    encoders = Samples(positions.time, value)
    return measurements.updated({"encoders": encoders})


def check_log(spacecraft: Spacecraft, measurements: Measurements) -> list[str]:
    """Return warnings about a log: contradictions, and positions beyond the joints' limits.

    Raises:
        InputError: positions and rates contradict each other in a way that has a clear cause, or
            the joint positions must be in degrees.

    """
    consistency = check_consistency(measurements)
    if consistency.errors:
        raise InputError(consistency.errors[0])
    warnings = list(consistency.warnings)
    value = measurements.encoders.value
    if len(value):
        low, high = spacecraft.position_limits
        lowest, highest = value.min(axis=0), value.max(axis=0)
        beyond = (lowest < low - 0.1) | (highest > high + 0.1)
        for k in np.flatnonzero(beyond):
            joint, extreme = spacecraft.joint_names[k], max(lowest[k], highest[k], key=abs)
            if abs(extreme) > 4 * np.pi and low[k] <= np.radians(extreme) <= high[k]:
                raise InputError(
                    f"q:{joint} goes to {extreme:.4g}, beyond its limits {low[k]:.3g} to "
                    f"{high[k]:.3g} rad: is it in degrees?"
                )
            warnings.append(
                f"q:{joint} goes to {extreme:.4g}, beyond the model's limits {low[k]:.3g} to "
                f"{high[k]:.3g}"
            )
    return warnings


def require_sensors(
    measurements: Measurements,
    sensors: SensorSuite | None,
    estimator: Estimator,
    family: RowFamily | None,
    momentum: TotalMomentum,
) -> None:
    """Refuse measurements that lack what an estimator needs.

    Args:
        measurements: the samples.
        sensors: the sensors' errors, if they are known; samples of other sensors cannot be used.
        estimator: its record.
        family: its row family, if it uses rows.
        momentum: the total momentum.

    Raises:
        InputError: a sensor that the estimator needs has no samples, or is not one of the given
            sensors; the message lists the estimators that could use the measurements.

    """
    usable_samples = measurements if sensors is None else measured_by(sensors, measurements)

    def missing(record: Estimator, rows: RowFamily | None) -> list[tuple[str, ...]]:
        needs = record.needs(rows, momentum)
        return [choice for choice in needs if not any(len(usable_samples[n]) for n in choice)]

    lacking = missing(estimator, family)
    if not lacking:
        return
    usable = []
    for record in ESTIMATORS.values():
        if momentum.name not in record.momenta:
            continue
        rowless = record.default_rows is None
        for rows in [None] if rowless else ROW_FAMILIES.values():
            fits = rows is None or not momentum.is_unknown or rows.momentum_columns is not None
            if fits and not missing(record, rows):
                usable.append(_called(record, rows))
    text = " or ".join(SENSORS[name].description for name in lacking[0])
    is_logged = any(len(measurements[name]) for name in lacking[0])
    reason = "is not one of the given sensors" if is_logged else "the log has no samples of"
    would = (
        f"these estimators can use the log: {', '.join(usable)}"
        if usable
        else "no estimator can do without"
    )
    raise InputError(f"{_called(estimator, family)} needs {text}, which {reason}; {would}")


def _called(record: Estimator, rows: RowFamily | None) -> str:
    return f"{record.name} with {rows.name} rows" if rows else record.name
