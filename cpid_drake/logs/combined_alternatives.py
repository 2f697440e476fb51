"""Several conventions of a log at once: together they explain what no single one explains.

The position is left out: one in another unit, or of another point, would hide what is right about
the joints; afterwards it is a single convention. Units of two quantities are never free together: a
motion that both make vanish is explained by nothing. The axes of the base that attitude and gyro
share are those in which the momentum leaves least.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.alternatives import Alternative, alternatives
from cpid_drake.logs.attitude_alternatives import (
    OTHER_AXES,
    gyro_axes,
    in_axes_of_base,
    plain,
    rounded,
    turned_axes,
)
from cpid_drake.logs.axes import signed_axes
from cpid_drake.logs.column_map import ColumnMap, with_entries
from cpid_drake.logs.instants import Instants
from cpid_drake.logs.score import explain_by_momentum

_UNITS = {"joint_positions.unit", "joint_rates.unit"}
_ORDERS = {"joint_positions.columns", "joint_rates.columns"}
_SIGNS = {"reversed_joints"}

_COMMON_TURN = 3
"""A turn that two sensors share has three numbers, which explain as much as three conventions."""

_STARTS = 2
"""From so many signed axes the common turn is sought."""


def turned_attitudes(
    given: Instants, tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield other orders and directions of the attitude, together with turned axes."""
    keys = {"attitude.order", "attitude.direction"}
    for each in alternatives(given, (), None, column_map, keys):
        for text, log, entries in turned_axes(each.log, with_entries(column_map, each.entries)):
            both = {**each.entries, **entries}
            yield Alternative(f"{each.text}; and {text}", log, tree, both, each.count + 1)


def joint_alternatives(
    given: Instants, names: tuple[str, ...], tree: KinematicTree, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield unit, order and sign of joints, all of them or some; see `alternatives`."""
    reached = [Alternative("", given, tree, {}, 0)]
    for keys in (_UNITS, _ORDERS, _SIGNS):
        others = list[Alternative]()
        for base in reached:
            changed = with_entries(column_map, base.entries)
            for each in alternatives(base.log, names, tree, changed, keys):
                text = f"{base.text}; and {each.text}" if base.text else each.text
                both = {**base.entries, **each.entries}
                other = Alternative(text, each.log, tree, both, base.count + 1)
                others.append(other)
                yield other
        reached += others


def common_turn(
    given: Instants, tree: KinematicTree, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield the axes of the base, other than its own, in which the momentum leaves least."""
    if "attitude" not in given.values:
        return

    def left(turn: Array) -> float:
        log = in_axes_of_base(given, Rotation.from_rotvec(turn).as_matrix())
        compared = explain_by_momentum(log, tree)
        return np.inf if compared is None else float(np.log(compared[0].residual))

    starts = [Rotation.from_matrix(M) for _, M in signed_axes() if np.linalg.det(M) > 0]
    vectors = [np.zeros(3), *(start.as_rotvec() for start in starts)]
    values = [left(vector) for vector in vectors]
    tried = []
    for k in np.argsort(values)[:_STARTS]:
        simplex = vectors[k] + 0.4 * np.vstack([np.zeros(3), np.eye(3)])
        options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-3, "maxfev": 120}
        tried.append(minimize(left, vectors[k], method="Nelder-Mead", options=options))
    turn = Rotation.from_rotvec(min(tried, key=lambda each: float(each.fun)).x)
    M, axis = turn.as_matrix(), turn.as_rotvec() / max(turn.magnitude(), 1e-12)
    entries = gyro_axes(given, column_map, rounded(M @ column_map.angular_velocity.R_BS))
    entries = {"attitude.R_BS": rounded(M @ column_map.attitude.R_BS), **entries}
    degrees = np.degrees(turn.magnitude())
    text = f"{OTHER_AXES}, turned by {degrees:.1f}° about {plain(rounded(axis, 2))}"
    yield Alternative(text, in_axes_of_base(given, M), tree, entries, _COMMON_TURN)
