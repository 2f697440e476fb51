"""The turn of attitude and gyro together, by any angle, that the conservation of momentum shows.

Both sensors of one body agree in any axes of it; only the motion of the arm says which are those of
the model. With k and c the vectors from B's origin to the spacecraft's centre of mass and to C in
B's axes, and the others as in `score`, the position in a unit of 1/s m is

    p_WBo = a₀ + a₁ t + a₂ t² − R_WB' M⁻¹ (s k + s μ (c − k) + R_BC s h'),

which is linear in all but the turn M from the logged axes B' to B. It is looked for from every
right-angled turn, of which one is nearer than 63°.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.alternatives import Alternative
from cpid_drake.logs.attitude_alternatives import (
    OTHER_AXES,
    gyro_axes,
    in_axes_of_base,
    plain,
    rounded,
)
from cpid_drake.logs.axes import MOUNTING, signed_axes
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.instants import Instants
from cpid_drake.logs.score import momentum_of

_FEW = 10
"""Most iterations from a right-angled turn."""


def common_turns(
    whole: Instants,
    given: Instants,
    names: tuple[str, ...],
    tree: KinematicTree,
    column_map: ColumnMap,
) -> Iterator[Alternative]:
    """Yield axes of attitude and gyro that are turned by an angle.

    A turn near to a right-angled one is an error of a mounting, or an alternative of its own.

    Args:
        whole: what the log says with its position, by which the turn is found.
        given, names, tree, column_map: see `alternatives`.

    """
    del names
    log = given.over(whole)
    if not {"attitude", "position"} <= log.values.keys() or not log.is_free:
        return
    few, every = _parts(log.at_every(3), tree), _parts(log, tree)
    starts = [np.eye(3), *(M for _, M in signed_axes() if np.linalg.det(M) > 0)]
    fits = list[tuple[float, Array]]()
    for start in starts:
        fit = least_squares(partial(_errors, start, *few), np.zeros(3), max_nfev=_FEW)
        fits.append((float(fit.cost), _turned(start, fit.x)))
    best = min(fits, key=lambda each: each[0])[1]
    M = _turned(best, least_squares(partial(_errors, best, *every), np.zeros(3)).x)
    if min(Rotation.from_matrix(start.T @ M).magnitude() for start in starts) < MOUNTING:
        return
    turn = Rotation.from_matrix(M)
    degrees, axis = np.degrees(turn.magnitude()), turn.as_rotvec() / turn.magnitude()
    text = f"{OTHER_AXES}: turned by {degrees:.1f}° about {plain(rounded(axis, 2))}"
    entries = {
        "attitude.R_BS": rounded(M @ column_map.attitude.R_BS),
        **gyro_axes(given, column_map, rounded(M @ column_map.angular_velocity.R_BS)),
    }
    yield Alternative(text, in_axes_of_base(given, M), tree, entries, 2)


def _parts(log: Instants, tree: KinematicTree) -> tuple[Array, Array, Array, Array]:
    """Return R_WB', then k, c − k and the columns of R_BC in (N, 3, 5), drift and position."""
    samples, R_BW = momentum_of(log, tree), np.swapaxes(log.R_WB, 1, 2)
    k, c = samples.p_WKcm, samples.motion.p_WC
    vectors = np.stack([rotate(R_BW, k), rotate(R_BW, c - k)], axis=2)
    clock = log.time / log.time[-1]
    powers = [power[:, None, None] * np.eye(3) for power in (np.ones_like(clock), clock, clock**2)]
    parts = np.concatenate([vectors, R_BW @ samples.motion.R_WC], axis=2)
    return log.R_WB, parts, np.concatenate(powers, axis=2), log.values["position"]


def _errors(start: Array, R: Array, parts: Array, drift: Array, p: Array, v: Array) -> Array:
    """Return what the best target leaves of the position in turned axes, relative to its size."""
    A = np.concatenate([R @ _turned(start, v).T @ parts, drift], axis=2).reshape(p.size, -1)
    Q, _ = np.linalg.qr(A)
    b = p.reshape(-1) / (float(np.linalg.norm(p - p.mean(axis=0))) or 1.0)
    return np.asarray(b - Q @ (Q.T @ b))


def _turned(start: Array, v: Array) -> Array:
    """Return a turn that differs from another one by a rotation vector."""
    return np.asarray(Rotation.from_rotvec(v).as_matrix() @ start)
