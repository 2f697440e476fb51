"""The conventions of a log that positions and rates, or the momentum, contradict."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.rows import RELATIVE_ROWS, STANDARD_ROWS
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.files.errors import InputError
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification import by_rows
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog, check_log
from cpid_drake.identification.checks import CONSERVATION
from cpid_drake.identification.estimators import with_method
from cpid_drake.identification.row_checks import LEAST_SQUARES
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.log import Log
from cpid_drake.logs.unlogged_joints import lock_unlogged
from cpid_drake.spacecraft.spacecraft import Spacecraft


@one_thread
def check_as_read(log: Log, spacecraft: Spacecraft | None) -> CheckedLog:
    """Return a checked log, with the conventions that it contradicts as it is read.

    Args:
        log: the log.
        spacecraft: with its joints; None to check what the log alone shows.

    Raises:
        InputError: see `check_log`.

    """
    if spacecraft is None:
        return check_log(None, log)
    spacecraft, fixed = lock_unlogged(spacecraft, log.joint_names)
    checked = check_log(spacecraft, log)
    checked = replace(checked, notes=(*checked.notes, *fixed))
    rows = RELATIVE_ROWS.name, STANDARD_ROWS.name  # without the position, and with it
    return with_conventions(checked, Arguments(spacecraft), rows)


def with_conventions(log: CheckedLog, arguments: Arguments, rows: Sequence[str] = ()) -> CheckedLog:
    """Return a log with the convention that the momentum shows, unless noise explains the log.

    In a short log many conventions explain a smooth motion; the misfit of rows is relative to the
    noise. On a table, the plane's few equations do not distinguish conventions.

    Args:
        log: the log, and what positions and rates alone contradict.
        arguments: the spacecraft, the sensors and its bodies.
        rows: the row families of which one contradicts the log as read, by their residuals or by
            a negative mass, which noise in rows makes, too; none for the best by its residuals.

    """
    conventions, tree = log.conventions, arguments.spacecraft.tree
    if conventions.failures or conventions.has_momentum or tree.normal_B is not None:
        return log
    better = check_conventions(log.measurements, tree)
    if not better.better:
        return log
    sections = {key.partition(".")[0] for each in better.better for key in each.entries}
    if not rows and not arguments.rows and sections == {"position"}:
        rows = [STANDARD_ROWS.name]  # others do not contain it
    if not any(_contradicts(log, arguments, each) for each in rows or (None,)):
        return log
    return replace(log, conventions=replace(better, not_compared=conventions.not_compared))


def _contradicts(log: CheckedLog, arguments: Arguments, rows: str | None) -> bool:
    """Return whether rows of a log as read contradict it; see `with_conventions`."""
    coasting = log.measurements.between(-np.inf, log.measurements.first_burn)
    logs, unknown = {"": replace(log, measurements=coasting)}, TotalMomentum.unknown()
    rows_of = replace(arguments, estimator=LEAST_SQUARES, rows=rows, prior=None, momentum=unknown)
    with suppress(np.linalg.LinAlgError, InputError):  # too few samples
        of_rows = by_rows.estimate(with_method(rows_of, logs), logs)
        misfit, mass = of_rows.check(CONSERVATION), of_rows.parameters[0]
        is_impossible = rows is not None and mass < -3 * np.sqrt(of_rows.covariance[0, 0])
        return bool(is_impossible or (misfit is not None and not misfit.passed))
    return False
