"""Effects: the unknown or uncertain quantities on which the base's motion and the readings depend.

Each effect has some columns of the Jacobian, and a function that writes the derivatives of the
motion by its quantities into a change, which contains zeros; what readings change at the same
motion is a matter of their sensors. Every quantity is in units of its σ, except ψ, the start and
the joints' coefficients.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.estimation.likelihood.constants import ConstantError
from cpid_drake.estimation.likelihood.forces import Force
from cpid_drake.estimation.likelihood.kinematic_changes import mapped
from cpid_drake.estimation.likelihood.motion_change import MotionChange
from cpid_drake.estimation.likelihood.motion_model import Trajectory
from cpid_drake.estimation.likelihood.thrust import inverse_mass, transition

Write = Callable[[Trajectory, MotionChange], None]
"""Writes the change of the motion by the quantities of an effect."""

WriteError = Callable[[ConstantError, Trajectory, MotionChange], None]
"""Writes that by a constant error."""


def write_start(trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of attitude, centre of mass, L about it and its velocity at the start, in W."""
    motion = trajectory.motion
    change.attitude[:, :3] = change.L[:, 6:9] = np.eye(3)
    change.w[:, :, 6:9] = trajectory.w_by_L
    # rotors s turn with the base: δ(R s) = ξ × R s
    change.L[:, :3] = -skew(trajectory.state.attitude.as_matrix() @ trajectory.rotors[0])
    change.w[:, :, :3] = trajectory.w_by_L @ change.L[:, :3]
    # [δp; δv] = Φ(t) [δp₀; δv₀]
    drift = transition(motion.joints.start, motion.times, motion.orbit)
    for moved, by in zip((change.position, change.velocity), np.split(drift, 2, axis=1)):
        moved[:, :, 3:6], moved[:, :, 9:] = by[:, :, :3], by[:, :, 3:]


def write_joints(trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of errors of the coefficients of the joints' splines, joint after joint."""
    motion = trajectory.motion
    bases = [motion.joints.basis(motion.times, order)[:, None, None] for order in range(2)]
    by_q, by_qdot = trajectory.by["q"], trajectory.by["qdot"]

    def by_errors(name: str, count: int) -> Array:
        each = (getattr(by, name)[:count, ..., None] for by in (by_q, by_qdot))
        q, qdot = (by * basis[:count] for by, basis in zip(each, bases, strict=True))
        q += qdot
        return np.asarray(q.reshape(*q.shape[:2], np.prod(q.shape[2:])))

    U, rates = len(motion.times), len(change.com_rate)
    counts = {"w": rates or len(change.w), "com": U, "v": rates, "screw": len(change.screw)}
    by = MotionSensitivity(**{name: by_errors(name, count) for name, count in counts.items()})
    change.take(by, trajectory)


def write_force(force: Force, trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of the entries of a force."""
    motion = trajectory.motion
    # δL = ∫ τ dt and δω = J⁻¹ Rᵀ δL; δv = ∫ a dt and δp = ∫∫ a dt²
    impulse = force.impulse(motion.times)
    if force.turns:
        change.w[:] = trajectory.w_by_L @ impulse[: len(change.w)]
        change.L[:] = impulse[len(motion.nodes) - 1]
    else:
        change.position[:], change.velocity[:] = force.travel(motion.times), impulse


def write_target(trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of the ten relative unknowns ψ = (μ, μc, I_*)."""
    motion = trajectory.motion
    dynamics, N = motion.dynamics, len(motion.nodes)
    # J ω + h = Rᵀ L is Y(ω) ψ + ..., so δω = −J⁻¹ Y δψ
    change.w[:] = -trajectory.inverse[:N] @ motion.grid.regressor(trajectory.w[:N])
    if motion.orbit is not None:
        # ∂L/∂ψ = ∫ ∂τ/∂ψ dt at unchanged attitude, of τ = 3 n² r × J r
        r_W = motion.orbit.nadir(motion.nodes)
        r = rotate(np.swapaxes(trajectory.R[:N], -1, -2), r_W)
        torque = skew(r_W) @ trajectory.R[:N] @ motion.grid.inertia_regressor(r)
        added = motion.accumulated(3 * motion.orbit.n**2 * torque)
        change.w[:] += trajectory.w_by_L @ added
        change.L[:] = added[-1]
    change.com[:, :, :4] = dynamics.com_regressor()
    if len(change.com_rate):
        change.com_rate[:, :, :4] = dynamics.com_rate_regressor()
    # 1/m = (m_k − μ) / m_k²
    change.inverse_mass[0] = -(dynamics.mass**-2)


def write_bodies(trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of errors of the spacecraft's bodies and of their geometry."""
    motion = trajectory.motion
    uncertainty = motion.known_bodies
    assert uncertainty is not None
    sigmas = uncertainty.all_sigmas(motion.tree.wheels, motion.joints.coefficients.shape[1])
    change.take(trajectory.by["bodies"], trajectory)
    # masses m (1 + σ e), and the derivative of 1/m of the system by them
    mu, masses = float(trajectory.state.psi[0]), np.zeros(len(sigmas))
    bodies = [body.mass for body in motion.tree.bodies]
    masses[: 10 * len(bodies) : 10] = uncertainty.mass * np.array(bodies)
    by_masses = -masses[sigmas > 0] * inverse_mass(motion.dynamics.mass, mu) ** 2
    change.inverse_mass[:] = by_masses / (1 + uncertainty.mass * motion.body_errors)


def _force_W(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    write_force(trajectory.motion.forces[error.name], trajectory, change)


def _torque_B(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    motion = trajectory.motion
    # ∂L/∂τ = ∫ R dt of a torque τ in B
    R = trajectory.R[: len(motion.nodes)]
    impulse = error.sigma * motion.accumulated(R @ error.effect.how)
    change.w[:], change.L[:] = trajectory.w_by_L @ impulse, impulse[-1]


def _rotors_B(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    in_B = np.broadcast_to(error.sigma * error.effect.how, (len(change.w), *change.L.shape))
    _momentum(in_B, trajectory, change)


def _rotors_C(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    in_B = trajectory.motion.grid.R_BC @ error.effect.how
    _momentum(error.sigma * in_B, trajectory, change)


def _momentum(in_B: Array, trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of rotors with the momentum s (N, 3, n) in B.

    L is that of the other bodies, so that rotors alone are no momentum at the start:
    J ω + h + s = Rᵀ (L₀ + R₀ s₀ + ...), and δL = R₀ s₀ − R s.
    """
    N = len(in_B)
    R = trajectory.R[:N]
    first = R[0] @ in_B[0]
    change.w[:] = trajectory.w_by_L @ first - trajectory.inverse[:N] @ in_B
    change.L[:] = first - R[-1] @ in_B[-1]


def _acceleration_B(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    motion = trajectory.motion
    # ∂v/∂a = ∫ R dt of an acceleration a in B; a table lets none act along its normal n: 1 − n nᵀ
    N, normal = len(motion.nodes), motion.tree.normal_B
    free = np.eye(3) if normal is None else np.eye(3) - np.outer(normal, normal)
    velocity = error.sigma * motion.accumulated(trajectory.R[:N] @ free @ error.effect.how)
    both = motion.at_instants(np.hstack([motion.accumulated(velocity), velocity]))
    change.position[:], change.velocity[:] = both[:, :3], both[:, 3:]


def _compliance(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    places, by = error.effect.how, trajectory.by["compliance"]
    change.take(mapped(lambda value: error.sigma * value[..., places], by), trajectory)


def _thrust(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    change.thrust[trajectory.motion.constants.acting["thrust"].index(error)] = error.sigma


def _thrust_delay(error: ConstantError, trajectory: Trajectory, change: MotionChange) -> None:
    change.delay[:] = error.sigma


WRITERS: dict[str, WriteError] = {
    "torque_W": _force_W,
    "acceleration_W": _force_W,
    "torque_B": _torque_B,
    "acceleration_B": _acceleration_B,
    "rotors_B": _rotors_B,
    "rotors_C": _rotors_C,
    "compliance": _compliance,
    "thrust": _thrust,
    "thrust_delay": _thrust_delay,
}
"""By the ways in which errors act on the motion; those of others leave it as it is."""
