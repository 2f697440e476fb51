"""Least squares on the momentum rows of complete or smoothed samples, as an estimator."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.momentum_rows import (
    accumulate_rows,
    momentum_columns,
    row_residuals,
    solve_smoothed_rows,
)
from cpid_drake.estimation.square_root import solve_information
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.problem import Estimator, Problem, refuse_long
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.smoothing import smooth

MOST_SMOOTHED = 20_000
"""Largest number of samples of one sensor that are smoothed; a minute of motion is enough."""

_MOST_RESIDUALS = 20_000
_FEW_ROWS = 20  # fewer residuals do not determine their correlation
_SMALLEST_MOMENTUM = 1e-5  # share of the rows' size; below it the cause is integration error
_SIGNIFICANCE = 50.0  # ratio of variances above which a momentum is certain

MOMENTUM_FOUND = (
    "the samples contradict a total momentum of zero, and the estimate is biased by it: identify "
    "with --momentum unknown"
)
"""The warning if the rows fit much better with a momentum that is not zero."""


def estimate_by_rows(problem: Problem) -> Identification:
    """Solve the problem's row family by least squares.

    Complete samples are used as they are, with equal weights. If sensors are given, or samples of
    different sensors have different times, the samples are smoothed and weighted.

    Raises:
        InputError: there are too few or too many samples, or the attitude or position for smoothing
        is missing.

    """
    assert problem.family is not None
    if problem.sensors is None:
        telemetry = problem.states or complete_samples(problem.measurements, problem.family)
        if telemetry is not None:
            return _of_complete(problem, telemetry)
    return _of_smoothed(problem)


def needs_of_rows(family: RowFamily | None, momentum: TotalMomentum) -> tuple[tuple[str, ...], ...]:
    """Return the sensors that rows need: at least one sensor of each entry."""
    assert family is not None
    if not family.uses_base_position:
        # A zero angular momentum is zero in any frame, so a gyro is enough and no attitude in W is
        # needed.
        attitude = ("attitude",) if not momentum.is_zero else ("attitude", "gyro")
        return (("encoders",), attitude)
    # The position matters only for an unknown linear momentum, because its moment about C depends
    # on it.
    place = ("position",) if momentum.is_unknown else ("velocity", "position")
    return (("encoders",), ("attitude",), place)


def best_rows(measurements: Measurements) -> str:
    """Return "standard", or "relative" for measurements without position and velocity."""
    placed = len(measurements.position) or len(measurements.velocity)
    return "standard" if placed else "relative"


def complete_samples(measurements: Measurements, family: RowFamily) -> Telemetry | None:
    """Return the times at which all quantities of the rows were sampled; None if there are too few.

    The times are too few if they are fewer than half of the times of the slowest sensor. Position,
    velocity and attitude that were not logged are set to zero if `needs_of_rows` does not require
    them.
    """
    needed = ["gyro", "encoders", "joint_rates"]
    if len(measurements.attitude):
        needed.append("attitude")
    if family.uses_base_position:
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


def _of_complete(problem: Problem, telemetry: Telemetry) -> Identification:
    tree, family, momentum = problem.spacecraft.tree, problem.family, problem.momentum
    assert family is not None
    # If the rows contain the columns of a momentum, one triangle gives the solutions for zero
    # momentum and for unknown momentum.
    tested = momentum.is_zero and family.momentum_size > 0
    assumed = TotalMomentum.unknown() if tested else momentum
    extra = momentum_columns(family, assumed)
    root, count = accumulate_rows(tree, telemetry, family, assumed)
    solution, warnings = solve_information(root, count, eliminated=extra), []
    if tested:
        free, solution = solution, solve_information(root[:, extra:], count)
        if _is_moving(root, solution, free, family):
            warnings.append(MOMENTUM_FOUND)
    found = _identification(problem, family, solution, telemetry, tuple(warnings))
    if not found.residuals or solution.row_count <= _FEW_ROWS:
        return replace(found, residuals={})
    white = whiteness(np.hstack([series.value for series in found.residuals.values()]))
    # The mean of errors that are correlated from sample to sample decreases more slowly.
    wider = white.correlation_time * solution.covariance
    return replace(found, solution=replace(solution, covariance=wider), whiteness=white)


def _of_smoothed(problem: Problem) -> Identification:
    refuse_long(problem.measurements, MOST_SMOOTHED, "smoothing")
    problem, sensors, warnings = problem.with_sensors()
    tree, family, momentum = problem.spacecraft.tree, problem.family, problem.momentum
    assert family is not None
    motion = smooth(problem.measurements, sensors, with_position=family.uses_base_position)
    solution = solve_smoothed_rows(tree, motion, family, momentum)
    return _identification(problem, family, solution, motion.telemetry, warnings)


def _identification(
    problem: Problem,
    family: RowFamily,
    solution: LeastSquaresSolution,
    telemetry: Telemetry,
    warnings: tuple[str, ...],
) -> Identification:
    """Return the identification of a solution, with residuals if all ten unknowns are known."""
    residuals = {}
    if solution.is_observable:
        some = telemetry.select(slice(0, _MOST_RESIDUALS))
        tree, momentum = problem.spacecraft.tree, problem.momentum
        rest = row_residuals(tree, some, family, momentum, solution.estimate)
        # The angular rows are the last three of a sample.
        kinds = {"linear": (rest[:, :-3], family.linear_unit), "angular": (rest[:, -3:], "N·m·s")}
        residuals = {
            name: ResidualSeries(some.time, *part) for name, part in kinds.items() if part[0].size
        }
    return Identification(
        family.parameterization(problem.spacecraft.mass),
        solution,
        len(telemetry),
        LEAST_SQUARES.name,
        rows=family.name,
        sensors=problem.sensors,
        residuals=residuals,
        warnings=warnings,
    )


def _is_moving(
    root: NDArray[np.float64],
    zero: LeastSquaresSolution,
    free: LeastSquaresSolution,
    family: RowFamily,
) -> bool:
    """Return whether the rows fit much better with a momentum that is not zero."""
    size, count = float(root[:, -1] @ root[:, -1]), zero.row_count
    if not (size > 0 and count > 40):
        return False
    cost_of_zero, cost = (count * solution.residual_rms**2 for solution in (zero, free))
    gained = (cost_of_zero - cost) / family.momentum_size
    noise = max(cost / (count - 10 - family.momentum_size), 1e-30 * size)
    return bool(gained > _SIGNIFICANCE * noise and cost_of_zero > _SMALLEST_MOMENTUM**2 * size)


LEAST_SQUARES = Estimator(
    name="least_squares",
    label="least squares on momentum rows",
    good_for="exact logs of any length, and a quick look; several times less accurate with noise",
    estimate=estimate_by_rows,
    needs=needs_of_rows,
    default_rows=best_rows,
    reports=24,
)
