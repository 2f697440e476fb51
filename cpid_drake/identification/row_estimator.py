"""Least squares on the momentum rows of complete or smoothed samples, as an estimator."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rows import RELATIVE_ROWS, STANDARD_ROWS, RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.least_squares import (
    LeastSquaresSolution,
    among_ten,
    solution_of_information,
)
from cpid_drake.estimation.likelihood.priors import psi_scale
from cpid_drake.estimation.momentum_rows import (
    RowSums,
    SmoothedRows,
    momentum_rows,
    row_blocks,
)
from cpid_drake.estimation.regressor_noise import (
    DRAWS,
    above_noise,
    changes,
    expected_residuals,
    sample_sigmas,
)
from cpid_drake.estimation.square_root import solve_information
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.problem import Estimator, Problem
from cpid_drake.identification.result import Identification, MomentumEstimate, ResidualSeries
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.smoothing import smooth_windows
from cpid_drake.sensing.thinning import EvenSelection

USUAL_RMS = 1.5
"""Largest usual size of the residuals of smoothed rows, in units of their propagated errors.

The errors of smoothed samples are correlated, so the size varies: from 0.8 to 1.3 in clean logs.
"""

LARGEST_RATIO = 3.0
"""Largest usual ratio of the residuals of complete samples to the noise seen in these samples."""

SMALLEST_MISFIT = 1e-4
"""Residuals below this share of the momentum are not a misfit."""

SMALLEST_SMOOTHED = 1e-3
"""The same for smoothed samples, whose splines have errors of their own."""

DIFFERENT = 1e-3
"""Probability of equal targets in two halves of the samples below which the answer is doubted."""

DISAGREE = (
    "two halves of the samples have different targets: the spacecraft, a frame, a sign or a clock "
    "is not as assumed, or forces acted"
)
"""The doubt about these targets."""

_MOST_RESIDUALS = 20_000  # residuals that are tested for whiteness; of more, a selection is kept
_MOST_SHOWN = 4_000
_MOST_CHANGED = 400  # samples that are changed at random to see the noise of their rows
_FEW_ROWS = 20  # fewer residuals do not determine their correlation
_SMALLEST_MOMENTUM = 1e-5  # share of the rows' size; below it the cause is integration error
_SIGNIFICANCE = 50.0  # ratio of variances above which a momentum is certain


def estimate_by_rows(problem: Problem) -> Identification:
    """Solve the problem's row family by least squares.

    Complete samples are used as they are, with equal weights. If sensors are given, or samples of
    different sensors have different times, the samples are smoothed and weighted.

    Raises:
        InputError: there are too few samples, or the attitude or position for smoothing is missing.

    """
    family = problem.family
    assert family is not None
    if problem.sensors is None:
        if problem.states is not None:
            return _of_complete(problem, family, [problem.states])
        if complete_samples(problem.log.head, family) is not None:
            chunks = (complete_samples(chunk, family) for chunk in problem.stream)
            return _of_complete(problem, family, (each for each in chunks if each is not None))
    return _of_smoothed(problem, family)


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


def best_rows(counts: Mapping[str, int]) -> str:
    """Return "standard", or "relative" without samples of position and velocity."""
    placed = counts.get("position") or counts.get("velocity")
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


def _of_complete(problem: Problem, family: RowFamily, parts: Iterable[Telemetry]) -> Identification:
    tree, momentum = problem.spacecraft.tree, problem.momentum
    kept, unknown = _KeptRows(tree), TotalMomentum.unknown()
    # One triangle of rows with columns of a momentum gives the solutions for zero momentum and for
    # unknown momentum. Rows that have no such columns are tested by standard rows.
    tester = family if family.momentum_size else STANDARD_ROWS
    tested, sums = RowSums.of(tree, tester, unknown), RowSums.of(tree, family, momentum)
    is_tested = momentum.is_zero and (tester is family or _has_all(problem.log.head))
    is_same = is_tested and tester is family
    for part in parts:
        for time, rows in row_blocks(tree, part, family, unknown if is_same else momentum):
            (tested if is_same else sums).add(rows)
            kept.add(Samples(time, rows[:, :, tested.extra :] if is_same else rows))
        if is_tested and not is_same:
            for _, rows in row_blocks(tree, part, tester, unknown):
                tested.add(rows)
    if is_same:
        sums = _at_zero(tested)
    noise = _noise_of(problem, family, sums.count)
    solution = above_noise(sums.solution(), sums.root, noise)
    found = _identification(problem, family, solution, sums, kept, ())
    if is_tested:
        found = replace(found, contradicts_zero=_is_moving(tested))
    if is_tested or momentum.is_unknown:
        expected = expected_residuals(solution, sums.root, noise)
        found = replace(found, misfit=_misfit(solution, expected, sums.root))
    if not found.residuals or solution.row_count <= _FEW_ROWS:
        return replace(found, residuals={})
    white = whiteness(np.hstack([series.neighbours for series in found.residuals.values()]))
    # The mean of errors that are correlated from sample to sample decreases more slowly.
    wider = white.correlation_time * found.solution.covariance
    return replace(found, solution=replace(found.solution, covariance=wider), whiteness=white)


def _of_smoothed(problem: Problem, family: RowFamily) -> Identification:
    problem, sensors, warnings = problem.with_sensors()
    smoothed = SmoothedRows(problem.spacecraft.tree, family, problem.momentum)
    kept = _KeptRows(problem.spacecraft.tree)
    windows = smooth_windows(
        problem.stream,
        sensors,
        with_position=family.uses_base_position,
        normal_B=problem.spacecraft.tree.normal_B,
    )
    for motion in windows:
        kept.add(Samples(motion.telemetry.time, smoothed.add(motion)))
    solution, misfit = _plausible(problem, family, smoothed.solution()), 1.0
    if solution.residual_rms > USUAL_RMS:
        misfit = float(solution.residual_rms)
        solution = replace(solution, covariance=misfit**2 * solution.covariance)
    found = _identification(problem, family, solution, smoothed.sums, kept, warnings)
    if smoothed.agreement().weakened(misfit).probability < DIFFERENT:
        found = replace(found, doubts=(DISAGREE,))
    rest = max((float(np.abs(each.value).max()) for each in found.residuals.values()), default=1.0)
    # The splines of an exact log leave errors that are larger than its noise, but small.
    is_small = solution.is_observable and rest < SMALLEST_SMOOTHED * kept.largest
    return found if is_small else replace(found, misfit=misfit)


def _plausible(
    problem: Problem, family: RowFamily, solution: LeastSquaresSolution
) -> LeastSquaresSolution:
    """Return a solution without the combinations whose σ is as large as a plausible target."""
    sizes = plausible_sizes(problem.spacecraft.tree)
    if family.name not in sizes or not solution.is_observable:
        return solution
    scale = sizes[family.name][problem.spacecraft.tree.unknowns]
    covariance = solution.covariance / scale / scale[:, None]
    information = np.linalg.pinv(covariance, rcond=1e-14, hermitian=True) / scale / scale[:, None]
    rms, count = solution.residual_rms, solution.row_count
    total = rms**2 * count
    found = solution_of_information(
        solution.estimate, information, scale, residual_sum=total, row_count=count
    )
    return solution if found.is_observable else found


def plausible_sizes(tree: KinematicTree) -> dict[str, NDArray[np.float64]]:
    """Return plausible sizes (10,) of a target's unknowns by row family; see `psi_scale`."""
    still = np.zeros((1, sum(body.joint >= 0 for body in tree.bodies)))
    known = relative_dynamics(tree, still, still)
    psi = psi_scale(known.mass, known.I_K[0])
    return {RELATIVE_ROWS.name: psi, STANDARD_ROWS.name: 2 * psi}


class _KeptRows:
    """The first rows of a log, and an even selection of all rows, for their residuals."""

    def __init__(self, tree: KinematicTree) -> None:
        self._angular = 3 if tree.normal_B is None else 1  # angular rows of a sample
        self._selection = EvenSelection(_MOST_SHOWN)
        self._first: list[Samples] = []
        self.count = 0

    def add(self, rows: Samples) -> None:
        """Add the next times (n,) and rows [N | A | b] (n, rows per sample, k + 11)."""
        first = rows.where(slice(0, max(_MOST_RESIDUALS - self.count, 0)))
        if len(first):
            self._first.append(first)
        self._selection.add(rows)
        self.count += len(rows)

    @property
    def largest(self) -> float:
        """Largest right-hand side of the first rows."""
        return max(float(np.abs(part.value[:, :, -1]).max()) for part in self._first)

    def residuals(self, solution: NDArray[np.float64], unit: str) -> dict[str, ResidualSeries]:
        """Return b − [N | A] x of linear and angular rows at a solution x (k + u,)."""
        selection = self._selection.samples()
        if selection is None:
            return {}

        def parts(rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
            rest = rows[:, :, -1] - rows[:, :, :-1] @ solution
            # The angular rows are the last ones of a sample.
            return {"linear": rest[:, : -self._angular], "angular": rest[:, -self._angular :]}

        units = {"linear": unit, "angular": "N·m·s"}
        time = np.concatenate([part.time for part in self._first])
        first = parts(np.concatenate([part.value for part in self._first]))
        series = {name: ResidualSeries(time, first[name], units[name]) for name in first}
        if self.count > _MOST_RESIDUALS:
            every = self._selection.every
            series = {
                name: ResidualSeries(selection.time, value, units[name], every, first[name])
                for name, value in parts(selection.value).items()
            }
        return {name: each for name, each in series.items() if each.value.size}


def _identification(
    problem: Problem,
    family: RowFamily,
    solution: LeastSquaresSolution,
    sums: RowSums,
    kept: _KeptRows,
    warnings: tuple[str, ...],
) -> Identification:
    """Return the identification of a solution, with residuals if all ten unknowns are known."""
    residuals = {}
    if solution.is_observable:
        residuals = kept.residuals(sums.with_momentum(solution.estimate), family.linear_unit)
    return Identification(
        family.parameterization(problem.spacecraft.mass),
        among_ten(solution, problem.spacecraft.tree.unknowns),
        kept.count,
        LEAST_SQUARES.name,
        rows=family.name,
        sensors=problem.sensors,
        residuals=residuals,
        warnings=warnings,
        momentum=problem.momentum.name,
        momentum_estimate=_momentum_of(sums, solution),
    )


def _momentum_of(sums: RowSums, solution: LeastSquaresSolution) -> MomentumEstimate | None:
    """Return the estimate of an unknown momentum of smoothed, weighted rows."""
    k = sums.extra
    if not (k and solution.is_observable):
        return None
    everything = solve_information(sums.root, sums.count)
    if not everything.is_observable:
        return None
    # The weights are those of independent samples; the covariance of the target tells how much
    # larger the errors of correlated samples are.
    own = everything.covariance[k:, k:]
    larger = max(float(np.max(np.diag(solution.covariance) / np.diag(own))), 1.0)
    return MomentumEstimate(everything.estimate[:k], larger * everything.covariance[:k, :k])


def _noise_of(problem: Problem, family: RowFamily, count: int) -> NDArray[np.float64]:
    """Return the expectation of δᵀ δ (k + u + 1, k + u + 1) for the errors δ of all rows."""
    tree, momentum = problem.spacecraft.tree, problem.momentum
    size = len(RowSums.of(tree, family, momentum).root)
    states, head = problem.states, problem.log.head
    telemetry = complete_samples(head, family) if states is None else states
    if telemetry is None or not count:
        return np.zeros((size, size))
    telemetry = telemetry.select(np.arange(0, len(telemetry), -(-len(telemetry) // _MOST_CHANGED)))
    sigmas = sample_sigmas(head, is_motion=states is None)
    covariance = np.broadcast_to(np.diag(sigmas**2), (len(telemetry), *2 * sigmas.shape))
    rows = momentum_rows(tree, telemetry, family, momentum)
    total = np.zeros((size, size))
    for each in changes(telemetry, covariance):
        errors = momentum_rows(tree, each, family, momentum) - rows
        total += errors.T @ errors
    return total * count / (DRAWS * len(rows))


def _misfit(solution: LeastSquaresSolution, expected: float, root: NDArray[np.float64]) -> float:
    """Return the size of the residuals relative to what noise causes; 1 if noise explains them.

    Small residuals are explained by the integration error of a simulation.
    """
    total = float(solution.residual_rms**2 * solution.row_count)
    least = SMALLEST_MISFIT**2 * float(root[:, -1] @ root[:, -1])
    if not total > max(LARGEST_RATIO**2 * expected, least):
        return 1.0
    return float(np.sqrt(total / max(expected, least)))


def _has_all(measurements: Measurements) -> bool:
    """Return whether the base's attitude, position and velocity were sampled."""
    return bool(len(measurements.attitude) and len(measurements.position))


def _at_zero(sums: RowSums) -> RowSums:
    """Return the sums without the columns of the momentum."""
    zero = RowSums(0, sums.size)
    zero.root, zero.count = sums.root[:, sums.extra :], sums.count
    return zero


def _is_moving(tested: RowSums) -> bool:
    """Return whether rows fit much better with a momentum that is not zero."""
    size = float(tested.root[:, -1] @ tested.root[:, -1])
    count = tested.count
    if not (size > 0 and count > 40):
        return False
    cost_of_zero, cost = (
        count * sums.solution().residual_rms ** 2 for sums in (_at_zero(tested), tested)
    )
    gained = (cost_of_zero - cost) / tested.extra
    noise = max(cost / (count - tested.size - tested.extra), 1e-30 * size)
    return bool(gained > _SIGNIFICANCE * noise and cost_of_zero > _SMALLEST_MOMENTUM**2 * size)


LEAST_SQUARES = Estimator(
    name="least_squares",
    label="least squares on momentum rows",
    good_for="exact logs of any length, and a quick look; several times less accurate with noise",
    estimate=lambda problems, momentum, prior, progress: estimate_by_rows(
        next(iter(problems.values()))
    ),
    needs=needs_of_rows,
    default_rows=best_rows,
    reports=24,
)
