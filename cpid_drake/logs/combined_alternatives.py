"""Several conventions of a log at once: together they explain what no single one explains.

A position in another unit, or of another point, and a gyro that is late hide what is right about
the joints: without them, the joints are found, and the position is then a single convention.
Units of two quantities are never free together: a motion that both make vanish is none that
the momentum explains.
"""

from collections.abc import Iterator

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.alternatives import Alternative, alternatives
from cpid_drake.logs.attitude_alternatives import turned_axes
from cpid_drake.logs.column_map import ColumnMap, with_entries
from cpid_drake.logs.instants import Instants

_ATTITUDE = {"attitude.order", "attitude.direction"}
_GYRO = {"angular_velocity.frame", "angular_velocity.unit"}
_UNITS = {"joint_positions.unit", "joint_rates.unit"}
_ORDERS = {"joint_positions.columns", "joint_rates.columns"}
_SIGNS = {"reversed_joints"}


def attitude_alternatives(
    given: Instants, tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield orders, directions, frames and turned axes of attitude and gyro, also together."""
    yield from alternatives(given, (), tree, column_map, _ATTITUDE | _GYRO)
    for text, log, entries in turned_axes(given, column_map):
        yield Alternative(text, log, tree, entries)
    yield from turned_attitudes(given, tree, column_map)


def turned_attitudes(
    given: Instants, tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield other orders and directions of the attitude, together with turned axes."""
    for each in alternatives(given, (), None, column_map, _ATTITUDE):
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
