"""The joints' motion by their own sensors: smoothing splines that continue from block to block.

Position, rate and acceleration continue; the jerk is white noise. See `smoothness` for the rows of
one block; those of all blocks are one banded least-squares problem, solved by a sweep forward and
back.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.joint_motion import ORDER, JointPart
from cpid_drake.estimation.smoothness import JointSamples, Smoothness, smoothness_of
from cpid_drake.sensors.suite import SensorSuite


def smooth_joints(
    blocks: Sequence[Block], suite: SensorSuite
) -> tuple[Smoothness, list[JointPart]]:
    """Return the smoothness of a log's joints, and their smoothed motion in successive blocks.

    Args:
        blocks: successive blocks of one log.
        suite: the sensors' errors.

    """
    smoothness, weights = smoothness_of(blocks, suite)
    parts = [
        joint_part(block, suite, smoothness, each)
        for block, each in zip(blocks, weights, strict=True)
    ]
    return smoothness, smoothed(parts)


def joint_part(
    block: Block,
    suite: SensorSuite,
    smoothness: Smoothness,
    weights: NDArray[np.float64] | None = None,
) -> JointPart:
    """Return a block's own information about its joints, about a motion that fits it alone.

    Args:
        block: the samples.
        suite: the sensors' errors.
        smoothness: of the log.
        weights: (N, J) weights of the samples; default: 1.

    """
    samples, pieces = JointSamples.of(block, suite), smoothness.pieces(block.length)
    P, A, y = samples.penalty(pieces), samples.design(pieces), samples.values
    K = A.shape[1]
    w = np.ones(y.shape) if weights is None else weights
    jerk = np.column_stack([P, np.zeros(len(P))]) / smoothness.jerk[:, None, None]
    data = np.dstack([w.T[..., None] * A, (w * y).T]) / smoothness.noise[:, None, None]
    T = triangles(np.concatenate([jerk, data], axis=1))
    rows, target = T[:, :K, :K], T[:, :K, K]
    c = _solved(rows, target).T
    return JointPart(block.start, block.end, pieces, c, rows, target)


def smoothed(parts: Sequence[JointPart]) -> list[JointPart]:
    """Return successive parts about the motion that fits all of them together."""
    J = parts[0].coefficients.shape[1]
    carried, factors = np.zeros((J, ORDER, ORDER + 1)), []
    for part in parts:
        factors.append(triangles(joined(carried, part)))
        carried = factors[-1][:, part.size - ORDER : part.size, part.size - ORDER :]
    end = _solved(carried[:, :, :-1], carried[:, :, -1])
    result = []
    for k in reversed(range(len(parts))):
        part, T = parts[k], factors[k]
        n = part.size - ORDER
        right = T[:, :n, -1] - np.einsum("jnk,jk->jn", T[:, :n, n:-1], end)
        c = np.concatenate([_solved(T[:, :n, :n], right), end], axis=1).T
        result.append(replace(part, coefficients=c))
        end = c[:ORDER].T
    return result[::-1]


def _solved(A: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least-squares solutions (J, n) of equations (J, m, n) and (J, m)."""
    found = [np.linalg.lstsq(each, right, rcond=1e-12)[0] for each, right in zip(A, b)]
    return np.array(found).reshape(len(A), A.shape[2])


def joined(carried: NDArray[np.float64], part: JointPart) -> NDArray[np.float64]:
    """Return rows (J, ORDER + K, K + 1) of what is known at the start, and of a part's own."""
    J, K = carried.shape[0], part.size
    first = np.zeros((J, ORDER, K + 1))
    first[:, :, :ORDER], first[:, :, K] = carried[:, :, :ORDER], carried[:, :, ORDER]
    return np.concatenate([first, np.dstack([part.rows, part.target])], axis=1)


def triangles(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the upper triangles (J, n, n) of rows (J, M, n)."""
    J, M, n = rows.shape
    if n > M:
        rows = np.concatenate([rows, np.zeros((J, n - M, n))], axis=1)
    return np.asarray(np.linalg.qr(rows, mode="r"))
