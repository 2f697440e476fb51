"""Bias of a gyro: piecewise linear in time, with the prior of a random walk."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.sensors import Gyro

_SMALLEST_SIGMA = 1e-9
"""Smallest σ of the constant part [rad/s]; with it the prior of a gyro without bias is finite."""


class GyroBias:
    """The bias of one gyro at K nodes: one node for a constant bias, else one node per second.

    Args:
        gyro: its errors.
        start: first time [s].
        end: last time [s].

    Attributes:
        nodes: (K,) times [s].
        rows: place of the nodes in `TrajectoryState.bias`.

    """

    def __init__(self, gyro: Gyro, start: float, end: float) -> None:
        self._gyro = gyro
        self.nodes = np.array([start])
        if gyro.bias_growth:
            self.nodes = np.linspace(start, end, int(np.ceil(end - start)) + 1)
        self.rows = slice(0, len(self.nodes))

    def columns(self, first: int) -> slice:
        """Return the columns of the bias, where the columns of all biases start at `first`."""
        return slice(first + 3 * self.rows.start, first + 3 * self.rows.stop)

    def weights(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (M, K) weights of the nodes at times (M,)."""
        if len(self.nodes) == 1:
            return np.ones((len(times), 1))
        units = np.eye(len(self.nodes))
        return np.stack([np.interp(times, self.nodes, unit) for unit in units], axis=1)

    def prior(self) -> NDArray[np.float64]:
        """Return the square-root information (3 K, 3 K) of the bias.

        The first node has the σ of the constant part. The difference of two neighbouring nodes has
        a σ that grows with the square root of the time between them.
        """
        K = len(self.nodes)
        matrix = np.zeros((K, K))
        matrix[0, 0] = 1 / max(self._gyro.bias_sigma, _SMALLEST_SIGMA)
        if K > 1:
            sigma = self._gyro.bias_growth * np.sqrt(np.diff(self.nodes))
            rows = np.arange(1, K)
            matrix[rows, rows], matrix[rows, rows - 1] = 1 / sigma, -1 / sigma
        return np.asarray(np.kron(matrix, np.eye(3)))
