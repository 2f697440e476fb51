"""Several conventions of a log at once: together they explain what no single one explains.

A position in another unit, or of another point, hides what is right about the joints: without it,
the joints are found, and the position is then a single convention.
Units of two quantities are never free together: a motion that both make vanish is none that
the momentum explains.
"""

from collections.abc import Collection, Iterator, Sequence

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


def of_attitude(given: Instants, column_map: ColumnMap) -> Iterator[Alternative]:
    """Yield orders and directions of the attitude, frames and units of the gyro."""
    yield from alternatives(given, (), None, column_map, _ATTITUDE | _GYRO)


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
            yield each.then(Alternative(text, log, tree, entries))


def joint_alternatives(
    given: Instants, names: tuple[str, ...], tree: KinematicTree, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield unit, order and sign of joints, all of them or some; see `alternatives`."""
    yield from together(as_read(given, tree), names, column_map, (_UNITS, _ORDERS, _SIGNS))


def as_read(given: Instants, tree: KinematicTree | None) -> Alternative:
    """Return a log as it is read, of which no convention differs."""
    return Alternative("", given, tree, {}, 0)


def together(
    base: Alternative,
    names: tuple[str, ...],
    column_map: ColumnMap,
    groups: Sequence[Collection[str]],
) -> Iterator[Alternative]:
    """Yield a reading with other values of keys of a map: of each group one alternative, or none.

    Args:
        base: the reading to change; it is the first.
        names: the joints.
        column_map: the map of which `base` has other entries.
        groups: keys of a map; see `alternatives`.

    """
    yield base
    reached = [base]
    for keys in groups:
        others = list[Alternative]()
        for each in reached:
            changed = with_entries(column_map, each.entries)
            for other in alternatives(each.log, names, each.tree, changed, keys):
                others.append(each.then(other))
                yield others[-1]
        reached += others
