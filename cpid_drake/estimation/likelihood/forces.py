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
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.estimation.likelihood.constants import Constants
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
        Force(e.name, e.effect.how, np.eye(3), e.sigma, 1, constants.place(e.name), start, end)
        for e in constants.acting["force"]
    ]


class TurningTorque:
    """A torque about the system's centre of mass that changes with the attitude.

    It is that of the gravity gradient, and one that rotates with the base.

    Args:
        in_B: (3,) the latter, in B [N·m].
        orbit: the orbit of W's origin; None for none.
        psi: (10,) relative unknowns of the target.
        grid: the spacecraft's dynamics at the nodes.
        nodes: (N,) times [s].

    """

    def __init__(
        self, in_B: Array, orbit: Orbit | None, psi: Array, grid: BodyDynamics, nodes: Array
    ) -> None:
        self._in_B, self._orbit, self._nodes = in_B, orbit, nodes
        self._J: Array = np.empty(0) if orbit is None else grid.inertia(psi)

    def at(self, R: Array) -> Array:
        """Return the torque (N, 3) at attitudes R_WB (N, 3, 3), in W [N·m]."""
        torque = rotate(R, self._in_B)
        if self._orbit is not None:
            torque += self._orbit.torque(R @ self._J @ np.swapaxes(R, -1, -2), self._nodes)
        return torque

    def by_attitude(self, R: Array) -> Array:
        """Return the derivative (N, 3, 3) by a rotation in W: of R τ, it is −(R τ)×."""
        by = -skew(rotate(R, self._in_B))
        if self._orbit is not None:
            J_W = R @ self._J @ np.swapaxes(R, -1, -2)
            by += self._orbit.torque_by_attitude(J_W, self._nodes)
        return by
