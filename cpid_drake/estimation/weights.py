"""Weights of samples and the noise of sensors, as the residuals show them.

Samples that are far off weigh less, by the loss of `least_squares.loss_weight`. The noise is that
of the largest evidence; see `noise`.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import loss_weight
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise import are_near, with_processes
from cpid_drake.estimation.process import DECLARED
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.sensors import SENSORS

SAME = 1e-2
"""Change of a weight or of a noise factor that does not matter."""

MOST_LOST = 0.9
"""Share of a sensor's residuals that unknowns absorb at most: else none would show the noise."""


def reweighted(
    model: Model,
    log: LogState,
    rolled: Rolled,
    values: Values,
    absorbed: dict[str, float] | None,
) -> LogState:
    """Return a log with the weights and noise that its residuals show.

    Args:
        model: the unknowns.
        log: before.
        rolled: its prediction.
        values: of all unknowns.
        absorbed: see `Swept.absorbed`; None if the noise stays.

    """
    log = _weighted(log, rolled)
    if absorbed is None:
        return log
    own, shares = model.of_log(log.name), {}
    sampled = {f"{name}.{BIAS}" for name in absorbed}
    biases = sum(each.size for each in own.table if each.name in sampled)
    # unknowns of the whole log: those at its start, the target, biases
    free = 0 if log.past else 12 + 10 + biases
    for name, rest in rolled.all_residuals().items():
        lost = absorbed.get(name, 0.0) / rest.size
        # Freedom of a residual: 1 − what unknowns absorb of it.
        shares[name] = 1 - min(lost + free / rolled.count, MOST_LOST)
    return with_processes(model, log.with_noise(freedom=shares), rolled, values)


def _weighted(log: LogState, rolled: Rolled) -> LogState:
    """Return a log with the weights that its residuals show."""
    weights = [dict(each.weights) for each in log.states]
    for name, rest in rolled.all_residuals().items():
        if name in SENSORS:  # a force is no outlier
            process = log.noise.processes.get(name, DECLARED)
            w = weights_of(rest, float(np.sqrt(max(process.total, 1.0))))
        else:
            w = np.ones(len(rest))
        ends = np.cumsum([len(block[name]) for block in rolled.residuals if name in block])[:-1]
        parts = iter(np.split(w, ends))
        for k, block in enumerate(rolled.residuals):
            if name in block:
                weights[k][name] = next(parts)
    return log.with_each(weights=weights)


def are_same(logs: Sequence[LogState], others: Sequence[LogState]) -> bool:
    """Return whether logs have nearly the same weights and noise."""
    for log, other in zip(logs, others, strict=True):
        if not are_near(log.noise.processes, other.noise.processes):
            return False
        for before, after in zip(log.states, other.states, strict=True):
            for name in {*before.weights, *after.weights}:
                change = np.subtract(before.weights.get(name, 1.0), after.weights.get(name, 1.0))
                if np.max(np.abs(change), initial=0.0) > SAME:
                    return False
    return True


def weights_of(rest: Array, noise: float = 1.0) -> Array:
    """Return the weights (M,) that residuals (M, d) show; samples that are far off weigh less.

    Args:
        rest: in units of the declared σ.
        noise: factor of this σ.

    """
    size = np.sqrt(np.mean(rest**2, axis=1))
    return loss_weight(size / max(spread(rest), noise, 1e-12))


def spread(rest: Array) -> float:
    """Return the σ of residuals (M, d), whatever less than half of them are; 0 without any."""
    square = np.sum(rest**2, axis=1)
    # The median of |r|²/σ² is that of χ² with d degrees of freedom.
    return float(np.sqrt(np.median(square) / chdtri(rest.shape[1], 0.5))) if len(square) else 0.0
