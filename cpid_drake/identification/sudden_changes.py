"""Finds the time at which the momentum or the target changes in a log that is otherwise exact.

The momentum rows of all samples have one target and one momentum. If rows with a second momentum,
or a second target, from some time on explain the samples clearly better, there was a change.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.rows import STANDARD_ROWS
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.momentum_rows import momentum_rows
from cpid_drake.identification.rate_conventions import CLEARLY, EXPLAINS, unexplained_share
from cpid_drake.identification.row_estimator import complete_samples
from cpid_drake.sensing.measurements import Measurements

_MOST_SAMPLES = 200
_FEWEST_SAMPLES = 30
_STARTS = np.linspace(0.1, 0.9, 33)
_LENGTHS = (0.0, 0.025, 0.05, 0.1, 0.2, 0.3)
"""Lengths of a change, as shares of the log; samples during the change are left out."""

_EQUAL = 1.5
"""Ratio of residuals up to which the shortest change is preferred."""


def sudden_change(tree: KinematicTree, measurements: Measurements) -> str:
    """Return what changes in a log, and when; empty if one change does not explain the samples.

    Args:
        tree: the known spacecraft.
        measurements: screened samples of all sensors at the same times, joints in the spacecraft's
            order.

    """
    if not (len(measurements.attitude) and len(measurements.position)):
        return ""  # rows with an unknown momentum need both
    telemetry = complete_samples(measurements, STANDARD_ROWS)
    if telemetry is None or len(telemetry) < _FEWEST_SAMPLES:
        return ""
    telemetry = telemetry.select(slice(0, None, -(-len(telemetry) // _MOST_SAMPLES)))
    rows = momentum_rows(tree, telemetry, STANDARD_ROWS, TotalMomentum.unknown())
    time = np.repeat(telemetry.time, len(rows) // len(telemetry))
    k = STANDARD_ROWS.momentum_size
    start, length = time[0], time[-1] - time[0]
    found = []
    for share, place, is_target in product(_LENGTHS, _STARTS, (False, True)):
        begin, end = start + length * place, start + length * (place + share)
        if place + share <= _STARTS[-1]:
            error, before = _with_change(rows, time, k, begin, end, is_target)
            if error < min(EXPLAINS, before / CLEARLY):
                found.append((error, begin, end, is_target))
    if not found:
        return ""
    least = min(error for error, *_ in found)
    _, begin, end, is_target = next(each for each in found if each[0] <= _EQUAL * least)
    step = length * float(_STARTS[1] - _STARTS[0])
    when = f"between {begin - step:.2f} s and {end + step:.2f} s"
    if is_target:
        return f"the target changes {when}: it slips in the grasp, or the last joint does"
    return f"the momentum changes {when}: a force acts, for example that of a thruster"


def _with_change(
    rows: NDArray[np.float64],
    time: NDArray[np.float64],
    k: int,
    begin: float,
    end: float,
    is_target: bool,
) -> tuple[float, float]:
    """Return the unexplained shares of the rows outside of an interval, with and without a change.

    Args:
        rows: (m, k + 11) [N | A | b].
        time: (m,) times of the rows [s].
        k: number of columns of the momentum.
        begin, end: the interval [s].
        is_target: whether the target changes; else the momentum does.

    """
    used = (time <= begin) | (time >= end)
    rows, after = rows[used], time[used] > begin
    changing = rows[:, k:-1] if is_target else rows[:, :k]
    A, b = rows[:, :-1], rows[:, -1]
    both = np.hstack([A, changing * after[:, None]])
    return unexplained_share(both, b), unexplained_share(A, b)
