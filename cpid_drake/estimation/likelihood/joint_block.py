"""Joint motion of a block, fitted to its samples without a penalty: for the recursive fit."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from cpid_drake.errors import InputError
from cpid_drake.estimation.likelihood.joint_motion import (
    DEGREE,
    KICK,
    ORDER,
    JointPart,
    spline_basis,
)
from cpid_drake.estimation.likelihood.rounding import RoundedSamples, whitening
from cpid_drake.estimation.square_root import triangle
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.sensors import JOINT_POSITIONS, JOINT_RATES, sensors_of
from cpid_drake.sensing.splines import DerivativeSamples
from cpid_drake.sensing.suite import SensorSuite

PIECES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 23, 32, 45, 64, 91, 128)
"""Numbers of pieces that a block's spline may have."""

LARGEST_SHARE = 0.9
"""Largest number of new coefficients, as a share of the number of encoder samples."""

OUTLIER = 6.0
"""A residual larger than this, in σ or in robust σ of the block, marks an outlier."""

FEW = 0.1
"""Largest share of outliers in the samples of one joint in one block."""

_MISFIT = 1e-3  # probability of χ² below which the residuals contain more than noise
_USUAL_PIECES = 8  # in a first block
_PATIENCE = 2  # numbers of pieces that are tried beyond the best one


@dataclass(frozen=True, eq=False)
class JointTrack:
    """The joint motion at a boundary as its sensors alone determine it: root (s − mean) ~ N(0, 1).

    Attributes:
        mean: (ORDER, J) scaled derivatives s.
        root: (ORDER, ORDER) square-root information about s of each joint.
        piece: length of the last pieces [s].
        jerk: root mean square of the third derivatives so far [rad/s³ or m/s³].

    """

    mean: NDArray[np.float64]
    root: NDArray[np.float64]
    piece: float
    jerk: float

    def kicked(self) -> "JointTrack":
        """Return the track after a change of the thrust: the accelerations are not known."""
        n = len(self.root)
        rows = np.zeros((n + 1, n + 1))
        rows[0, 0] = 1 / KICK
        rows[1:, 0], rows[1:, 1:] = -self.root[:, -1], self.root
        return replace(self, root=triangle(rows)[1 : n + 1, 1:])


@dataclass(frozen=True, eq=False, kw_only=True)
class JointBlock(JointPart):
    """The joint motion in one block, and the information of the block's own samples about it.

    Attributes:
        track: the motion at the end, by the joints' sensors alone.
        outliers: number of samples of joint sensors that were left out.
        chi_squared, freedom: of the joint sensors' samples.

    """

    track: JointTrack
    outliers: int
    chi_squared: float
    freedom: int


def joint_block(
    start: float,
    end: float,
    measurements: Measurements,
    suite: SensorSuite,
    before: JointTrack | None,
    finer: int = 0,
    *,
    is_kicked: bool = False,
) -> JointBlock:
    """Fit the joint motion of a block to the samples of all joint sensors.

    Akaike's criterion chooses the number of pieces, and the next larger number is used: the rest of
    the error is then noise, not misfit. From block to block the pieces become at most one size
    longer. A single entry that is an outlier is replaced by its fitted value, iteratively, as if it
    were missing. In a piece without samples, the jerk is zero with the σ of the jerk so
    far.

    Args:
        start, end: [s].
        measurements: the samples with start ≤ time ≤ end.
        suite: the sensors' errors.
        before: the motion at the start; None in the first block.
        finer: by how many sizes the number of pieces is larger than the joints' sensors ask for.
        is_kicked: whether the thrust changes at the start. The arm is then pushed, so that the
            accelerations of the joints change.

    Raises:
        InputError: too few samples of the joints' positions.

    """
    if before is not None and is_kicked:
        before = before.kicked()
    derivatives = {
        sensor.name: derivative
        for derivative, quantity in enumerate((JOINT_POSITIONS, JOINT_RATES))
        for sensor in sensors_of(quantity)
        if sensor.name in suite.present() and len(measurements[sensor.name])
    }
    samples = [
        (measurements[name], derivative, float(suite.sigmas(name)[0]))
        for name, derivative in derivatives.items()
    ]
    positions = sum(len(each) for each, derivative, _ in samples if not derivative)
    if positions < (8 if before is None else 1):
        raise InputError(f"{positions} samples of the joints' positions are too few")
    target = np.vstack([each.value / sigma for each, _, sigma in samples])
    times = np.concatenate([each.time for each, _, _ in samples])

    def design(pieces: int) -> NDArray[np.float64]:
        return np.vstack(
            [spline_basis(start, end, pieces, s.time, d) / sigma for s, d, sigma in samples]
        )

    def solved(target: NDArray[np.float64], pieces: int) -> _Solution:
        A = design(pieces)
        known = _known(start, end, pieces, times, target.shape[1], before)
        R = triangle(np.vstack([known, np.hstack([A, target])]))
        c = solve_triangular(R[: A.shape[1], : A.shape[1]], R[: A.shape[1], A.shape[1] :])
        freedom = max((len(A) + len(known) - A.shape[1]) * target.shape[1], 1)
        return _Solution(pieces, A, target, R, c, freedom)

    def best(target: NDArray[np.float64]) -> _Solution:
        pieces = _pieces(start, end, design, target, times, before, positions, finer)
        return solved(target, pieces)

    found, outliers = best(target), 0
    usual = _USUAL_PIECES if before is None else (end - start) / before.piece
    if not found.is_likely or found.pieces > 2 * usual:
        # Outliers make the spline finer than the motion needs, so that it follows them.
        for pieces in (n for n in PIECES if n <= found.pieces):
            missing, cleaned = _outliers(solved(target, pieces), solved)
            if missing.any() and solved(cleaned, pieces).is_likely:
                found, outliers = best(cleaned), int(missing.any(axis=1).sum())
                break
    K, R, c, pieces = len(found.c), found.R, found.c, found.pieces
    misfit = 1.0 if found.is_likely else found.chi_squared / found.freedom
    jerk = float(np.sqrt(np.mean((spline_basis(start, end, pieces, times, 3) @ c) ** 2)))
    track = JointTrack(
        c[-ORDER:],
        R[K - ORDER : K, K - ORDER : K] / np.sqrt(misfit),
        (end - start) / pieces,
        jerk if before is None else max(jerk, 0.9 * before.jerk),
    )
    rows, rest = _own_rows(found, samples, [suite.step(each) for each in derivatives])
    rows, rest = rows / np.sqrt(misfit), rest / np.sqrt(misfit)
    chi_squared, freedom = found.chi_squared, found.freedom
    return JointBlock(
        start=start,
        end=end,
        pieces=pieces,
        coefficients=c,
        rows=rows,
        target=rest + np.einsum("jrk,kj->jr", rows, c),
        is_kicked=is_kicked,
        track=track,
        outliers=outliers,
        chi_squared=chi_squared,
        freedom=freedom,
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    """A fit of one spline to the samples `target`, all in units of σ: the triangle of its rows."""

    pieces: int
    A: NDArray[np.float64]
    target: NDArray[np.float64]
    R: NDArray[np.float64]
    c: NDArray[np.float64]
    freedom: int

    @property
    def left(self) -> NDArray[np.float64]:
        """Residuals."""
        return self.target - self.A @ self.c

    @property
    def chi_squared(self) -> float:
        """χ² of the samples and of what was known before."""
        K = len(self.c)
        return float(np.sum(self.R[K:, K:] ** 2))

    @property
    def is_likely(self) -> bool:
        """Whether noise explains χ²."""
        return bool(self.chi_squared <= chdtri(self.freedom, _MISFIT))


def _own_rows(
    found: _Solution, samples: list[DerivativeSamples], steps: list[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rows and their right sides of a block's own samples; see `JointBlock`."""
    Q, R = np.linalg.qr(found.A)
    ends = np.cumsum([len(each) for each, _, _ in samples])[:-1]
    parts = zip(samples, steps, np.split(Q, ends), np.split(found.A @ found.c, ends), strict=True)
    W = whitening(
        [
            RoundedSamples(part, each.value, sigma * smooth, sigma, step)
            for (each, _, sigma), step, part, smooth in parts
        ]
    )
    return W @ R, np.einsum("jkl,lj->jk", W, Q.T @ found.left)


def _outliers(
    found: _Solution, solved: Callable[[NDArray[np.float64], int], _Solution]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which entries are outliers, and the samples with the fit's values in their place.

    An outlier is a single entry. Neighbouring entries, and those at the ends, may be motion.
    """
    missing, target = np.zeros(found.target.shape, dtype=bool), found.target
    for _ in range(8):  # the missing entries converge by a factor of ten at least
        left = np.abs(found.left)
        limit = OUTLIER * np.maximum(1.0, 1.5 * np.median(left, axis=0))
        alone = np.zeros_like(missing)
        alone[1:-1] = (left[1:-1] > left[:-2]) & (left[1:-1] > left[2:])
        more = missing | (alone & (left > limit))
        more &= more.mean(axis=0) <= FEW
        if not more.any() or (np.array_equal(more, missing) and np.max(left[more]) < 1e-3):
            break
        missing = more
        target = np.where(missing, found.A @ found.c, target)
        found = solved(target, found.pieces)
    if (missing[1:] & missing[:-1]).any():
        missing = np.zeros_like(missing)
    return missing, target


def _pieces(
    start: float,
    end: float,
    design: Callable[[int], NDArray[np.float64]],
    target: NDArray[np.float64],
    times: NDArray[np.float64],
    before: JointTrack | None,
    positions: int,
    finer: int,
) -> int:
    """Return the number of pieces; see `joint_block`."""
    J = target.shape[1]
    free = DEGREE if before is None else DEGREE - ORDER
    allowed = [n for n in PIECES if n + free <= LARGEST_SHARE * positions] or [1]
    coarsest = 1.0 if before is None else (end - start) / before.piece / 1.5 ** (1 + finer)
    best, least, k = 0, np.inf, 0
    for k, n in enumerate(allowed):
        known = _known(start, end, n, times, J, before)
        rows = np.hstack([design(n), target])
        R = triangle(np.vstack([known, rows]))
        K = R.shape[1] - J
        criterion = float(np.sum(R[K:, K:] ** 2)) + 2 * J * K
        if criterion < least:
            best, least = k, criterion
        elif k - best >= _PATIENCE and n >= coarsest:
            break
    chosen = best + 1
    while chosen + 1 < len(allowed) and allowed[chosen] < coarsest:
        chosen += 1
    return allowed[min(chosen + finer, len(allowed) - 1)]


def _known(
    start: float,
    end: float,
    pieces: int,
    times: NDArray[np.float64],
    J: int,
    before: JointTrack | None,
) -> NDArray[np.float64]:
    """Return rows [A | b] of what is known besides the samples."""
    K = pieces + DEGREE
    rows = np.zeros((0, K + J))
    breaks = np.linspace(start, end, pieces + 1)
    count, _ = np.histogram(times, breaks)
    if before is not None:
        rows = np.zeros((ORDER, K + J))
        rows[:, :ORDER], rows[:, K:] = before.root, before.root @ before.mean
    open_pieces = count == 0 if len(times) >= K else count >= 0
    if open_pieces.any():
        at = (breaks[:-1, None] + np.diff(breaks)[:, None] * [0.1, 0.5, 0.9])[open_pieces].ravel()
        jerk = 1.0 if before is None else max(before.jerk, 1e-6)
        calm = np.hstack([spline_basis(start, end, pieces, at, 3) / jerk, np.zeros((len(at), J))])
        rows = np.vstack([rows, calm])
    return rows
