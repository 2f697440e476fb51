"""Least squares on momentum rows of exact samples, or of smoothed samples with known covariance."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.plane import in_plane
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.combination import Agreement
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.regressor_noise import DRAWS, changed, changes, with_bias
from cpid_drake.estimation.square_root import (
    empty_information,
    solve_information,
    updated_information,
)
from cpid_drake.sensing.smoothed_motion import SmoothedMotion

_SAMPLES_AT_ONCE = 2048  # samples per block, whose arrays fit into a processor's cache
_SAMPLES_MOVED = 64  # samples whose quantities are varied at once
_MOST_REWEIGHTINGS = 20
_SMALLEST_SPREAD = 1e-9  # of a combination of scaled sums, below which it is rounding


def momentum_rows(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, momentum: TotalMomentum
) -> NDArray[np.float64]:
    """Return the rows [N | A | b] (samples · rows per sample, k + 11) of all samples, in C.

    N holds the k columns of an unknown momentum; see `momentum_columns`. A known momentum enters b:
    in a frame that moves with the centre of mass the linear momentum is zero, so the angular rows
    of a sample (its last three rows) give the angular momentum about any point.

    If a table carries the base, the rows are those of the plane, with the columns of
    `KinematicTree.unknowns`; see `RowFamily.rows_in_plane`.
    """
    if tree.normal_B is not None:
        telemetry = in_plane(telemetry, tree.normal_B)
    known = not momentum.is_unknown
    if known and momentum.v_WScm_W.any():
        telemetry = replace(telemetry, v_WB=telemetry.v_WB - momentum.v_WScm_W)
    samples = momentum_samples(tree, telemetry)
    rows = family.full_rows(samples, momentum.is_unknown)
    if known and momentum.L_WScm_W.any():
        by_sample = rows.reshape(len(samples), family.rows_per_sample, -1)
        R_CW = np.swapaxes(samples.motion.R_WC, -1, -2)
        by_sample[:, -3:, -1] += rotate(R_CW, momentum.L_WScm_W)
    if tree.normal_B is not None:
        return family.rows_in_plane(rows, samples.motion.R_WC, tree.unknowns)
    return rows


def row_blocks(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, momentum: TotalMomentum
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield times (n,) and `momentum_rows` (n, rows per sample, k + 11), some thousands at a time.

    The memory therefore does not grow with the number of samples.
    """
    for start in range(0, len(telemetry), _SAMPLES_AT_ONCE):
        part = telemetry.select(slice(start, start + _SAMPLES_AT_ONCE))
        rows = momentum_rows(tree, part, family, momentum)
        yield part.time, rows.reshape(len(part), -1, rows.shape[1])


def accumulate_rows(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, momentum: TotalMomentum
) -> tuple[NDArray[np.float64], int]:
    """Return the square-root information (k + 11, k + 11) of `momentum_rows`, and their number.

    Rows of zeros (a sample at rest) contain no information and are not counted.
    """
    sums = RowSums.of(tree, family, momentum)
    for _, rows in row_blocks(tree, telemetry, family, momentum):
        sums.add(rows)
    return sums.root, sums.count


class RowSums:
    """The square-root information of rows that are added block by block.

    Args:
        extra: number k of columns of an unknown momentum.
        size: number u of the target's unknowns.

    Attributes:
        root: (k + u + 1, k + u + 1) square-root information.
        count: number of scalar rows without rows of zeros.

    """

    def __init__(self, extra: int, size: int = 10) -> None:
        self.extra, self.size = extra, size
        self.root = empty_information(extra + size)
        self.count = 0

    @classmethod
    def of(cls, tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> "RowSums":
        """Return empty sums for the rows of `momentum_rows`."""
        return cls(momentum_columns(tree, family, momentum), len(tree.unknowns))

    def add(self, rows: NDArray[np.float64]) -> None:
        """Add rows [N | A | b] (n, rows per sample, k + u + 1)."""
        flat = rows.reshape(-1, rows.shape[-1])
        self.root = updated_information(self.root, flat)
        self.count += int(flat[:, self.extra :].any(axis=1).sum())

    def solution(self) -> LeastSquaresSolution:
        """Return the least-squares solution of the target's unknowns."""
        return solve_information(self.root, self.count, eliminated=self.extra)

    def with_momentum(self, estimate: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (k + u,) the momentum that fits best to an estimate (u,), and the estimate."""
        k = self.extra
        rest = self.root[:k, -1] - self.root[:k, k:-1] @ estimate
        momentum = np.linalg.lstsq(self.root[:k, :k], rest, rcond=None)[0] if k else np.empty(0)
        return np.concatenate([momentum, estimate])


def momentum_columns(tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> int:
    """Return the number of columns that a momentum adds to the rows of a family."""
    if not momentum.is_unknown:
        return 0
    return family.momentum_size if tree.normal_B is None else len(family.momenta_in_plane())


@dataclass(eq=False)
class _WeightedRows:
    """Weighted rows of smoothed samples.

    Attributes:
        sums: the square-root information of the rows.
        spread: (k + u, k + u) covariance of Aᵀ W e, where e are the errors of the rows and W their
            weights.
        noise: (k + u + 1, k + u + 1) expectation of δᵀ δ for the errors δ of the rows.

    """

    sums: RowSums
    spread: NDArray[np.float64]
    noise: NDArray[np.float64]

    @classmethod
    def of(cls, sums: RowSums) -> "_WeightedRows":
        """Return no rows, for sums that are empty."""
        size = len(sums.root)
        return cls(sums, np.zeros((size - 1, size - 1)), np.zeros((size, size)))

    def solution(self) -> LeastSquaresSolution:
        """Return the solution of the target's unknowns."""
        solution, extra = self.sums.solution(), self.sums.extra
        if not solution.is_observable:
            return solution
        root = self.sums.root[:-1, :-1]
        normal = root.T @ root
        scale = 1 / np.sqrt(np.diag(normal))
        inverse = scale[:, None] * np.linalg.inv(normal * scale * scale[:, None]) * scale
        total = inverse @ self.spread @ inverse.T
        solution = replace(solution, covariance=total[extra:, extra:])
        return with_bias(solution, self.sums.root, self.noise)


class SmoothedRows:
    """Least squares on a row family of smoothed motion, window by window.

    The weight of each sample follows from its errors, by linear propagation of the covariance of
    the smoothed motion into the rows. The weights depend on the estimate: in each window they are
    computed from all samples so far, and again until the estimate changes by less than 1 % of its
    standard deviation. The covariance includes the correlation between neighbouring samples of a
    window, and the bias that errors inside the regressor cause; see `regressor_noise`.

    The first halves of all windows and the second halves are also summed separately, so that their
    estimates can be compared.

    Args:
        tree: the known bodies.
        family: the row family.
        momentum: the total momentum of spacecraft and target.

    """

    def __init__(self, tree: KinematicTree, family: RowFamily, momentum: TotalMomentum) -> None:
        self._tree, self._family, self._momentum = tree, family, momentum
        self._all, *self._halves = (
            _WeightedRows.of(RowSums.of(tree, family, momentum)) for _ in range(3)
        )

    @property
    def sums(self) -> RowSums:
        """The square-root information of all rows."""
        return self._all.sums

    def add(self, motion: SmoothedMotion) -> NDArray[np.float64]:
        """Add the rows of the next window; return them without weights (n, rows, k + u + 1)."""
        rows = momentum_rows(self._tree, motion.telemetry, self._family, self._momentum)
        rows = rows.reshape(len(motion.telemetry), -1, rows.shape[1])
        count = rows.shape[1]
        before = self.sums
        solution, sums = before.solution(), before
        if not solution.is_observable:
            sums = _sum_of(before, rows)
            solution = sums.solution()
        covariance = motion.covariance()
        for _ in range(_MOST_REWEIGHTINGS):
            # What is not known yet is zero: the weights are then those of the spacecraft alone.
            estimate = np.nan_to_num(solution.estimate)
            jacobian = self._jacobian(motion, sums.with_momentum(estimate))
            S = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
            S += 1e-9 * np.trace(S, axis1=1, axis2=2)[:, None, None] * np.eye(count) / count
            S += 1e-300 * np.eye(count)
            whiten = np.linalg.inv(np.linalg.cholesky(S))
            white, effect = whiten @ rows, whiten @ jacobian
            sums = _sum_of(before, white)
            previous, solution = solution, sums.solution()
            change = solution.estimate - previous.estimate
            if not solution.is_observable:
                break
            if np.all(np.abs(change) < 0.01 * np.sqrt(np.diag(solution.covariance))):
                break
        self._all.sums = sums
        middle = len(rows) // 2
        halves = list(zip(self._halves, (slice(0, middle), slice(middle, None)), strict=True))
        for part, own in halves:
            part.sums.add(white[own])
        # The error of one spline coefficient enters many samples: sum its effects before squaring.
        A = white[:, :, :-1]
        for block in motion.errors:
            by_block = effect[:, :, block.columns] @ block.basis
            total = np.zeros((len(block.covariance), A.shape[2]))
            for part, own in halves:
                gain = np.zeros_like(total)
                np.add.at(gain, block.support[own], np.swapaxes(by_block[own], -1, -2) @ A[own])
                part.spread += gain.T @ block.covariance @ gain
                total += gain
            self._all.spread += total.T @ block.covariance @ total
        for telemetry in changes(motion.telemetry, covariance):
            moved = momentum_rows(self._tree, telemetry, self._family, self._momentum)
            errors = whiten @ (moved.reshape(rows.shape) - rows)
            for part, own in halves:
                flat = errors[own].reshape(-1, rows.shape[2])
                noise = flat.T @ flat / DRAWS
                part.noise += noise
                self._all.noise += noise
        return rows

    def solution(self) -> LeastSquaresSolution:
        """Return the solution of the target's unknowns from all windows."""
        return self._all.solution()

    def agreement(self) -> Agreement:
        """Return the test whether the first and the second halves have the same unknowns.

        At the solution x of all rows the sum Aᵀ W (b − A x) of the first halves is that of the
        second halves with the opposite sign, and zero but for the errors of the rows. Its
        covariance contains the square of what errors inside the regressor add. Source: Rao 1948,
        "Large sample tests of statistical hypotheses concerning several parameters".
        """
        solution = self.solution()
        if not solution.is_observable:
            return Agreement(0.0, 0)
        x = np.append(self.sums.with_momentum(solution.estimate), -1.0)
        first, second = self._halves
        grams = [part.sums.root.T @ part.sums.root for part in (first, second)]
        share = np.linalg.solve((grams[0] + grams[1])[:-1, :-1], grams[0][:-1, :-1]).T
        rest = np.eye(len(share)) - share
        pulls = rest @ first.noise[:-1] @ x, -share @ second.noise[:-1] @ x
        score = -grams[0][:-1] @ x + sum(pulls)
        covariance = rest @ first.spread @ rest.T + share @ second.spread @ share.T
        covariance += sum(np.outer(pull, pull) for pull in pulls)
        own = np.sqrt(np.diag(covariance)) + 1e-300
        sizes, axes = np.linalg.eigh(covariance / own / own[:, None])
        kept = sizes > _SMALLEST_SPREAD
        parts = axes[:, kept].T @ (score / own)
        return Agreement(float(np.sum(parts**2 / sizes[kept])), int(kept.sum()))

    def _jacobian(
        self, motion: SmoothedMotion, solution: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the derivative (N, rows, quantities) of A x − b w.r.t. the smoothed quantities."""
        problem = self._tree, self._family, self._momentum
        return np.concatenate(
            [
                row_jacobian(
                    motion.telemetry.select(slice(k, k + _SAMPLES_MOVED)), *problem, solution
                )
                for k in range(0, len(motion.telemetry), _SAMPLES_MOVED)
            ]
        )


def solve_smoothed_rows(
    tree: KinematicTree, motion: SmoothedMotion, family: RowFamily, momentum: TotalMomentum
) -> LeastSquaresSolution:
    """Solve a row family on the smoothed motion of one window; see `SmoothedRows`.

    Args:
        tree: the known bodies.
        motion: the smoothed motion.
        family: the row family.
        momentum: the total momentum of spacecraft and target.

    """
    smoothed = SmoothedRows(tree, family, momentum)
    smoothed.add(motion)
    return smoothed.solution()


def _sum_of(before: RowSums, rows: NDArray[np.float64]) -> RowSums:
    """Return the sums after adding rows; those before do not change."""
    after = RowSums(before.extra, before.size)
    after.root, after.count = before.root, before.count
    after.add(rows)
    return after


def row_jacobian(
    telemetry: Telemetry,
    tree: KinematicTree,
    family: RowFamily,
    momentum: TotalMomentum,
    solution: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the derivative (N, rows, quantities) of A x − b w.r.t. the smoothed quantities."""
    step = 1e-6
    N, count = len(telemetry), 12 + 2 * len(telemetry.joint_names)
    shift = step * np.eye(count)[:, None, :] * np.ones((1, N, 1))
    shift = np.concatenate([np.zeros((1, N, count)), shift]).reshape(-1, count)
    moved = changed(telemetry, shift)
    rows = momentum_rows(tree, moved, family, momentum)
    residuals = (rows[:, :-1] @ solution - rows[:, -1]).reshape(count + 1, N, -1)
    return np.moveaxis((residuals[1:] - residuals[0]) / step, 0, -1)
