"""Logged thrust in one block of the motion.

Thrusters apply the force f at B's origin and the torque τ about it, both in B. The log has their
values; they are constant from one sample to the next. With the system's mass m, its centre of mass
ρ from B's origin, and the common error s of the scale, Newton's and Euler's laws about the system's
centre of mass read, in W,

    L' = (1 + s) R (τ − ρ × f),      v' = (1 + s) R f / m,      1/m = (m_k − μ) / m_k²,

since μ = m_k m_T / m and m = m_k + m_T, with m_k the mass of the known bodies and m_T that of the
target. The acceleration therefore depends on the target's mass, unlike all that follows from the
conservation of momentum. To first order in a rotation ξ of the attitude in W and in changes of ρ,
of 1/m and of the scale,

    δL' = ξ × L' + (1 + s) R (f × δρ) + δs R (τ − ρ × f),
    δv' = ξ × v' + (1 + s) R f δ(1/m) + δs R f / m.

On a table, the torque about its normal and the force in its plane are all that acts.
Source: Hughes 2004, Spacecraft Attitude Dynamics, ch. 3.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.estimation.likelihood.uniform_spline import RampedSpline
from cpid_drake.sensing.measurements import Samples

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def inverse_mass(known_mass: float, mu: float) -> float:
    """Return 1/m of the system [1/kg], from the masses m_k and μ [kg]; see the module."""
    return (known_mass - mu) / known_mass**2


class BlockThrust:
    """The thrust in one block, and the integrals of its effects up to U instants.

    Args:
        log: samples [τ; f] (M, 6) [N·m, N], each of which holds until the next.
        nodes: (N,) times of the grid [s].
        times: (U,) instants from the first to the last node [s].
        grid: the known bodies' dynamics at the nodes.
        interpolation: returns the weights (Q, N) of the nodes at times (Q,).
        orbit: the orbit of W's origin; None for none.

    """

    def __init__(
        self,
        log: Samples,
        nodes: NDArray[np.float64],
        times: NDArray[np.float64],
        grid: RelativeDynamics,
        interpolation: Callable[[NDArray[np.float64]], NDArray[np.float64] | csr_array],
        orbit: Orbit | None = None,
    ) -> None:
        self._grid, self._nodes = grid, nodes
        is_free = grid.normal_B is None  # a table holds tilt and height
        self._turns = np.ones(3) if is_free else NORMAL_W
        self._moves = np.ones(3) if is_free else 1 - NORMAL_W
        inside = (log.time > nodes[0]) & (log.time < nodes[-1])
        edges = np.unique(np.concatenate([nodes, times, log.time[inside]]))
        held = log.held_at(edges[:-1])
        on = held.any(axis=1)
        length, first = np.diff(edges)[on], edges[:-1][on]
        points = first[:, None] + length[:, None] * (1 + _POINTS) / 2
        self._points, self._wrench = points.ravel(), np.repeat(held[on], len(_POINTS), axis=0)
        self._drift = _transition(nodes[0], times, orbit)
        self._pulled_back = np.linalg.inv(_transition(nodes[0], self._points, orbit))[:, :, 3:]
        self._weights = (length[:, None] * _WEIGHTS / 2).ravel()
        self._to_points = interpolation(self._points)
        ends = np.repeat(edges[1:][on], len(_POINTS))
        self._before = np.searchsorted(ends, times, side="right")
        before, after = log.held_at(log.time[inside], "left"), log.value[inside]
        switched = (before != after).any(axis=1)
        self._switches = log.time[inside][switched]
        self._jumps = (after - before)[switched]
        self._to_switches = interpolation(self._switches)

    # -- the motion --------------------------------------------------------------------------------

    def momentum(
        self, R: NDArray[np.float64], psi: NDArray[np.float64], scale: float
    ) -> NDArray[np.float64]:
        """Return the angular momentum (U, 3) that the thrust has added, in W [N·m·s].

        Args:
            R: (N, 3, 3) attitudes R_WB at the nodes.
            psi: (10,) relative unknowns of the target.
            scale: 1 + s.

        """
        return self._accumulated(self._torque(R, psi, scale))

    def travel(
        self, R: NDArray[np.float64], psi: NDArray[np.float64], scale: float
    ) -> NDArray[np.float64]:
        """Return what the thrust adds to position [m] and velocity [m/s] of the centre of mass.

        (U, 6) in W; the arguments are those of `momentum`.
        """
        return self._travelled(self._acceleration(R, psi, scale)[..., None])[0][..., 0]

    def spline(
        self,
        w: NDArray[np.float64],
        inverse: NDArray[np.float64],
        psi: NDArray[np.float64],
        scale: float,
    ) -> RampedSpline:
        """Return the spline of the angular velocity, whose slope jumps where the thrust does.

        Args:
            w: (N, 3) angular velocity at the nodes, in B [rad/s].
            inverse: (N, 3, 3) inverse of the system's inertia at the nodes, in B.
            psi, scale: see `momentum`.

        """
        rho = self._to_switches @ self._grid.com(psi)
        torque = self._jumps[:, :3] - cross(rho, self._jumps[:, 3:])
        J_inverse = (self._to_switches @ inverse.reshape(-1, 9)).reshape(-1, 3, 3)
        slopes = scale * rotate(J_inverse, torque)
        step = self._nodes[1] - self._nodes[0]
        return RampedSpline(self._nodes[0], step, w, self._switches, slopes)

    # -- derivatives -------------------------------------------------------------------------------

    def momentum_change(
        self,
        R: NDArray[np.float64],
        psi: NDArray[np.float64],
        scale: float,
        com: NDArray[np.float64],
        share: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the change (U, 3, n) of the angular momentum at unchanged attitude, in W.

        Args:
            R, psi, scale: see `momentum`.
            com: (N, 3, n) change of ρ at the nodes, in B.
            share: (n,) change of s.

        """
        n = com.shape[-1]
        moved = (self._to_points @ com.reshape(len(com), -1)).reshape(-1, 3, n)
        rate = scale * self._rotations(R) @ skew(self._wrench[:, 3:]) @ moved
        rate = self._turns[:, None] * rate + self._torque(R, psi, 1.0)[..., None] * share
        return self._accumulated(rate)

    def torque_by_attitude(
        self, R: NDArray[np.float64], psi: NDArray[np.float64], scale: float
    ) -> NDArray[np.float64]:
        """Return the mean derivative (N − 1, 3, 3) of L' by ξ in each step; see `momentum`."""
        added = self.momentum(R, psi, scale)[: len(self._nodes)]
        step = self._nodes[1] - self._nodes[0]
        return -skew(np.diff(added, axis=0)) / step

    def travel_change(
        self,
        R: NDArray[np.float64],
        psi: NDArray[np.float64],
        scale: float,
        xi: NDArray[np.float64],
        inverse_mass: NDArray[np.float64],
        share: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the changes of position and velocity of the centre of mass, in W.

        Args:
            R, psi, scale: see `momentum`.
            xi: (N, 3, n) change of the attitude at the nodes, a rotation in W.
            inverse_mass: (n,) change of 1/m.
            share: (n,) change of s.

        Returns:
            The changes (U, 6, n), and those at the start (6, n) that have the same effect at the
            end.

        """
        acceleration, force = self._acceleration(R, psi, scale), self._force(R, scale)
        turned = (self._to_points @ xi.reshape(len(xi), -1)).reshape(-1, 3, xi.shape[-1])
        rate = self._moves[:, None] * (-skew(acceleration) @ turned)
        rate += force[..., None] * inverse_mass
        rate += (acceleration / scale)[..., None] * share
        return self._travelled(rate)

    # -- at the points -----------------------------------------------------------------------------

    def _rotations(self, R: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((self._to_points @ R.reshape(-1, 9)).reshape(-1, 3, 3))

    def _torque(
        self, R: NDArray[np.float64], psi: NDArray[np.float64], scale: float
    ) -> NDArray[np.float64]:
        """Return L' (Q, 3)."""
        rho = self._to_points @ self._grid.com(psi)
        moment = self._wrench[:, :3] - cross(rho, self._wrench[:, 3:])
        return scale * self._turns * rotate(self._rotations(R), moment)

    def _force(self, R: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
        """Return the force (Q, 3) in W [N]."""
        return scale * self._moves * rotate(self._rotations(R), self._wrench[:, 3:])

    def _acceleration(
        self, R: NDArray[np.float64], psi: NDArray[np.float64], scale: float
    ) -> NDArray[np.float64]:
        """Return v' (Q, 3)."""
        return inverse_mass(self._grid.mass, float(psi[0])) * self._force(R, scale)

    def _accumulated(self, rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the integrals (U, ...) of rates (Q, ...) from the start to the instants."""
        weights = self._weights.reshape(-1, *[1] * (rates.ndim - 1))
        sums = np.cumsum(weights * rates, axis=0)
        return np.concatenate([np.zeros_like(rates[:1]), sums])[self._before]

    def _travelled(
        self, rates: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what accelerations (Q, 3, n) do to position and velocity, (U, 6, n).

        The second value is the change (6, n) of both at the start that does the same at the end.
        """
        at_start = self._accumulated(self._pulled_back @ rates)
        return self._drift @ at_start, at_start[len(self._nodes) - 1]


def _transition(
    start: float, times: NDArray[np.float64], orbit: Orbit | None
) -> NDArray[np.float64]:
    """Return the matrices (M, 6, 6) from position and velocity at the start to times (M,)."""
    if orbit is not None:
        return orbit.transition(start, times)
    Phi = np.tile(np.eye(6), (len(times), 1, 1))
    Phi[:, :3, 3:] = (times - start)[:, None, None] * np.eye(3)
    return Phi


def block_thrust(
    log: Samples,
    nodes: NDArray[np.float64],
    times: NDArray[np.float64],
    grid: RelativeDynamics,
    interpolation: Callable[[NDArray[np.float64]], NDArray[np.float64] | csr_array],
    orbit: Orbit | None = None,
) -> BlockThrust | None:
    """Return the thrust in a block; None if there is none. The arguments: see `BlockThrust`."""
    inside = (log.time > nodes[0]) & (log.time < nodes[-1])
    if not (log.value[inside].any() or log.held_at(nodes[0]).any()):
        return None
    return BlockThrust(log, nodes, times, grid, interpolation, orbit)
