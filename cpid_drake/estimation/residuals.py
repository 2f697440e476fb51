"""Residuals of a fit over time, without those of outliers, and what they sum up to."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled
from cpid_drake.estimation.whiteness import LagSums
from cpid_drake.estimation.whitening import whitened
from cpid_drake.logs.log import Samples


@dataclass(frozen=True, eq=False)
class ResidualSums:
    """Sums over the samples of a sensor, to which those of further blocks are added.

    Attributes:
        used: number of samples with their whole weight.
        rejected: number of those that weigh less or not at all.
        lags: sums over products of white residuals of those that are used.

    """

    used: int = 0
    rejected: int = 0
    lags: LagSums = field(default_factory=LagSums)


def with_blocks(
    sums: Mapping[str, ResidualSums], log: LogState, rolled: Rolled
) -> dict[str, ResidualSums]:
    """Return sums by sensor with those of the blocks of a log.

    Args:
        sums: of earlier blocks.
        log: the blocks with the weights of their samples.
        rolled: the prediction of these and, it may be, of further blocks.

    """
    used, count, white = Counter[str](), Counter[str](), defaultdict[str, list[Array]](list)
    for k, (state, rest) in enumerate(zip(log.states, rolled.residuals)):
        for name, samples in state.block.samples.samples.items():
            is_near = state.weights.get(name, np.ones(len(samples.time))) == 1.0
            used[name] += int(is_near.sum())
            count[name] += len(is_near)
            if name in rest:
                white[name].append(whitened(log, k, name, rest[name])[is_near])
    more = dict(sums)
    for name, n in count.items():
        before = sums.get(name) or ResidualSums()
        lags = before.lags.added(np.concatenate(white[name])) if name in white else before.lags
        far = before.rejected + n - used[name]
        more[name] = ResidualSums(before.used + used[name], far, lags)
    return more


def near_residuals(log: LogState, rolled: Rolled, sensor: str) -> Samples:
    """Return the residuals (N, d) of a sensor's samples that do not weigh less, in σ.

    Args:
        log: the blocks with the weights of their samples.
        rolled: their prediction.
        sensor: name of the sensor.

    """
    times, values = [np.empty(0)], list[Array]()
    for state, rest in zip(log.states, rolled.residuals, strict=True):
        if sensor in rest:
            samples = state.block.samples[sensor]
            is_near = state.weights.get(sensor, np.ones(len(samples))) == 1.0
            times.append(samples.time[is_near])
            values.append(rest[sensor][is_near])
    return Samples(np.concatenate(times), np.concatenate(values or [np.empty((0, 1))]))
