"""Residuals of a fit over time, without those of outliers."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled
from cpid_drake.logs.log import Samples


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
            near = state.weights.get(sensor, np.ones(len(samples))) == 1.0
            times.append(samples.time[near])
            values.append(rest[sensor][near])
    return Samples(np.concatenate(times), np.concatenate(values or [np.empty((0, 1))]))
