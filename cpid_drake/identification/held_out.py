"""Prediction of the end of a log by fits of its beginning, with and without proposed errors.

A sum of errors that explains a log may do so by chance, or because it imitates another cause. Such
a fit does not predict samples that were not used better than the fit without these errors.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.estimation.block_queue import BlockQueue
from cpid_drake.estimation.prediction import Prediction, predicted
from cpid_drake.estimation.trajectory_fit import blocks_of
from cpid_drake.identification.effects import HeldOut
from cpid_drake.identification.error_fit import LogPart, fit_errors

SHARE = 2 / 3
"""Share of a log to which the models are fitted."""


def held_out(
    proposed: Sequence[LogPart],
    plain: Sequence[LogPart],
    psi: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> HeldOut | None:
    """Return how well two models predict the last third of each log from the other two thirds.

    Both errors of a prediction are divided by the same covariance, that of the proposed model's:
    otherwise the model that is less certain would seem better.

    Args:
        proposed: the logs, with sensors that declare the proposed errors.
        plain: the same logs without these.
        psi: (10,) the target of each model, near which its fits start.

    Returns:
        The comparison; None if a log is too short, or cannot be predicted.

    """
    try:
        cuts = [_cut(part) for part in plain]
        pairs = list(zip(_predicted(proposed, psi[0], cuts), _predicted(plain, psi[1], cuts)))
    except (InputError, ValueError, np.linalg.LinAlgError):
        return None
    squares, count = np.zeros(2), 0
    for better, other in pairs:
        for name in better.sensors.keys() & other.sensors.keys():
            own, without = better.sensors[name], other.sensors[name]
            _, i, j = np.intersect1d(own.time, without.time, return_indices=True)
            same = replace(own, time=own.time[i], error=own.error[i], covariance=own.covariance[i])
            squares += same.squares.sum(), replace(same, error=without.error[j]).squares.sum()
            count += same.error.size
    if not count or not np.isfinite(squares).all():
        return None
    seconds = sum(better.end - better.start for better, _ in pairs)
    return HeldOut(seconds, count, *(squares / count).tolist())


def _cut(part: LogPart) -> float:
    """Return the end of the last block in the first part of a log [s].

    Raises:
        InputError: there is no such block.

    """
    assert part.problem.sensors is not None
    blocks = list(blocks_of(BlockQueue.of(part.problem.sensors), part.problem.stream))
    ends = [block.end for block in blocks]
    if len(ends) < 2:
        raise InputError("the log is too short to predict a part of it")
    limit = blocks[0].start + SHARE * (ends[-1] - blocks[0].start)
    earlier = [end for end in ends[:-1] if end <= limit]
    return earlier[-1] if earlier else ends[0]


def _predicted(
    parts: Sequence[LogPart], psi: NDArray[np.float64], cuts: Sequence[float]
) -> list[Prediction]:
    """Return the prediction of each log after a time by a fit of all logs up to it."""
    heads = [part.problem.log.head for part in parts]
    beginnings = [
        replace(part, problem=part.problem.with_measurements(head.between(-np.inf, cut)))
        for part, head, cut in zip(parts, heads, cuts)
    ]
    fit = fit_errors(beginnings, psi)
    rows = fit.selection.target_rows
    found = []
    for k, (estimator, head, cut) in enumerate(zip(fit.estimators, heads, cuts)):
        blocks = blocks_of(BlockQueue.of(estimator.solver.suite), [head])
        constants = fit.selection.of_log(k, fit.constants)
        found.append(predicted(estimator, fit.psi, rows, blocks, cut, constants))
    return found
