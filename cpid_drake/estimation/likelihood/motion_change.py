"""First-order changes of the base's motion, and what follows from them.

Small changes ξ of the attitude, rotations in W, obey

    ξ̇ = R (δω + J⁻¹ Rᵀ (L × ξ + λ)),      λ̇ = ∂τ/∂ξ ξ,

with the change δω of the angular velocity at unchanged attitude, and the change λ of L because the
torque τ of gravity gradient, thrust and leaks changes with the attitude.
"""

from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.attitude_steps import carried, step_angles, step_changes
from cpid_drake.estimation.likelihood.motion_model import Trajectory


@dataclass(frozen=True, eq=False)
class MotionChange:
    """First-order change of the base's motion by n quantities, at U instants, first N nodes.

    Attributes:
        w: (N, 3, n) change of the angular velocity, in B: at unchanged attitude, until `response`
            adds that by the attitude.
        com: (U, 3, n) change of the centre of mass ρ from B's origin, in B.
        com_rate: (U, 3, n) change of the rate of ρ as seen from B, in B; (0, 3, n) if it is not
            needed.
        screw: (N, 6, n) small screws that displace the target against B, at B's origin, in B;
            (0, 6, n) if they are not needed.
        position, velocity: (U, 3, n) change of place and velocity of the system's centre of mass,
            in W; without that by the thrust, which follows from the others.
        attitude: (3, n) change of the attitude at the start, a rotation in W.
        L: (3, n) change of the angular momentum at the end at unchanged attitude, in W.
        inverse_mass: (n,) change of the inverse 1/m of the system's mass [1/kg].
        thrust: (P, n) change of the errors of the thrust, in the order of `Constants.acting`.
        delay: (n,) change of the delay of the thrust [s].

    """

    w: Array
    com: Array
    com_rate: Array
    screw: Array
    position: Array
    velocity: Array
    attitude: Array
    L: Array
    inverse_mass: Array
    thrust: Array
    delay: Array

    @classmethod
    def zeros(cls, trajectory: Trajectory, n: int, *, with_rates: bool = True) -> "MotionChange":
        """Return no change of a motion by n quantities; without rates of ρ if none are read."""
        motion = trajectory.motion
        nodes, instants = len(motion.nodes), len(motion.times)
        has_thrust, errors = motion.thrust is not None, len(motion.constants.acting["thrust"])
        com, position, velocity = np.zeros((3, instants, 3, n))
        w, rate = np.zeros((nodes, 3, n)), np.zeros((instants * with_rates, 3, n))
        screw, (attitude, L) = np.zeros((nodes * has_thrust, 6, n)), np.zeros((2, 3, n))
        (inverse, delay), thrust = np.zeros((2, n)), np.zeros((errors, n))
        return cls(w, com, rate, screw, position, velocity, attitude, L, inverse, thrust, delay)

    def columns(self, part: slice) -> "MotionChange":
        """Return views of some columns."""
        return MotionChange(**{name: value[..., part] for name, value in vars(self).items()})

    def take(self, by: MotionSensitivity, trajectory: Trajectory) -> None:
        """Become a sensitivity."""
        self.w[:], self.com[:] = by.w[: len(self.w)], by.com
        self.screw[:] = by.screw[: len(self.screw)]
        if len(self.com_rate):
            # v = −(ω × ρ + ρ'), so δρ' = ρ × δω − ω × δρ − δv
            rho = trajectory.motion.dynamics.com(trajectory.state.psi)
            self.com_rate[:] = skew(rho) @ by.w - skew(trajectory.w) @ by.com - by.v


def response(trajectory: Trajectory, change: MotionChange) -> tuple[MotionChange, Array, Array]:
    """Return what follows from a change of the motion.

    Returns:
        The change with ω, position and velocity that include the effects of attitude and thrust; ξ
        (N, 3, n) at the nodes; and the change (12, n) of the state at the end, which is that of
        attitude (a rotation in W), centre of mass, L and velocity.

    """
    psi, thrust, N = trajectory.state.psi, trajectory.motion.thrust, len(change.w)
    R, L, w = trajectory.R[:N], change.L, change.w
    if thrust is not None:  # δL = ∫ δL' dt, and δω = J⁻¹ Rᵀ δL
        by = thrust.momentum_change(R, psi, change)
        w, L = w + trajectory.w_by_L @ by[:N], L + by[N - 1]
    xi, torqued, w = pose_change(trajectory, w, change)
    # rotors s turn with the base: their −δ(R s) = (R s) × ξ is that of the other bodies
    L = L + torqued + skew(R[-1] @ trajectory.rotors[N - 1]) @ xi[-1]
    position, velocity = change.position, change.velocity
    if thrust is not None:
        both = thrust.travel_change(R, psi, xi, change)
        position, velocity = position + both[:, :3], velocity + both[:, 3:]
    end = np.concatenate([xi[-1], position[N - 1], L, velocity[N - 1]])
    return replace(change, w=w, position=position, velocity=velocity), xi, end


def pose_change(
    trajectory: Trajectory, w: Array, change: MotionChange
) -> tuple[Array, Array, Array]:
    """Integrate the change of the attitude.

    R δω is integrated as the attitude is, the other terms by the trapezoidal rule.

    Args:
        trajectory: to linearize about.
        w: (N, 3, n) δω at the nodes, in B, with that by the thrust.
        change: the change.

    Returns:
        ξ (N, 3, n); λ at the end (3, n); and the total change of the angular velocity (N, 3, n).

    """
    motion, initial, N = trajectory.motion, change.attitude, len(w)
    h = motion.nodes[1] - motion.nodes[0]
    R, L, w_by_L = trajectory.R[:N], trajectory.L[:N], trajectory.w_by_L
    theta = step_angles(trajectory.spline.steps(), trajectory.w[:N], h)
    late = trajectory.spline.steps_by_delay()[..., None] * change.delay
    turned = step_changes(R, trajectory.w[:N], theta, w, h, late)
    # the change of ω is δω + B [ξ; λ], with B = J⁻¹ Rᵀ [L× 1]; without torques λ is zero
    B = w_by_L @ skew(L)
    if not motion.torques:
        A = R @ B
        xi = carried(A[:-1], A[1:], turned, initial, h)
        return xi, np.zeros_like(initial), w + B @ xi
    # [ξ̇; λ̇] = A [ξ; λ] + [R δω; 0], with A = [R B; ∂τ/∂ξ 0]
    B, A = np.concatenate([B, w_by_L], axis=-1), np.zeros((N, 6, 6))
    A[:, :3] = R @ B
    first, last = A[:-1].copy(), A[1:].copy()
    for torque in motion.torques:
        for ends, by in zip((first, last), torque.by_attitude(R, trajectory.state), strict=True):
            ends[:, 3:, :3] += by
    start = np.vstack([initial, np.zeros_like(initial)])
    both = carried(first, last, np.hstack([turned, np.zeros_like(turned)]), start, h)
    return both[:, :3], both[-1, 3:], w + B @ both
