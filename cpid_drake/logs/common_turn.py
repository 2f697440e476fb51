"""The turn of attitude and gyro together, by any angle, that the conservation of momentum shows.

Both sensors of one body agree in any axes of it; only the motion of the arm says which are those of
the model. The turn has the least errors of the momentum; it is looked for from the right-angled
turns, of which one is nearer than 63°.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
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
from cpid_drake.logs.score import explain_by_momentum

_STARTS = 3
"""Number of right-angled turns from which the best one is looked for."""


def common_turns(
    given: Instants, names: tuple[str, ...], tree: KinematicTree, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield axes of attitude and gyro that are turned by an angle; see `alternatives`.

    A turn near to a right-angled one is an error of a mounting, or an alternative of its own.
    """
    del names
    errors = partial(_errors, given.at_every(3), tree)
    if "attitude" not in given.values or errors(np.eye(3)) is None:
        return
    starts = [np.eye(3), *(M for _, M in signed_axes() if np.linalg.det(M) > 0)]
    starts.sort(key=lambda M: float(np.sum(errors(M) ** 2)))
    fits = []
    for start in starts[:_STARTS]:
        turned = partial(_turned, start)
        fit = least_squares(lambda v: errors(turned(v)), np.zeros(3), diff_step=1e-4, max_nfev=12)
        fits.append((fit.cost, turned(fit.x)))
    M = min(fits, key=lambda each: each[0])[1]
    apart = [Rotation.from_matrix(start.T @ M).magnitude() for start in starts]
    if min(apart) < MOUNTING:
        return
    turn = Rotation.from_matrix(M)
    degrees, axis = np.degrees(turn.magnitude()), turn.as_rotvec() / turn.magnitude()
    text = f"{OTHER_AXES}: turned by {degrees:.1f}° about {plain(rounded(axis, 2))}"
    entries = {
        "attitude.R_BS": M @ column_map.attitude.R_BS,
        **gyro_axes(given, column_map, M @ column_map.angular_velocity.R_BS),
    }
    digits = {key: rounded(value) for key, value in entries.items()}
    yield Alternative(text, in_axes_of_base(given, M), tree, digits, 2)


def _turned(start: Array, v: Array) -> Array:
    """Return a turn that differs from another one by a rotation vector."""
    return np.asarray(Rotation.from_rotvec(v).as_matrix() @ start)


def _errors(given: Instants, tree: KinematicTree, M: Array) -> Array | None:
    """Return the errors of the momentum in turned axes; None if nothing is compared."""
    explained = explain_by_momentum(in_axes_of_base(given, M), tree)
    return None if explained is None else explained.errors
