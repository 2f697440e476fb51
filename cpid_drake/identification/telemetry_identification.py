"""From a log of a spacecraft's motion to its target's parameters, with everything a reader asks.

Least squares on the rows of every sample that is complete, where rates were logged and no sensors
are named: the road for exact data and for simulators. Where rates are missing, or the sensors have
their own instants, or their noise is known, samples are smoothed first (`smoothing`). The momentum
filter and the trajectory fit take each sensor's samples as they are. Where the noise is needed and
not known, it is estimated from the log (`noise_estimation`), and that is said.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.square_root import solve_root
from cpid_drake.estimation.whiteness import Whiteness, whiteness
from cpid_drake.identification.identification import Identification, accumulate_rows, row_family
from cpid_drake.identification.sensor_identification import (
    fit_measurements,
    identification_of_filter,
    identification_of_fit,
    identify_smoothed,
    online_estimator,
)
from cpid_drake.sensing.files.consistency import check_consistency
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.sensors import SENSORS, STANDARD_SENSORS
from cpid_drake.sensing.smoothing import smooth
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

ESTIMATORS = ("least_squares", "momentum_filter", "trajectory_fit")
"""Names of the estimators for logs; least squares takes the name of its rows besides."""

MOST_SAMPLES = {"smoothing": 20_000, "trajectory_fit": 6_000}
"""Of one sensor; what is longer is refused: a minute of motion is plenty, and hours take hours."""

_RESIDUALS = 20_000
_MOMENTUM_SEEN = 1e-5  # of the rows' size: less than that is integration error, or calls no alarm
_SIGNIFICANT = 50.0


@dataclass(frozen=True, eq=False)
class LogIdentification:
    """What a log says about the target, and how it was read.

    Attributes:
        identification: the estimate.
        estimator: one of `ESTIMATORS`.
        rows: name of the row family; None for the other estimators.
        suite: the sensors that were assumed; None where all samples weighed alike.
        residuals: how white they are (of the fit: those of the least white sensor); None where the
            estimator has none to look at.
        rejected: number of samples of each sensor that could not be used; no entry for none.
        warnings: sentences for the reader.
        leftovers: what the estimate leaves of the samples, (N, 3) by name. Of the trajectory fit:
            of every sensor, in units of its noise. Of least squares: "linear", "angular" of the
            rows (of 20 000 samples at most), in N·s and N·m·s (linear "eq18" rows: m/s).

    """

    identification: Identification
    estimator: str
    rows: str | None
    suite: SensorSuite | None
    residuals: Whiteness | None
    rejected: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    leftovers: dict[str, Samples] = field(default_factory=dict)


def identify_log(
    spacecraft: Spacecraft,
    measurements: Measurements,
    *,
    estimator: str | None = None,
    rows: str | None = None,
    suite: SensorSuite | None = None,
    unknown_momentum: bool = False,
) -> LogIdentification:
    """Identify the target held by a spacecraft from a log.

    Args:
        spacecraft: the known spacecraft.
        measurements: what was logged, as from `telemetry_files.read_telemetry`; the joints may be
            in any order.
        estimator: one of `ESTIMATORS`; default: the trajectory fit if sensors are given and no
            rows, else least squares.
        rows: row family of least squares; default: "standard", or "relative" for a log without
            position and velocity.
        suite: how good the sensors are; default: all complete samples alike, or noise estimated
            from the log.
        unknown_momentum: whether the total momentum is constant and unknown instead of zero.

    Raises:
        InputError: other joints than the spacecraft's; something that the estimator needs is not
            logged (the message says which estimators would do); positions and rates that
            contradict each other by a factor or a convention; too few or too many samples.

    """
    if estimator is None:
        estimator = "trajectory_fit" if suite is not None and rows is None else "least_squares"
    if estimator not in ESTIMATORS:
        raise InputError(f"no estimator '{estimator}'; choose from {', '.join(ESTIMATORS)}")
    if rows is not None and estimator != "least_squares":
        raise InputError(f"rows are for least_squares; {estimator} has none: leave --rows out")
    measurements = of_spacecraft(measurements, spacecraft)
    measurements, rejected = screen(measurements)
    warnings = check_log(spacecraft, measurements)
    if rows is None and estimator == "least_squares":
        placed = len(measurements.position) or len(measurements.velocity)
        rows = "standard" if placed else "relative"
    _require(measurements, estimator, rows, unknown_momentum)
    unused = [
        SENSORS[name].label
        for name, samples in measurements.samples.items()
        if name not in STANDARD_SENSORS and len(samples)
    ]
    if unused and estimator != "trajectory_fit":
        warnings.append(
            f"{estimator} does not use the samples of {', '.join(unused)}; trajectory_fit does"
        )

    log = _Log(spacecraft, measurements, suite, unknown_momentum, warnings)
    try:
        if estimator == "trajectory_fit":
            identification, residuals, leftovers = _by_fit(log)
        elif estimator == "momentum_filter":
            identification, residuals, leftovers = _by_filter(log, rejected), None, {}
        else:
            identification, residuals, leftovers = _by_rows(log, row_family(rows, unknown_momentum))
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"{estimator} cannot calculate with these samples: they contradict each other, or are "
            "too large or too small; plot them, and compare units"
        ) from error
    return LogIdentification(
        identification,
        estimator,
        rows,
        log.suite,
        residuals,
        {name: count for name, count in rejected.items() if count},
        tuple(log.warnings),
        leftovers,
    )


@dataclass(eq=False)
class _Log:
    """What is identified from, and what there is to say about it."""

    spacecraft: Spacecraft
    measurements: Measurements
    suite: SensorSuite | None
    unknown_momentum: bool
    warnings: list[str]

    def require_suite(self) -> SensorSuite:
        """Return the sensors; if nobody gave them, those that the log shows."""
        if self.suite is None:
            self.suite = estimate_suite(self.measurements)
            self.warnings.append(
                "the sensors' noise was estimated from the log; give the sensors if you know them"
            )
        return self.suite


# -- what a log must be ---------------------------------------------------------------------------


def of_spacecraft(measurements: Measurements, spacecraft: Spacecraft) -> Measurements:
    """Return measurements with their joints in the spacecraft's order.

    Of rotors, whose angle makes no difference, positions may be missing (all NaN): they become the
    integral of the rates, from zero.

    Raises:
        InputError: they are not of the same joints, or positions of other joints are missing.

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
    order = [have.index(name) for name in wanted]
    of_joints = {
        name: Samples(samples.time, samples.value[:, order])
        for name, samples in measurements.samples.items()
        if SENSORS[name].quantity.width is None
    }
    measurements = Measurements(wanted, {**measurements.samples, **of_joints})
    positions, rates = measurements.encoders, measurements.joint_rates
    value = positions.value
    missing_angles = np.flatnonzero(np.isnan(value).all(axis=0) & (len(value) > 0))
    if missing_angles.size:
        value = value.copy()
    for k in missing_angles:
        if not spacecraft.tree.is_rotor(k):
            raise InputError(
                f"there is no column 'q:{wanted[k]}'; only of a rotor, balanced about its axis and "
                "carrying nothing, positions are not needed"
            )
        turned = cumulative_trapezoid(rates.value[:, k], rates.time, initial=0.0)
        value[:, k] = np.interp(positions.time, rates.time, turned)
    encoders = Samples(positions.time, value)
    return measurements.updated({"encoders": encoders})


def check_log(spacecraft: Spacecraft, measurements: Measurements) -> list[str]:
    """Return what is odd about a log.

    Raises:
        InputError: positions and rates contradict each other in a way that has a clear cause, or
            joint positions can only be degrees.

    """
    found = check_consistency(measurements)
    if found.errors:
        raise InputError(found.errors[0])
    warnings = list(found.warnings)
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


def needs(estimator: str, rows: str | None, unknown_momentum: bool) -> list[tuple[str, ...]]:
    """Return what an estimator needs: of each entry, one sensor at least."""
    always = [("encoders",), ("attitude",)]
    if estimator != "least_squares":
        return always
    if rows == "relative":
        # Angular momentum that is zero is zero in any frame: B's own will do.
        return always if unknown_momentum else [("encoders",), ("attitude", "gyro")]
    return [*always, ("position",) if unknown_momentum else ("velocity", "position")]


def _require(
    measurements: Measurements, estimator: str, rows: str | None, unknown_momentum: bool
) -> None:
    def lacking(estimator: str, rows: str | None) -> list[tuple[str, ...]]:
        return [
            choice
            for choice in needs(estimator, rows, unknown_momentum)
            if not any(len(getattr(measurements, name)) for name in choice)
        ]

    missing = lacking(estimator, rows)
    if not missing:
        return
    names = f"{estimator} with {rows} rows" if rows else estimator
    text = " or ".join(SENSORS[name].description for name in missing[0])
    choices = [("least_squares", name) for name in ("standard", "relative", "eq18")]
    choices += [("momentum_filter", None), ("trajectory_fit", None)]
    usable = [
        f"{other} with {family} rows" if family else other
        for other, family in choices
        if not lacking(other, family) and not (family == "eq18" and unknown_momentum)
    ]
    would = f"what would do: {', '.join(usable)}" if usable else "no estimator can do without"
    raise InputError(f"{names} needs {text}, which the log has no samples of; {would}")


# -- least squares --------------------------------------------------------------------------------


_Found = tuple[Identification, Whiteness | None, dict[str, Samples]]


def _by_rows(log: _Log, family: RowFamily) -> _Found:
    telemetry = None if log.suite is not None else complete_samples(log.measurements, family)
    if telemetry is None:
        measurements = _not_too_long(log.measurements, "smoothing")
        suite = log.require_suite()
        motion = smooth(measurements, suite, with_position=family.name != "relative")
        found = identify_smoothed(log.spacecraft.tree, motion, family, log.unknown_momentum)
        left = {}
        if found.is_observable:
            rest = _residuals(log, motion.telemetry, family, found.solution.estimate)
            left = _by_kind(motion.telemetry.time, rest)
        return found, None, left
    tree = log.spacecraft.tree
    # With the momentum's columns in it, one root answers for a known and for an unknown one.
    root, count = accumulate_rows(tree, telemetry, family, family.momentum_size > 0)
    free = solve_root(root, count, eliminated=family.momentum_size)
    solution = free
    if not log.unknown_momentum and family.momentum_size:
        solution = solve_root(root[:, family.momentum_size :], count)
        _look_for_momentum(log, root, solution, free, family)
    parameterization = family.parameterization(log.spacecraft.mass)
    residuals, left = None, {}
    if solution.is_observable and solution.row_count > 20:
        rest = _residuals(log, telemetry, family, solution.estimate)
        residuals, left = whiteness(rest), _by_kind(telemetry.time, rest)
        # Errors that hang together from sample to sample average out more slowly.
        wider = residuals.correlation_time * solution.covariance
        solution = replace(solution, covariance=wider)
    return Identification(parameterization, solution, len(telemetry)), residuals, left


def complete_samples(measurements: Measurements, family: RowFamily) -> Telemetry | None:
    """Return the samples at which everything is there that rows need; None if there are too few.

    Too few are less than half as many as the rarest sensor has. Position, velocity and attitude
    that were not logged are zero: see `needs` for when that makes no difference.
    """
    needed = ["gyro", "encoders", "joint_rates"]
    if len(measurements.attitude):
        needed.append("attitude")
    if family.name != "relative":
        needed += ["velocity", "position"] if len(measurements.position) else ["velocity"]
    samples = {name: getattr(measurements, name) for name in needed}
    rarest = min(samples.values(), key=len)
    common = rarest.time
    for other in samples.values():
        if not np.array_equal(other.time, common):
            common = np.intersect1d(common, other.time)
    if not len(common) or len(common) < len(rarest) / 2:
        return None

    def values(name: str) -> NDArray[np.float64]:
        if name not in samples:
            nothing = [1.0, 0.0, 0.0, 0.0] if name == "attitude" else [0.0, 0.0, 0.0]
            return np.tile(nothing, (len(common), 1))
        time, value = samples[name].time, samples[name].value
        return value if len(time) == len(common) else value[np.searchsorted(time, common)]

    quaternion = values("attitude")
    R_WB = Rotation.from_quat(quaternion, scalar_first=True)
    return Telemetry(
        measurements.joint_names,
        common,
        quaternion_WB=quaternion,
        p_WB=values("position"),
        w_WB=R_WB.apply(values("gyro")),
        v_WB=values("velocity"),
        q=values("encoders"),
        qdot=values("joint_rates"),
    )


def _residuals(
    log: _Log, telemetry: Telemetry, family: RowFamily, estimate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what the estimate leaves of the rows (N, rows) of at most `_RESIDUALS` samples."""
    some = telemetry.select(slice(0, _RESIDUALS))
    samples = momentum_samples(log.spacecraft.tree, some)
    rows = family.full_rows(samples, log.unknown_momentum)
    rest = rows[:, -1] - rows[:, -11:-1] @ estimate
    if log.unknown_momentum:
        columns = rows[:, :-11]
        rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
    return rest.reshape(len(some), -1)


def _by_kind(time: NDArray[np.float64], rest: NDArray[np.float64]) -> dict[str, Samples]:
    """Return residuals (N, 3 or 6) by kind: the angular ones are a sample's last three."""
    kinds = {"linear": rest[:, :-3], "angular": rest[:, -3:]}
    return {name: Samples(time[: len(part)], part) for name, part in kinds.items() if part.size}


def _look_for_momentum(
    log: _Log,
    root: NDArray[np.float64],
    zero: LeastSquaresSolution,
    free: LeastSquaresSolution,
    family: RowFamily,
) -> None:
    """Warn if the rows fit very much better with a momentum that is not zero."""
    size, count = float(root[:, -1] @ root[:, -1]), zero.row_count
    if not (size > 0 and count > 40):
        return
    left_by_zero, left = (count * s.residual_rms**2 for s in (zero, free))
    gained = (left_by_zero - left) / family.momentum_size
    noise = max(left / (count - 10 - family.momentum_size), 1e-30 * size)
    if gained > _SIGNIFICANT * noise and left_by_zero > _MOMENTUM_SEEN**2 * size:
        log.warnings.append(
            "the samples contradict a total momentum of zero, and the estimate is biased by it: "
            "identify with --unknown-momentum"
        )


# -- fit and filter -------------------------------------------------------------------------------


def _by_fit(log: _Log) -> _Found:
    measurements = _not_too_long(log.measurements, "trajectory_fit")
    suite = log.require_suite()
    fit = fit_measurements(
        log.spacecraft.tree, measurements, suite, unknown_momentum=log.unknown_momentum
    )
    if not fit.converged:
        log.warnings.append("the trajectory fit did not converge: its result is not the best one")
    misfit = fit.chi_squared / max(fit.rows, 1)
    if misfit > 1 + 5 * np.sqrt(2 / max(fit.rows, 1)):
        log.warnings.append(
            f"the fit misses the samples by {np.sqrt(misfit):.2g} times the sensors' noise: noise "
            "larger than said, a momentum that is not zero, or a spacecraft other than its model; "
            "the intervals are too narrow by that factor at least"
        )
    own_noise = fit.own_noise()
    by_sensor = [whiteness(rest) for rest in own_noise.values()]
    least_white = max(by_sensor, key=lambda residuals: abs(residuals.lag_one), default=None)
    left = {
        name: Samples(getattr(fit.model.measurements, name).time, rest)
        for name, rest in own_noise.items()
    }
    return identification_of_fit(fit), least_white, left


def _by_filter(log: _Log, rejected: dict[str, int]) -> Identification:
    suite = log.require_suite()
    online = online_estimator(log.spacecraft, suite, unknown_momentum=log.unknown_momentum)
    state = online.run(log.measurements)
    if state.acquiring:
        log.warnings.append(
            "the filter never got to run alone: the target was not known well enough before the "
            "end; this is its last fit"
        )
    changes = int(state.filter.momentum_changes)
    if changes:
        when = float(state.filter.momentum_change_time)
        log.warnings.append(
            f"the momentum changed {changes} times, last seen at {when:.3f} s; it was estimated "
            "anew from there"
        )
    for name in SENSORS:
        k = online.filter.index(name)
        rejected[name] = rejected.get(name, 0) + int(state.filter.rejected[k])
    return identification_of_filter(online, state)


def _not_too_long(measurements: Measurements, what: str) -> Measurements:
    most = MOST_SAMPLES[what]
    for name in SENSORS:
        samples = getattr(measurements, name)
        if len(samples) > most:
            raise InputError(
                f"{len(samples)} samples of {name} are too many for {what.replace('_', ' ')}; "
                f"choose at most {most} by --from and --to (of {samples.time[0]:g} to "
                f"{samples.time[-1]:g} s)"
            )
    return measurements
