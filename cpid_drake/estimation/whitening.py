"""What makes the residuals of a log white: the noise of its sensors, with weights of samples."""

from collections.abc import Mapping

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.process import DECLARED, Innovations
from cpid_drake.sensors.sensors import SENSORS


def whitened(log: LogState, k: int, sensor: str, rest: Array) -> Array:
    """Return white residuals (M, d) of those (M, d) of a sensor in block k."""
    return white_residuals(log, k, {sensor: rest})[sensor][: len(rest)]


def white_residuals(log: LogState, k: int, rest: Mapping[str, Array]) -> dict[str, Array]:
    """Return white residuals of those (M, d) in block k, and of the links of slow noise."""
    slow, places, rows = log.slow_at(k), log.noise.slow_places, {}
    for name, white in whiteners(log, k, rest).items():
        own = rest.get(name, np.zeros((0, white.process.channels)))
        rows[name] = white.of(own, *slow[:, places.get(name, slice(0))])
    return rows


def whiteners(log: LogState, k: int, rest: Mapping[str, Array]) -> dict[str, Innovations]:
    """Return what makes the residuals of block k white, and links slow noise."""
    made = {name: whitener(log, k, name, len(each)) for name, each in rest.items()}
    for name in log.noise.slow_places:
        if name not in rest:
            made[name] = whitener(log, k, name, 0)
    return made


def whitener(log: LogState, k: int, sensor: str, count: int) -> Innovations:
    """Return what makes the residuals of a sensor, or of a white force, in block k white."""
    state = log.states[k]
    block = state.block
    if sensor in SENSORS:
        times = block.samples[sensor].time if count else np.zeros(0)
    else:  # of a force: the middles of its pieces
        times = block.start + (np.arange(count) + 0.5) * block.length / max(count, 1)
    weights = state.weights.get(sensor, np.ones(count))[:count]
    until_next = block.end - block.start + (state.link.gap if state.link else 0.0)
    process = log.noise.processes.get(sensor, DECLARED)
    return Innovations(times, block.start, block.start + until_next, weights, process)
