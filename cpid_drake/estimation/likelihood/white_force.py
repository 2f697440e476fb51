"""White torque and acceleration, such as those of an air-bearing floor: means over short pieces.

White noise of the size σ has the mean N(0, σ²/h) over a piece of the length h, independent of all
others. These means, in units of their σ, are unknowns of a block, and their prior is a reading of
zero, so that its noise factor and its robust weights come about as those of sensors do.

Source: Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications, ch. 6.2 (piecewise
constant white acceleration).
"""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.sensors.suite import SensorSuite

PIECE = 0.5
"""Length of a piece [s]: attitude and position show no shorter ones."""

SHORTEST_PIECE = 0.05
"""A gyro shows a torque in each of its samples; pieces are not shorter than this [s]."""

TORQUE_NOISE, ACCELERATION_NOISE = "torque_noise", "acceleration_noise"
"""Names of the two kinds: as effects, and as readings."""


class WhiteForce:
    """White torque about the system's centre of mass, or white acceleration of it, in W.

    Attributes:
        size: number of entries, those of each piece together.
        rows: their places in `TrajectoryState.forces`.
        middles: of the pieces [s].
        axes: (d, 3) of the entries of a piece.

    Args:
        name: `TORQUE_NOISE` or `ACCELERATION_NOISE`.
        sigma: its size [N·m·√s or m/s²·√s].
        piece: length of a piece [s].
        first: place of its first entry in `TrajectoryState.forces`.
        start, end: of the block [s].
        is_planar: whether a table holds tilt and height.

    """

    def __init__(
        self,
        name: str,
        sigma: float,
        piece: float,
        first: int,
        start: float,
        end: float,
        is_planar: bool,
    ) -> None:
        self.name, self._start, self._length = name, start, end - start
        self.pieces = max(1, round(self._length / piece))
        turn, move = (NORMAL_W[None], np.eye(3)[:2]) if is_planar else (np.eye(3), np.eye(3))
        self._h = self._length / self.pieces
        self.axes = turn if name == TORQUE_NOISE else move
        self._axes = sigma / np.sqrt(self._h) * self.axes
        self.size = self.pieces * len(self.axes)
        self.rows = slice(first, first + self.size)
        self.middles = start + self._h * (np.arange(self.pieces) + 0.5)

    def impulse(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative (U, 3, size) of the integral from the start by the entries."""
        return self._by_entries(np.clip(self._since(times), 0.0, self._h))

    def travel(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative (U, 3, size) of the integral of this integral."""
        t = np.maximum(self._since(times), 0.0)
        inside = np.minimum(t, self._h)
        return self._by_entries(inside**2 / 2 + self._h * (t - inside))

    def _since(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        return times[:, None] - self._start - self._h * np.arange(self.pieces)

    def _by_entries(self, shares: NDArray[np.float64]) -> NDArray[np.float64]:
        by = shares[:, None, :, None] * self._axes.T[:, None]
        return by.reshape(len(shares), 3, self.size)


def white_forces(suite: SensorSuite, start: float, end: float, is_planar: bool) -> list[WhiteForce]:
    """Return the white forces that a suite declares, in a block from start to end [s]."""
    found: list[WhiteForce] = []
    steps = [1 / each.rate for each in suite.present().values() if isinstance(each, Gyro)]
    pieces = {TORQUE_NOISE: max(min([PIECE, *steps]), SHORTEST_PIECE), ACCELERATION_NOISE: PIECE}
    for name, piece in pieces.items():
        sigma = float(getattr(suite.disturbances, name, 0.0))
        if sigma > 0:
            first = found[-1].rows.stop if found else 0
            found.append(WhiteForce(name, sigma, piece, first, start, end, is_planar))
    return found
