"""Least squares on momentum rows of exact samples, or of smoothed samples with known covariance."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.square_root import (
    empty_information,
    solve_information,
    updated_information,
)
from cpid_drake.sensing.smoothing import SmoothedMotion

_SAMPLES_AT_ONCE = 2048  # samples per block, whose arrays fit into a processor's cache
_MOST_REWEIGHTINGS = 20


def momentum_rows(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, momentum: TotalMomentum
) -> NDArray[np.float64]:
    """Return the rows [N | A | b] (samples · rows per sample, k + 11) of all samples, in C.

    N holds the k columns of an unknown momentum; see `momentum_columns`. A known momentum enters b:
    in a frame that moves with the centre of mass the linear momentum is zero, so the angular rows
    of a sample (its last three rows) give the angular momentum about any point.
    """
    known = not momentum.is_unknown
    if known and momentum.v_WScm_W.any():
        telemetry = replace(telemetry, v_WB=telemetry.v_WB - momentum.v_WScm_W)
    samples = momentum_samples(tree, telemetry)
    rows = family.full_rows(samples, momentum.is_unknown)
    if known and momentum.L_WScm_W.any():
        by_sample = rows.reshape(len(samples), family.rows_per_sample, -1)
        R_CW = np.swapaxes(samples.motion.R_WC, -1, -2)
        by_sample[:, -3:, -1] += rotate(R_CW, momentum.L_WScm_W)
    return rows


def accumulate_rows(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, momentum: TotalMomentum
) -> tuple[NDArray[np.float64], int]:
    """Return the square-root information (k + 11, k + 11) of `momentum_rows`, and their number.

    The rows are computed for a few thousand samples at a time, so that the memory does not grow
    with the number of samples. Rows of zeros (a sample at rest) contain no information and are not
    counted.
    """
    extra = momentum_columns(family, momentum)
    root, count = empty_information(extra + 10), 0
    for start in range(0, len(telemetry), _SAMPLES_AT_ONCE):
        part = telemetry.select(slice(start, start + _SAMPLES_AT_ONCE))
        rows = momentum_rows(tree, part, family, momentum)
        root = updated_information(root, rows)
        count += int(rows[:, extra:].any(axis=1).sum())
    return root, count


def momentum_columns(family: RowFamily, momentum: TotalMomentum) -> int:
    """Return the number of columns that a momentum adds to the rows of a family."""
    return family.momentum_size if momentum.is_unknown else 0


def row_residuals(
    tree: KinematicTree,
    telemetry: Telemetry,
    family: RowFamily,
    momentum: TotalMomentum,
    estimate: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return b − A x (N, rows per sample) at an estimate x (10,), in the units of the rows.

    An unknown momentum is fitted to these residuals by least squares.
    """
    rows = momentum_rows(tree, telemetry, family, momentum)
    columns, rest = rows[:, :-11], rows[:, -1] - rows[:, -11:-1] @ estimate
    if columns.shape[1]:
        rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
    return rest.reshape(len(telemetry), -1)


def solve_smoothed_rows(
    tree: KinematicTree, motion: SmoothedMotion, family: RowFamily, momentum: TotalMomentum
) -> LeastSquaresSolution:
    """Solve a row family on smoothed motion; the weight of each sample follows from its errors.

    The weights come from linear propagation of the covariance of the smoothed motion into the rows.
    The weights depend on the estimate, so the solution is repeated until the estimate changes by
    less than 1 % of its standard deviation. The covariance includes the correlation between
    neighbouring samples, but not the bias that errors inside the regressor cause.

    Args:
        tree: the known bodies.
        motion: the smoothed motion.
        family: the row family.
        momentum: the total momentum of spacecraft and target.

    """
    extra, count = momentum_columns(family, momentum), family.rows_per_sample
    rows = momentum_rows(tree, motion.telemetry, family, momentum)
    rows = rows.reshape(-1, count, rows.shape[1])
    covariance = motion.covariance()
    solution = _solve(rows, extra)
    for _ in range(_MOST_REWEIGHTINGS):
        if not solution.is_observable:
            return solution
        full = _with_momentum(rows, extra, solution.estimate)
        jacobian = _row_jacobian(tree, motion, family, momentum, full)
        S = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
        S += 1e-9 * np.trace(S, axis1=1, axis2=2)[:, None, None] * np.eye(count) / count
        S += 1e-300 * np.eye(count)
        whiten = np.linalg.inv(np.linalg.cholesky(S))
        white = whiten @ rows
        before, solution = solution, _solve(white, extra)
        change = solution.estimate - before.estimate
        if np.all(np.abs(change) < 0.01 * np.sqrt(np.diag(solution.covariance))):
            break
    if not solution.is_observable:
        return solution
    # The error of one spline coefficient enters many samples: sum its effects before squaring.
    A = white[:, :, :-1]
    normal = np.einsum("nri,nrj->ij", A, A)
    scale = 1 / np.sqrt(np.diag(normal))
    inverse = scale[:, None] * np.linalg.inv(normal * scale * scale[:, None]) * scale
    white_jacobian = whiten @ jacobian
    total = np.zeros_like(normal)
    for block in motion.errors:
        part = white_jacobian[:, :, block.columns] @ block.basis
        gain = inverse @ np.einsum("nri,nrk->ik", A, part)
        total += gain @ block.covariance @ gain.T
    return replace(solution, covariance=total[extra:, extra:])


def _solve(rows: NDArray[np.float64], extra: int) -> LeastSquaresSolution:
    rows = rows.reshape(-1, rows.shape[2])
    root = updated_information(empty_information(rows.shape[1] - 1), rows)
    return solve_information(root, len(rows), eliminated=extra)


def _with_momentum(
    rows: NDArray[np.float64], extra: int, estimate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the solution (extra + 10,): first the unknown momentum, then the ten unknowns."""
    flat = rows.reshape(-1, rows.shape[2])
    rest = flat[:, -1] - flat[:, extra:-1] @ estimate
    momentum = np.linalg.lstsq(flat[:, :extra], rest, rcond=None)[0] if extra else np.empty(0)
    return np.concatenate([momentum, estimate])


def _row_jacobian(
    tree: KinematicTree,
    motion: SmoothedMotion,
    family: RowFamily,
    momentum: TotalMomentum,
    solution: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the derivative (N, rows, quantities) of A x − b w.r.t. the smoothed quantities."""
    telemetry, step = motion.telemetry, 1e-6
    N, J = len(telemetry), len(telemetry.joint_names)
    count = 12 + 2 * J
    shift = step * np.eye(count)[:, None, :] * np.ones((1, N, 1))
    shift = np.concatenate([np.zeros((1, N, count)), shift]).reshape(-1, count)
    tiled = {
        name: np.tile(getattr(telemetry, name), (count + 1, 1))
        for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")
    }
    attitude = Rotation.from_quat(tiled["quaternion_WB"], scalar_first=True)
    w_B = attitude.inv().apply(tiled["w_WB"]) + shift[:, 3:6]
    attitude = attitude * Rotation.from_rotvec(shift[:, :3])
    moved = Telemetry(
        telemetry.joint_names,
        np.arange(len(shift), dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=tiled["p_WB"] + shift[:, 6:9],
        w_WB=attitude.apply(w_B),
        v_WB=tiled["v_WB"] + shift[:, 9:12],
        q=tiled["q"] + shift[:, 12 : 12 + J],
        qdot=tiled["qdot"] + shift[:, 12 + J :],
    )
    rows = momentum_rows(tree, moved, family, momentum)
    residuals = (rows[:, :-1] @ solution - rows[:, -1]).reshape(count + 1, N, -1)
    return np.moveaxis((residuals[1:] - residuals[0]) / step, 0, -1)
