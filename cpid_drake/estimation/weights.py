"""Weights of samples and noise factors of sensors, as the residuals show them.

Samples that are far off weigh less, by the loss of `least_squares.loss_weight`. A sensor's noise
factor is 1 or more.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.estimation.joints import DECLARED
from cpid_drake.estimation.least_squares import loss_weight
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.sensors import SENSORS

MOST_LOST = 0.9
"""Share of a sensor's residuals that unknowns absorb at most: else none would show the noise."""


def reweighted(
    model: Model, log: LogState, rolled: Rolled, absorbed: dict[str, float] | None
) -> LogState:
    """Return a log with the weights and noise factors that its residuals show.

    Args:
        model: the unknowns.
        log: before.
        rolled: its prediction.
        absorbed: see `Swept`; None if the noise stays.

    """
    weights, noise, shares = [dict(each) for each in log.weights], dict(log.noise), {}
    past = log.past.noise if log.past else {}
    residuals = rolled.all_residuals()
    count = sum(rest.size for rest in residuals.values())
    sampled = {f"{name}.{BIAS}" for name in residuals}
    biases = sum(each.size for each in model.table if each.name in sampled)
    free = 0 if log.past else 12 + 10 + biases
    plain = replace(log, noise={}, weights=tuple({} for _ in log.blocks))
    for name, rest in residuals.items():
        w = weights_of(rest) if name in SENSORS else np.ones(len(rest))  # a force is no outlier
        ends = np.cumsum([len(block[name]) for block in rolled.residuals if name in block])[:-1]
        parts = iter(np.split(w, ends))
        for k, block in enumerate(rolled.residuals):
            if name in block:
                weights[k][name] = next(parts)
        if absorbed is None:
            continue
        rest = np.concatenate([
            plain.whitened(k, name, block[name])
            for k, block in enumerate(rolled.residuals) if name in block
        ])
        near = rest[w == 1.0]  # what is far off says nothing about the noise
        lost = min(free / count + absorbed.get(name, 0.0) / rest.size, MOST_LOST)
        shares[name] = 1 - lost
        sums = past.get(name, 0.0) + np.array([np.sum(near**2), near.size * shares[name]])
        square, freedom = DECLARED + sums
        noise[name] = max(1.0, float(np.sqrt(square / freedom)))
    log = replace(log, freedom=shares) if shares else log
    return replace(log, weights=tuple(weights), noise=noise)


def weights_of(rest: NDArray[np.float64], noise: float = 1.0) -> NDArray[np.float64]:
    """Return the weights (M,) that residuals (M, d) show; samples that are far off weigh less.

    Args:
        rest: in units of the declared σ.
        noise: factor of this σ.

    """
    size = np.sqrt(np.mean(rest**2, axis=1))
    return loss_weight(size / max(spread(rest), noise, 1e-12))


def spread(rest: NDArray[np.float64]) -> float:
    """Return the σ of residuals (M, d), whatever less than half of them are; 0 without any."""
    square = np.sum(rest**2, axis=1)
    return float(np.sqrt(np.median(square) / chdtri(rest.shape[1], 0.5))) if len(square) else 0.0
