"""Checks of least squares on momentum rows, in batch and online."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution
from cpid_drake.estimation.least_squares import INTEGRATION, improbable
from cpid_drake.estimation.rows_fit import TARGET
from cpid_drake.files.digits import significant
from cpid_drake.identification.checks import BIAS, CONSERVATION, Check
from cpid_drake.identification.chosen_fit import halves_check
from cpid_drake.identification.consistency import with_nearest_body
from cpid_drake.identification.result import Identification

LEAST_SQUARES = "least_squares"
"""The estimator's name."""

_CAUSE = "the spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
_NOT_CONSERVED = (
    "the momentum of spacecraft and target is not conserved: the rows miss it by {}; possible "
    "causes are a discrete plant, a coarse integrator, gravity, thrust, another momentum than "
    "assumed, a wrong spacecraft model, frame or sign, and noise of the states"
)


def conservation_check(share: float, times: float = np.inf, axes: int = 3) -> Check:
    """Return the check that momentum is conserved, as far as integration and samples are exact.

    Args:
        share: residuals of the rows, as a share of the spacecraft's momentum.
        times: residuals of the rows, as a multiple of what the errors of the samples explain;
            infinite if these are not known.
        axes: number of the least errors of a log: those of a gyro's bias, which is in all samples.

    """
    if share <= INTEGRATION or not np.isfinite(times):
        text = _NOT_CONSERVED.format(f"{significant(100 * share)} % of the spacecraft's")
        return Check.of(CONSERVATION, text, share, INTEGRATION)
    text = _NOT_CONSERVED.format(f"{significant(times)} times the errors of the samples")
    # The mean square of so many errors is χ² / axes.
    limit = float(np.sqrt(improbable(axes) / axes))
    return Check.of(CONSERVATION, text, times, limit)


def bias_check(solution: LeastSquaresSolution, bias: Array) -> Check:
    """Return the check that noise inside the rows moves no combination by its σ.

    Args:
        solution: that of the rows.
        bias: (10,) bias of its unknowns.

    """
    # |R δx|, in σ
    size = float(np.linalg.norm(solution.determined.R @ bias))
    text = f"noise inside the momentum rows moves the estimate by about {significant(size)} σ"
    return Check.of(BIAS, f"{text}: identify with --estimator trajectory_fit", size, 1.0)


def part_checks(earlier: Array, rows: Array, freedom: int) -> tuple[Check, ...]:
    """Return the check that earlier samples have the target of all of them, from their triangles.

    Args:
        earlier, rows: (11, 11) triangles [R | z] of the rows of the first and of all samples.
        freedom: number of all rows minus that of the unknowns.

    """
    rests, size = float(rows[-1, -1] ** 2), float(np.sum(rows[:, -1] ** 2))
    if freedom < 1 or rests <= INTEGRATION**2 * size:
        return ()
    # In units of the noise; an unknown is as large as makes its column as large as b.
    # s² = ρ² / freedom
    noise = np.sqrt(rests / freedom)
    first, whole = (Gaussian.of_rows({TARGET: 10}, each / noise) for each in (earlier, rows))
    lengths = np.linalg.norm(rows[:, :-1], axis=0)
    plausible = np.sqrt(size) / np.where(lengths > 0, lengths, np.inf)
    return (halves_check(first, whole, plausible, _CAUSE, freedom),)


def identification_of_rows(
    family: RowFamily,
    momentum: TotalMomentum,
    tree: KinematicTree,
    solution: LeastSquaresSolution,
    sample_count: int,
    *,
    earlier: Array,
    rows: Array,
) -> Identification:
    """Return the identification, with its checks, from rows of states alone.

    Conservation is checked as soon as there are as many residuals as unknowns.

    Args:
        family: the row family.
        momentum: the total momentum that was assumed.
        tree: the spacecraft model.
        solution: that of the rows.
        sample_count: number of samples.
        earlier, rows: (11, 11) triangles [R | z] of the rows of the first and of all samples.

    """
    checks: tuple[Check, ...] = ()
    freedom = solution.row_count - solution.rank
    if solution.rank and freedom >= solution.rank:
        size = float(np.linalg.norm(rows[:, -1]))
        share = float(solution.residual_rms * np.sqrt(solution.row_count)) / size if size else 0.0
        checks = (conservation_check(share),)
    if solution.rank == 10:
        checks += part_checks(earlier, rows, freedom)
    result = Identification.of_solution(
        family.parameterization(tree.mass),
        solution,
        sample_count=sample_count,
        estimator=LEAST_SQUARES,
        rows=family.name,
        momentum=momentum.name,
        checks=checks,
    )
    return with_nearest_body(result, tree)
