"""Logged thrust in one block of the motion.

The actuators of `actuators` push with forces f at points a from B's origin, with moments τ beside;
all are constant from one sample to the next. With the system's mass m and its centre of mass ρ from
B's origin, Newton's and Euler's laws about the system's centre of mass read, in W,

    L' = Σ R τ + R (a − ρ) × f,      v' = Σ f / m,      1/m = (m_k − μ) / m_k²,

since μ = m_k m_T / m and m = m_k + m_T, with m_k the mass of the spacecraft and m_T that of the
target. The acceleration therefore depends on the target's mass, unlike all that follows from the
conservation of momentum. To first order in a rotation ξ of the attitude in W, and in changes of ρ
and of 1/m,

    δL' = ξ × L' + Σ f × R δρ,      δv' = ξ × v' + Σ f δ(1/m),

but a force that is given in W does not rotate with ξ: its parts are (ξ × R (a − ρ)) × f and zero.

On a table, the torque about its normal and the force in its plane are all that acts.
Source: Hughes 2004, Spacecraft Attitude Dynamics, ch. 3.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from cpid_drake.array import Array
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.plane import NORMAL_W
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.estimation.likelihood.actuators import Actuators, ThrustLog
from cpid_drake.estimation.likelihood.uniform_spline import GAUSS_LEGENDRE, RampedSpline

if TYPE_CHECKING:  # their modules import this one
    from cpid_drake.estimation.likelihood.motion_change import MotionChange
    from cpid_drake.estimation.likelihood.motion_model import BaseMotion, TrajectoryState

Weights = Callable[[Array], Array | csr_array]
"""Returns the weights (Q, N) of the nodes at times (Q,)."""

Pose = Callable[[Array], tuple[Array, Array]]
"""Returns R_BC (Q, 3, 3) and p_BC (Q, 3) at times (Q,)."""


def inverse_mass(known_mass: float, mu: float) -> float:
    """Return 1/m of the system [1/kg], from the masses m_k and μ [kg]; see the module."""
    return (known_mass - mu) / known_mass**2


class Push:
    """V actuators of amplitudes (Q, V) at Q instants."""

    def __init__(
        self, actuators: Actuators, size: Array, times: Array, to: Weights, pose: Pose
    ) -> None:
        self.in_world, self.to = actuators.in_world, to(times)
        arm = np.broadcast_to(actuators.position, (len(times), *actuators.position.shape))
        along, self._moment = actuators.direction[None], actuators.moment
        self.on_target = on = actuators.on_target
        if on.any():
            R_BC, p_BC = pose(times)
            turned = actuators.position @ np.swapaxes(R_BC, -1, -2)
            arm = np.where(on[:, None], p_BC[:, None] + turned, arm)
            turned = actuators.direction @ np.swapaxes(R_BC, -1, -2)
            along = np.where((on & ~self.in_world)[:, None], turned, along)
        self._arm, self._along = arm, np.broadcast_to(along, arm.shape)
        fixed, given = size * ~self.in_world, size * self.in_world
        self._force_B, self._force_W = _sum(fixed, self._along), given @ actuators.direction
        self._torque_B = _sum(fixed, cross(arm, self._along)) + size @ self._moment
        self._arm_force_W = np.swapaxes(arm * given[..., None], 1, 2) @ actuators.direction

    def rotations(self, R: Array) -> Array:
        """Return R_WB (Q, 3, 3), from those at the nodes (N, 3, 3)."""
        return np.asarray((self.to @ R.reshape(-1, 9)).reshape(-1, 3, 3))

    def force(self, R: Array) -> Array:
        """Return the force (Q, 3) of all together, in W."""
        return rotate(self.rotations(R), self._force_B) + self._force_W

    def torque(self, R: Array, com: Array) -> Array:
        """Return the torque (Q, 3) of all about the system's centre of mass, in W.

        Of the forces in W, it is the skew part of R Σ a fᵀ.
        """
        turned = self.rotations(R)
        force = rotate(turned, self._force_B) + self._force_W
        given = (turned @ self._arm_force_W).reshape(-1, 9)
        torque = rotate(turned, self._torque_B) + given[:, [5, 6, 1]] - given[:, [7, 2, 3]]
        return np.asarray(torque - cross(rotate(turned, self.to @ com), force))

    def forces(self, R: Array) -> Array:
        """Return f (Q, V, 3) of unit amplitudes, in W."""
        turned = self._along @ np.swapaxes(self.rotations(R), -1, -2)
        return np.where(self.in_world[:, None], self._along, turned)

    def arms(self, R: Array, com: Array) -> Array:
        """Return the points (Q, V, 3) from the system's centre of mass, in W."""
        rho = np.asarray(self.to @ com)[:, None]
        return np.asarray((self._arm - rho) @ np.swapaxes(self.rotations(R), -1, -2))

    def torques(self, R: Array, com: Array) -> Array:
        """Return the torques (Q, V, 3) of unit amplitudes, likewise."""
        turned = self._moment @ np.swapaxes(self.rotations(R), -1, -2)
        return turned + cross(self.arms(R, com), self.forces(R))


class BlockThrust:
    """The thrust in the motion of one block, and the integrals of its effects up to U instants.

    Its methods take attitudes R_WB (N, 3, 3) at the nodes, and the target's ψ (10,) or the state.
    """

    def __init__(self, log: ThrustLog, motion: "BaseMotion") -> None:
        nodes, times, orbit = motion.nodes, motion.times, motion.orbit
        self._grid, self._nodes, samples = motion.grid, nodes, log.samples
        is_free = self._grid.normal_B is None  # a table holds tilt and height
        self._turns = np.ones(3) if is_free else NORMAL_W
        self._moves = np.ones(3) if is_free else 1 - NORMAL_W
        inside = (samples.time > nodes[0]) & (samples.time < nodes[-1])
        before, after = samples.held_at(samples.time[inside], "left"), samples.value[inside]
        switched = (before != after).any(axis=1)
        switches, jumps = samples.time[inside][switched], (after - before)[switched]
        edges = np.unique(np.concatenate([nodes, times, samples.time[inside]]))
        place = np.searchsorted(samples.time, edges[:-1], side="right") - 1
        on = (place >= 0) & samples.value[place].any(axis=1)
        place, length, first = place[on], np.diff(edges)[on], edges[:-1][on]
        x, weights = GAUSS_LEGENDRE
        each = np.repeat(place, len(x))
        points = (first[:, None] + length[:, None] * (1 + x) / 2).ravel()
        weights = (length[:, None] * weights / 2).ravel()
        ends = np.repeat(edges[1:][on], len(x))
        size, self._by = samples.value[each], log.by[each]
        self._weights = weights * (ends <= times[:, None])
        at = motion.interpolation, motion.capture_pose
        self._push = Push(log.actuators, size, points, *at)
        self._size = size
        self._drift = transition(nodes[0], times, orbit)
        self._pulled_back = np.linalg.inv(transition(nodes[0], points, orbit))[:, :, 3:]
        self._switches = switches
        self._since = (switches < times[:, None]).astype(float)
        self._switched_back = np.linalg.inv(transition(nodes[0], switches, orbit))[:, :, 3:]
        self._at_switches = Push(log.actuators, jumps, switches, *at)

    # -- the motion --------------------------------------------------------------------------------

    def momentum(self, R: Array, state: "TrajectoryState") -> Array:
        """See `TurningTorque`."""
        return self._accumulated(self._turns * self._push.torque(R, self._grid.com(state.psi)))

    def travel(self, R: Array, psi: Array) -> Array:
        """Return what the thrust adds to position [m] and velocity [m/s] (U, 6), in W."""
        # v' = Σ f / m
        force = self._moves * self._push.force(R)
        return self._travelled(self._inverse_mass(psi) * force[..., None])[..., 0]

    def spline(self, w: Array, inverse: Array, R: Array, psi: Array) -> RampedSpline:
        """Return the spline of the angular velocity, whose slope jumps where the thrust does.

        Args:
            w: (N, 3) angular velocity at the nodes, in B [rad/s].
            inverse: (N, 3, 3) inverse of the system's inertia at the nodes, in B.
            R, psi: see the class.

        """
        # ω' jumps by J⁻¹ Rᵀ ΔL'
        push = self._at_switches
        torque = push.torque(R, self._grid.com(psi))
        torque = rotate(np.swapaxes(push.rotations(R), -1, -2), torque)
        J_inverse = (push.to @ inverse.reshape(-1, 9)).reshape(-1, 3, 3)
        step = self._nodes[1] - self._nodes[0]
        slopes = rotate(J_inverse, torque)
        return RampedSpline(self._nodes[0], step, w, self._switches, slopes)

    # -- derivatives -------------------------------------------------------------------------------

    def momentum_change(self, R: Array, psi: Array, change: "MotionChange") -> Array:
        """Return the change (U, 3, n) of the angular momentum at unchanged attitude, in W."""
        # δL' = Σ f × R δρ + ∂L'/∂e δe, and by the screws
        com, delay = change.com[: len(R)], change.delay
        moved = (self._push.to @ com.reshape(len(com), -1)).reshape(-1, 3, com.shape[-1])
        rate = skew(self._push.force(R)) @ self._push.rotations(R) @ moved
        rate += self._by_screw(R, psi, change.screw)[0]
        if len(change.thrust):
            rate += self._by_errors(self._push.torques(R, self._grid.com(psi))) @ change.thrust
        added = self._accumulated(self._turns[:, None] * rate)
        if delay.any():  # what every switch has added comes later
            torque = self._turns * self._at_switches.torque(R, self._grid.com(psi))
            added -= (self._since @ torque)[..., None] * delay
        return added

    def by_attitude(self, R: Array, state: "TrajectoryState") -> tuple[Array, Array]:
        """See `TurningTorque`; it may change within a step, both of whose ends have its mean."""
        push, com = self._push, self._grid.com(state.psi)
        # ξ × L' of forces that turn with the base
        by_turn = -skew(_sum(self._size * ~push.in_world, push.torques(R, com)))
        if push.in_world.any():  # (ξ × R (a − ρ)) × f: the point turns, and not the force
            given = self._size * push.in_world
            f, r = skew(push.forces(R)), skew(push.arms(R, com))
            by_turn += np.einsum("qv,qvij->qij", given, f @ r)
        added = self._accumulated(self._turns[:, None] * by_turn)[: len(self._nodes)]
        mean = np.diff(added, axis=0) / (self._nodes[1] - self._nodes[0])
        return mean, mean

    def travel_change(self, R: Array, psi: Array, xi: Array, change: "MotionChange") -> Array:
        """Return the changes (U, 6, n) of position and velocity of the centre of mass, in W.

        With ξ (N, 3, n), the change of the attitude at the nodes, a rotation in W.
        """
        # δv' = (ξ × Σ f + ∂Σf/∂e δe) / m + Σ f δ(1/m), and by the screws
        forces, turning = self._push.forces(R), self._size * ~self._push.in_world
        turned = (self._push.to @ xi.reshape(len(xi), -1)).reshape(-1, 3, xi.shape[-1])
        rate = self._by_screw(R, psi, change.screw)[1] - skew(_sum(turning, forces)) @ turned
        if len(change.thrust):
            rate += self._by_errors(forces) @ change.thrust
        rate *= self._inverse_mass(psi)
        rate += self._push.force(R)[..., None] * change.inverse_mass
        travelled = self._travelled(self._moves[:, None] * rate)
        if change.delay.any():
            force = self._moves * self._inverse_mass(psi) * self._at_switches.force(R)
            late = self._drift @ (self._since @ rotate(self._switched_back, force))[..., None]
            travelled -= late * change.delay
        return travelled

    # -- at the points -----------------------------------------------------------------------------

    def _by_screw(self, R: Array, psi: Array, screw: Array) -> tuple[Array | float, Array | float]:
        """Return the changes (Q, 3, n) of torque and force by screws (N, 6, n) of the target.

        A screw [θ; d] moves a point a of the target by θ × a + d, and turns its forces.
        """
        push, com, on = self._push, self._grid.com(psi), self._push.on_target
        if not on.any():
            return 0.0, 0.0
        at_points = (push.to @ screw.reshape(len(screw), -1)).reshape(-1, 6, screw.shape[-1])
        turn, move = (push.rotations(R) @ part for part in np.split(at_points, 2, axis=1))
        f = skew(self._size[:, on, None] * push.forces(R)[:, on])
        turned = f * ~push.in_world[on, None, None]
        a, r = (skew(push.arms(R, each)[:, on]) for each in (0 * com, com))
        torque = (f @ a - r @ turned).sum(axis=1) @ turn - f.sum(axis=1) @ move
        return torque, -turned.sum(axis=1) @ turn

    def _inverse_mass(self, psi: Array) -> float:
        return inverse_mass(self._grid.mass, float(psi[0]))

    def _by_errors(self, units: Array) -> Array:
        """Return the derivative (Q, 3, P) of this sum by the errors of the thrust."""
        return np.asarray(np.einsum("qvp,qvi->qip", self._by, units))

    def _accumulated(self, rates: Array) -> Array:
        """Return the integrals (U, ...) of rates (Q, ...) from the start to the instants."""
        sums = self._weights @ rates.reshape(len(rates), -1)
        return np.asarray(sums.reshape(-1, *rates.shape[1:]))

    def _travelled(self, rates: Array) -> Array:
        """Return what accelerations (Q, 3, n) do to position and velocity, (U, 6, n)."""
        return self._drift @ self._accumulated(self._pulled_back @ rates)


def _sum(size: Array, units: Array) -> Array:
    """Return the sums (Q, 3) over all actuators (Q, V, 3), of amplitudes (Q, V)."""
    return np.asarray(np.einsum("qv,qvi->qi", size, units))


def transition(start: float, times: Array, orbit: Orbit | None) -> Array:
    """Return the matrices (M, 6, 6) from position and velocity at the start to times (M,)."""
    if orbit is not None:
        return orbit.transition(start, times)
    Phi = np.tile(np.eye(6), (len(times), 1, 1))
    Phi[:, :3, 3:] = (times - start)[:, None, None] * np.eye(3)
    return Phi
