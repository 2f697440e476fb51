"""Forces on the system that are not logged: steady ones, and white ones such as those of a floor.

White noise of the size σ has the mean N(0, σ²/h) over a piece of the length h, independent of all
others. These means, in units of their σ, are unknowns of a block, and their prior is a reading of
zero, so that its noise factor comes about as that of a sensor does. A steady force is one piece as
long as the block; it is a constant error, which may walk.

Source: Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications, ch. 6.2 (piecewise
constant white acceleration).
"""

from typing import TYPE_CHECKING

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.sensors.suite import SensorSuite

if TYPE_CHECKING:  # its module imports this one
    from cpid_drake.estimation.likelihood.motion_model import BaseMotion, TrajectoryState

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
        name: of the white force, or of the constant error.
        turns: whether it is a torque.
        axes: (d, 3) of the entries of a piece.
        sigma: of each entry [N·m or m/s²].
        pieces: their number.
        rows: places of the entries in `TrajectoryState.forces` or, of a steady force, `constants`.
        start, end: of the block [s].

    """

    def __init__(
        self,
        name: str,
        turns: bool,
        axes: Array,
        sigma: float,
        pieces: int,
        rows: slice,
        start: float,
        end: float,
    ) -> None:
        self.name, self.axes, self.pieces, self.rows = name, axes, pieces, rows
        self.size, self.turns = pieces * len(axes), turns
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
            turns = name == TORQUE_NOISE
            made.append(Force(name, turns, axes, mean, count, rows, start, end))
            first = rows.stop
    return made


def steady_forces(constants: Constants, start: float, end: float) -> list[Force]:
    """Return the steady forces among constant errors, in a block from start to end [s]."""
    return [
        Force(e.name, turns, e.effect.how.T, e.sigma, 1, constants.place(e.name), start, end)
        for way, turns in (("acceleration_W", False), ("torque_W", True))
        for e in constants.acting[way]
    ]


class TurningTorque:
    """The torque of the gravity gradient, and that of errors which rotates with the base.

    Its methods take attitudes R_WB (N, 3, 3) at the nodes of a motion, and the state.
    """

    def __init__(self, motion: "BaseMotion") -> None:
        self._motion = motion

    def momentum(self, R: Array, state: "TrajectoryState") -> Array:
        """Return the angular momentum (U, 3) that it has added, in W [N·m·s]."""
        motion = self._motion
        torque = rotate(R, motion.constants.sum(state.constants, "", "torque_B", 3))
        if motion.orbit is not None:
            torque += motion.orbit.torque(self._inertia(R, state.psi), motion.nodes)
        return motion.at_instants(motion.accumulated(torque))

    def by_attitude(self, R: Array, state: "TrajectoryState") -> tuple[Array, Array]:
        """Return the derivatives (N − 1, 3, 3) of the torque by ξ at both ends of each step."""
        motion = self._motion
        # R τ becomes R τ + ξ × R τ
        by = -skew(rotate(R, motion.constants.sum(state.constants, "", "torque_B", 3)))
        if motion.orbit is not None:
            by += motion.orbit.torque_by_attitude(self._inertia(R, state.psi), motion.nodes)
        return by[:-1], by[1:]

    def _inertia(self, R: Array, psi: Array) -> Array:
        """Return the system's inertia (N, 3, 3) in W: R J Rᵀ."""
        return np.asarray(R @ self._motion.grid.inertia(psi) @ np.swapaxes(R, -1, -2))
