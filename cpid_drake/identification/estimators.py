"""The registry of estimators. The command line, reports and studies read it.

To add an estimator, write a function from the `problem.Problem` of each log to a
`solved.SolvedIdentification`, and put its record here; see `problem.Estimator`.
"""

from cpid_drake.dynamics.rows import ROW_FAMILIES, RowFamily, row_family
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.by_rows import LEAST_SQUARES
from cpid_drake.identification.fitted import TRAJECTORY_FIT
from cpid_drake.identification.online import RECURSIVE_FIT
from cpid_drake.identification.problem import Estimator

ESTIMATORS: dict[str, Estimator] = {
    record.name: record for record in (LEAST_SQUARES, RECURSIVE_FIT, TRAJECTORY_FIT)
}
"""The estimators by name."""


def estimator_label(name: str) -> str:
    """Return the label of an estimator in reports; the name itself if it is unknown."""
    return ESTIMATORS[name].label if name in ESTIMATORS else name


def methods() -> tuple[str, ...]:
    """Return all names that `choose_method` accepts: row families, then estimators without rows."""
    others = tuple(name for name, record in ESTIMATORS.items() if record.default_rows is None)
    return (*ROW_FAMILIES, *others)


def choose_method(
    estimator: str | None,
    rows: str | None,
    momentum: TotalMomentum,
    has_sensors: bool,
    has_thrust: bool = False,
) -> tuple[Estimator, RowFamily | None]:
    """Return the record of an estimator, and the row family if one is named.

    Args:
        estimator: name of an estimator, or of a row family (least squares on these rows); None for
            the estimator that is best for these data.
        rows: name of a row family; None for the estimator's default.
        momentum: the total momentum.
        has_sensors: whether the sensors' errors are known.
        has_thrust: whether the log says that thrusters fired.

    Raises:
        InputError: no such estimator or rows, rows for an estimator that uses none, or an estimator
            that cannot handle this momentum.

    """
    if estimator is None:
        best = [name for name, record in ESTIMATORS.items() if record.prefers_sensors]
        is_fit = (has_sensors or has_thrust) and rows is None
        estimator = best[0] if is_fit else LEAST_SQUARES.name
    if estimator in ROW_FAMILIES:
        if rows not in (None, estimator):
            raise InputError(
                f"estimator '{estimator}' is least squares on rows '{estimator}', not '{rows}'; "
                "give one of the two"
            )
        estimator, rows = LEAST_SQUARES.name, estimator
    if estimator not in ESTIMATORS:
        choices = ", ".join((*ESTIMATORS, *ROW_FAMILIES))
        raise InputError(f"no estimator '{estimator}'; choose from {choices}")
    record = ESTIMATORS[estimator]
    if momentum.name not in record.momenta:
        allowed = " or ".join(record.momenta)
        raise InputError(f"{record.name} needs a total momentum that is {allowed}")
    if rows is None:
        return record, None
    if record.default_rows is None:
        raise InputError(f"rows are for least_squares; {estimator} has none: leave rows out")
    return record, row_family(rows, momentum.is_unknown)
