"""Forces on the system that are not logged: steady ones, and white ones such as those of a floor.

White noise of the size σ has the mean N(0, σ²/h) over a piece of the length h, independent of all
others. These means, in units of their σ, are unknowns of a block, and their prior is a reading of
zero, so that its noise factor and its robust weights come about as those of sensors do. A steady
force is one piece as long as the block; it is a constant error, which may walk.

Source: Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications, ch. 6.2 (piecewise
constant white acceleration).
"""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.estimation.likelihood.constants import ACCELERATION, TORQUE, Constants
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.sensors.suite import SensorSuite

PIECE = 0.5
"""Length of a piece [s]: attitude and position show no shorter ones."""

SHORTEST_PIECE = 0.05
"""A gyro shows a torque in each of its samples; pieces are not shorter than this [s]."""

TORQUE_NOISE, ACCELERATION_NOISE = "torque_noise", "acceleration_noise"
"""Names of the two white forces: as effects, and as readings."""


class Force:
    """A torque about the system's centre of mass, or an acceleration of it, in W.

    It is constant in each of some pieces of a block; the first and the last go on outside.

    Attributes:
        size: number of entries, those of each piece together.
        turns: whether it is a torque.
        middles: of the pieces [s].

    Args:
        name: `TORQUE`, `ACCELERATION`, `TORQUE_NOISE` or `ACCELERATION_NOISE`.
        axes: (d, 3) of the entries of a piece.
        sigma: of each entry [N·m or m/s²].
        pieces: their number.
        rows: places of the entries in `TrajectoryState.forces` or, of a steady force, `constants`.
        start, end: of the block [s].

    """

    def __init__(
        self,
        name: str,
        axes: Array,
        sigma: float,
        pieces: int,
        rows: slice,
        start: float,
        end: float,
    ) -> None:
        self.name, self.axes, self.pieces, self.rows = name, axes, pieces, rows
        self.size, self.turns = pieces * len(axes), name in (TORQUE, TORQUE_NOISE)
        self._axes, self._start, self._h = sigma * axes, start, (end - start) / pieces
        self.middles = start + self._h * (np.arange(pieces) + 0.5)
        self._least, self._most = np.zeros(pieces), np.full(pieces, self._h)
        self._least[0], self._most[-1] = -np.inf, np.inf

    def impulse(self, times: Array) -> Array:
        """Return the derivative (U, 3, size) of the integral from the start by the entries."""
        return self._by_entries(np.clip(self._since(times), self._least, self._most))

    def travel(self, times: Array) -> Array:
        """Return the derivative (U, 3, size) of the integral of this integral."""
        t = np.maximum(self._since(times), self._least)
        inside = np.minimum(t, self._most)
        return self._by_entries(inside**2 / 2 + self._h * (t - inside))

    def _since(self, times: Array) -> Array:
        return times[:, None] - self._start - self._h * np.arange(self.pieces)

    def _by_entries(self, shares: Array) -> Array:
        by = shares[:, None, :, None] * self._axes.T[:, None]
        return by.reshape(len(shares), 3, self.size)


def white_forces(suite: SensorSuite, start: float, end: float, is_planar: bool) -> list[Force]:
    """Return the white forces that a suite declares, in a block from start to end [s].

    On a table, which holds tilt and height, they have no other entries.
    """
    made, first = list[Force](), 0
    turn, move = (NORMAL_W[None], np.eye(3)[:2]) if is_planar else (np.eye(3), np.eye(3))
    steps = [1 / each.rate for each in suite.present().values() if isinstance(each, Gyro)]
    pieces = {TORQUE_NOISE: max(min([PIECE, *steps]), SHORTEST_PIECE), ACCELERATION_NOISE: PIECE}
    for (name, piece), axes in zip(pieces.items(), (turn, move), strict=True):
        sigma = float(getattr(suite.disturbances, name, None) or 0.0)
        if sigma > 0:
            count = max(1, round((end - start) / piece))
            rows = slice(first, first + count * len(axes))
            mean = sigma / np.sqrt((end - start) / count)
            made.append(Force(name, axes, mean, count, rows, start, end))
            first = rows.stop
    return made


def steady_forces(constants: Constants, start: float, end: float) -> list[Force]:
    """Return the steady forces among constant errors, in a block from start to end [s]."""
    return [
        Force(name, np.eye(3), error.sigma, 1, constants.place(name), start, end)
        for name, error in constants.errors.items()
        if name in (ACCELERATION, TORQUE)
    ]
