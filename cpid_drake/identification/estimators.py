"""The registry of estimators. The command line and reports read it.

To add an estimator, write a function from `Arguments` and from checked logs, by their names, to a
`result.Identification`, and put its record here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.identification import by_rows, fitted, online_answer
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.fitted import TRAJECTORY_FIT
from cpid_drake.identification.online_answer import RECURSIVE_FIT
from cpid_drake.identification.result import Identification
from cpid_drake.identification.row_checks import LEAST_SQUARES
from cpid_drake.sensors.sensors import SENSORS


@dataclass(frozen=True)
class Estimator:
    """A record of an estimator.

    Attributes:
        name: its name on the command line, in result files and in scenarios.
        label: its name in reports.
        good_for: its recommended use, in one sentence.
        estimate: its function of the arguments, of the logs by their names, and
            of a callback for progress. It raises an `InputError` if there are too few samples, or
            if it cannot use a prior or several logs.
        uses_rows: whether it uses momentum rows, which have neither the log of thrust nor the
            uncertainty of the spacecraft; else it uses all samples as they are.

    """

    name: str
    label: str
    good_for: str
    estimate: Callable[
        [Arguments, Mapping[str, CheckedLog], Callable[[str], object]], Identification
    ]
    uses_rows: bool = False


ESTIMATORS: dict[str, Estimator] = {
    record.name: record
    for record in (
        Estimator(
            LEAST_SQUARES,
            "least squares on momentum rows",
            "exact logs of any length; a quick look, with noise ten times or more less accurate",
            by_rows.estimate,
            uses_rows=True,
        ),
        Estimator(
            RECURSIVE_FIT,
            "recursive fit (maximum likelihood, online)",
            "an estimate online from noisy sensors; finds firings of thrusters",
            online_answer.estimate,
        ),
        Estimator(
            TRAJECTORY_FIT,
            "trajectory fit (maximum likelihood)",
            "the best estimate from noisy sensors, after the motion; finds firings of thrusters",
            fitted.estimate,
        ),
    )
}
"""The estimators by name."""


def estimator_label(name: str) -> str:
    """Return the label of an estimator in reports; the name itself if it is unknown."""
    return ESTIMATORS[name].label if name in ESTIMATORS else name


def methods() -> tuple[str, ...]:
    """Return the names on offer for `with_method`: row families, then estimators without rows."""
    others = tuple(name for name, record in ESTIMATORS.items() if not record.uses_rows)
    return (*ROW_FAMILIES, *others)


def choose(arguments: Arguments, logs: Mapping[str, CheckedLog]) -> tuple[Estimator, Arguments]:
    """Return the estimator, and the arguments with its name and that of its rows.

    Raises:
        InputError: see `with_method`; a log lacks what the estimator needs.

    """
    arguments = with_method(arguments, logs)
    for log in logs.values():
        with prefix_errors(log.label):
            _require_sensors(log, arguments)
    return ESTIMATORS[arguments.estimator or ""], arguments


def with_method(arguments: Arguments, logs: Mapping[str, CheckedLog]) -> Arguments:
    """Return the arguments, with names of the estimator and of its rows, if it uses any.

    What is not named is what is best for these logs.

    Raises:
        InputError: no such estimator, or rows for an estimator that uses none.

    """
    estimator, rows = arguments.estimator, arguments.rows
    # An error of the base's velocity enters all standard rows of a sample, and no relative one.
    measured = [log.counts for log in logs.values()]
    is_complete = all(count.get("joint_rates") and count.get("velocity") for count in measured)
    best = "standard" if is_complete and arguments.sensors is None else "relative"
    if estimator is None:
        tree, family = arguments.spacecraft.tree, ROW_FAMILIES[best]
        has_files = any(log.states is None for log in logs.values())
        is_fit = arguments.sensors is not None or (arguments.known_bodies is not None and has_files)
        is_fit = is_fit or any(
            log.measurements.has_thrust or by_rows.is_measured(log, tree, family)
            for log in logs.values()
        )
        estimator = TRAJECTORY_FIT if is_fit and rows is None else LEAST_SQUARES
    if estimator in ROW_FAMILIES:
        if rows not in (None, estimator):
            raise InputError(
                f"estimator '{estimator}' is least squares on rows '{estimator}', not '{rows}'; "
                "give one of the two"
            )
        estimator, rows = LEAST_SQUARES, estimator
    if estimator not in ESTIMATORS:
        choices = ", ".join((*ESTIMATORS, *ROW_FAMILIES))
        raise InputError(f"no estimator '{estimator}'; choose from {choices}")
    if ESTIMATORS[estimator].uses_rows:
        rows = rows or best
    elif rows is not None:
        raise InputError(f"rows are for least_squares; {estimator} has none: leave rows out")
    return replace(arguments, estimator=estimator, rows=rows)


def _require_sensors(log: CheckedLog, arguments: Arguments) -> None:
    """Refuse a log without samples, or errors, of a sensor that the estimator needs."""
    needs: tuple[tuple[str, ...], ...] = (("encoders",), ("attitude",))
    family = arguments.family
    if family is not None:
        needs = by_rows.needs_of_rows(family, arguments.momentum or TotalMomentum.zero())
    present = log.counts if log.sensors is None else log.sensors.present()
    for choice in needs:
        if choice == ("encoders",) and not log.measurements.joint_names:
            continue
        if any(log.counts.get(name) and name in present for name in choice):
            continue
        text = " or ".join(SENSORS[name].description for name in choice)
        is_logged = any(log.counts.get(name) for name in choice)
        reason = "is not one of the given sensors" if is_logged else "the log has no samples of"
        who = f"{arguments.estimator} with {family.name} rows" if family else arguments.estimator
        raise InputError(f"{who} needs {text}, which {reason}; see `cpid list estimators`")
