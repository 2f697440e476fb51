"""Effects: the unknown or uncertain quantities on which the base's motion and the readings depend.

Each effect has some columns of the Jacobian, and a function that writes the derivatives of the
motion by its quantities into a change, which contains zeros; what readings change at the same
motion is a matter of their sensors. To model a further effect, write a function like these and add
it to `model.BlockModel`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.parameterizations import parameters_to_standard, relative_parameterization
from cpid_drake.dynamics.rotations import cross, skew
from cpid_drake.dynamics.sensitivity import (
    MotionSensitivity,
    screw_sensitivity,
    uncertain_sensitivity,
)
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.constants import TARGET_WHEEL, YIELDING, ConstantError
from cpid_drake.estimation.likelihood.forces import Force
from cpid_drake.estimation.likelihood.motion_model import (
    BaseMotion,
    Trajectory,
)
from cpid_drake.estimation.likelihood.thrust import inverse_mass, transition
from cpid_drake.estimation.likelihood.uniform_spline import spline_slopes

TOGETHER = 32
"""So many blocks have their kinematics computed in one call."""


@dataclass(frozen=True, eq=False)
class MotionChange:
    """First-order change of the base's motion by n quantities, at U instants, first N nodes.

    Attributes:
        w: (N, 3, n) change of the angular velocity at unchanged attitude, in B.
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
        thrust: (P, n) change of the errors of the thrust, in the order of `Constants.of_thrust`.
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
    def zeros(cls, motion: BaseMotion, n: int, *, with_rates: bool = True) -> "MotionChange":
        """Return no change of a motion by n quantities; without rates of ρ if nobody reads them."""
        nodes, instants, has_thrust = (
            len(motion.nodes),
            len(motion.times),
            motion.thrust is not None,
        )
        com, position, velocity = np.zeros((3, instants, 3, n))
        w, rate = np.zeros((nodes, 3, n)), np.zeros((instants * with_rates, 3, n))
        screw, (attitude, L) = np.zeros((nodes * has_thrust, 6, n)), np.zeros((2, 3, n))
        (inverse, delay), thrust = np.zeros((2, n)), np.zeros((len(motion.constants.of_thrust), n))
        return cls(w, com, rate, screw, position, velocity, attitude, L, inverse, thrust, delay)

    def columns(self, part: slice) -> "MotionChange":
        """Return views of some columns."""
        return MotionChange(**{name: value[..., part] for name, value in vars(self).items()})


def write_start(motion: BaseMotion, trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of attitude, centre of mass, L about it and its velocity at the start, in W."""
    change.attitude[:, :3] = change.L[:, 6:9] = np.eye(3)
    mobility = trajectory.mobility
    change.w[:, :, 6:9] = mobility
    if trajectory.rotors is not None:  # they rotate with the base
        change.L[:, :3] = -skew(trajectory.state.attitude.as_matrix() @ trajectory.rotors[0])
        change.w[:, :, :3] = mobility @ change.L[:, :3]
    drift = transition(motion.joints.start, motion.times, motion.orbit)
    for moved, by in zip((change.position, change.velocity), np.split(drift, 2, axis=1)):
        moved[:, :, 3:6], moved[:, :, 9:] = by[:, :, :3], by[:, :, 3:]


def write_joints(motion: BaseMotion, trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of errors of the coefficients of the joints' splines, joint after joint."""
    bases = [motion.joints.basis(motion.times, order)[:, None, None] for order in range(2)]
    by_q, by_qdot = joint_changes(motion, trajectory)

    def by_errors(name: str, count: int) -> Array:
        each = (getattr(by, name)[:count, ..., None] for by in (by_q, by_qdot))
        q, qdot = (by * basis[:count] for by, basis in zip(each, bases, strict=True))
        q += qdot
        return np.asarray(q.reshape(*q.shape[:2], np.prod(q.shape[2:])))

    U, rates = len(motion.times), len(change.com_rate)
    counts = {"w": rates or len(change.w), "com": U, "v": rates, "screw": len(change.screw)}
    by = MotionSensitivity(**{name: by_errors(name, count) for name, count in counts.items()})
    write_change(change, by, motion, trajectory)


def write_force(
    force: Force, motion: BaseMotion, trajectory: Trajectory, change: MotionChange
) -> None:
    """Write that of the entries of a force."""
    impulse = force.impulse(motion.times)
    if force.turns:
        change.w[:] = trajectory.mobility @ impulse[: len(change.w)]
        change.L[:] = impulse[len(motion.nodes) - 1]
    else:
        change.position[:], change.velocity[:] = force.travel(motion.times), impulse


def write_target(motion: BaseMotion, trajectory: Trajectory, change: MotionChange) -> None:
    """Write that of the ten relative unknowns ψ = (μ, μc, I_*)."""
    dynamics, N = motion.dynamics, len(motion.nodes)
    change.w[:] = -trajectory.inverse[:N] @ motion.grid.regressor(trajectory.w[:N])
    by_torque = motion.gradient_by_psi(trajectory)
    if by_torque is not None:
        change.w[:] += trajectory.mobility @ by_torque[:N]
        change.L[:] = by_torque[N - 1]
    change.com[:, :, :4] = dynamics.com_regressor()
    if len(change.com_rate):
        change.com_rate[:, :, :4] = dynamics.com_rate_regressor()
    change.inverse_mass[0] = -(dynamics.mass**-2)


def write_bodies(
    uncertainty: BodyUncertainty,
    errors: Array | None,
    motion: BaseMotion,
    trajectory: Trajectory,
    change: MotionChange,
) -> None:
    """Write that of errors of the spacecraft's bodies and of their geometry, in units of their σ.

    Args:
        uncertainty: their σ.
        errors: (c,) the present errors in units of σ; None for zero.
        motion: the base's motion, of a spacecraft with the present errors.
        trajectory: its trajectory.
        change: c columns, which contain zeros.

    """
    sigmas = uncertainty.all_sigmas(motion.tree.wheels, motion.joints.coefficients.shape[1])
    present = np.zeros(np.count_nonzero(sigmas)) if errors is None else errors
    by = trajectory.by_bodies or _changes([motion], [trajectory], uncertainty, present)[0]["bodies"]
    write_change(change, by, motion, trajectory)
    mu, masses = float(trajectory.state.psi[0]), np.zeros(len(sigmas))
    bodies = [body.mass for body in motion.tree.bodies]
    masses[: 10 * len(bodies) : 10] = uncertainty.mass * np.array(bodies)
    by_masses = -masses[sigmas > 0] * inverse_mass(motion.dynamics.mass, mu) ** 2
    change.inverse_mass[:] = by_masses / (1 + uncertainty.mass * present)


def write_yielding(
    error: ConstantError, motion: BaseMotion, trajectory: Trajectory, change: MotionChange
) -> None:
    """Write that of compliances of the joints or of the grasp, to first order about zero.

    A joint yields by −(compliance) τ, with the effort τ of a rigid arm, and the target against C by
    that times moment and force of a rigid grasp. This holds if the arm's modes are much faster than
    the motion, and if external forces on arm and target are small.
    """
    by = trajectory.by_compliance or _changes([motion], [trajectory])[0]["compliance"]
    end = by.w.shape[-1] - (6, 3, 0)[YIELDING.index(error.kind)]
    own = (error.sigma * each[..., end - error.size : end] for each in vars(by).values())
    write_change(change, MotionSensitivity(*own), motion, trajectory)


def inertia_changes(
    motion: BaseMotion,
    nodes: NDArray[np.intp],
    psi: Array,
    acceleration: Array,
    uncertainty: BodyUncertainty | None = None,
    errors: Array | None = None,
) -> dict[str, Array]:
    """Return the derivatives (M, 3, n) of J α by ψ, the joints' errors and the bodies'.

    Args:
        motion: the base's motion, with the constant errors.
        nodes: (M,) nodes at which the inertia J is that of spacecraft and target.
        psi: (10,) relative unknowns of the target.
        acceleration: (M, 3) the angular accelerations α, in B.
        uncertainty, errors: see `write_bodies`.

    """
    grid, tree = motion.grid.part(nodes), motion.tree
    by = {"psi": grid.inertia_regressor(acceleration)}
    errors_of_q = motion.joint_errors.by_errors(motion.nodes[nodes])
    if not errors_of_q and uncertainty is None:
        return by
    q = motion.joint_motion(motion.nodes[nodes])[:, 0]
    turning = acceleration, -cross(acceleration, grid.com(psi))
    outboard = Outboard.at(_with_target(tree, psi, grid), q, 0 * q, *turning)
    J = -grid.inertia(psi)
    if errors_of_q:
        each = screw_sensitivity(outboard, psi, grid, *outboard.joint_screws)[0].w
        by_q = J @ outboard.by_joint(each)
        by |= {name: by_q * of_q[:, None] for name, of_q in errors_of_q.items()}
    if uncertainty is not None:
        present = np.zeros(uncertainty.count(tree.wheels, q.shape[1])) if errors is None else errors
        by["bodies"] = J @ uncertain_sensitivity(outboard, psi, grid, uncertainty, present).w
    return by


def relate(motions: Sequence[BaseMotion], psi: Array) -> None:
    """Compute the spacecraft's dynamics of motions of one spacecraft and target in few calls.

    Raises:
        InputError: see `BodyDynamics.mobility`.

    """
    for first in range(0, len(motions), TOGETHER):
        some = motions[first : first + TOGETHER]
        samples = np.concatenate([motion.joint_motion(motion.times) for motion in some])
        dynamics, end = BodyDynamics.at(some[0].tree, samples[:, 0], samples[:, 1]), 0
        inverse, h = dynamics.mobility(psi), dynamics.momentum_at_rest(psi)
        for motion in some:
            start, end = end, end + len(motion.times)
            motion.dynamics = dynamics.part(slice(start, end))
            motion.free = psi, inverse[start:end], h[start:end]


def joint_changes(
    motion: BaseMotion, trajectory: Trajectory
) -> tuple[MotionSensitivity, MotionSensitivity]:
    """Return the derivatives of the motion with respect to joint positions and joint rates."""
    if trajectory.by_joints is None:
        changes = _changes([motion], [trajectory])[0]
        return changes["q"], changes["qdot"]
    return trajectory.by_joints


def with_changes(
    motions: Sequence[BaseMotion],
    trajectories: Sequence[Trajectory],
    uncertainty: BodyUncertainty | None = None,
    errors: Array | None = None,
) -> Iterator[Trajectory]:
    """Yield trajectories of one target with their derivatives by joints and bodies, in few calls.

    The uncertainty and the present errors are those of `write_bodies`.
    """
    for k in range(0, len(motions), TOGETHER):
        some = trajectories[k : k + TOGETHER]
        changes = _changes(motions[k : k + TOGETHER], some, uncertainty, errors)
        for trajectory, by in zip(some, changes, strict=True):
            yield replace(
                trajectory,
                by_joints=(by["q"], by["qdot"]),
                by_bodies=by.get("bodies"),
                by_compliance=by.get("compliance"),
            )


def _changes(
    motions: Sequence[BaseMotion],
    trajectories: Sequence[Trajectory],
    uncertainty: BodyUncertainty | None = None,
    errors: Array | None = None,
) -> list[dict[str, MotionSensitivity]]:
    """Return the derivatives by joint positions and rates and, if not exact, compliances, bodies.

    The compliances are those of the joints, then of the grasp about and along C's axes.
    """
    outboard, dynamics = _relative_to_base(motions, trajectories)
    psi, joints = trajectories[0].state.psi, motions[0].joints.coefficients.shape[1]
    which, S = outboard.joint_screws
    has_followers = len(which) > joints
    yields = motions[0].constants.yields
    if yields:
        which, S = which + outboard.grasp_screws[0], np.dstack([S, outboard.grasp_screws[1]])
    parts = dict(zip(("q", "qdot"), screw_sensitivity(outboard, psi, dynamics, which, S)))
    if has_followers:
        for name, part in parts.items():
            parts[name] = MotionSensitivity(*map(outboard.by_joint, vars(part).values()))
    ends = np.cumsum([len(trajectory.w) for trajectory in trajectories])[:-1]
    if yields:
        slopes = [spline_slopes(motion.nodes, motion.times) for motion in motions]

        def rate(values: Array) -> Array:
            """Return the rates of values (..., U, n) at all instants of all motions."""
            each = zip(slopes, np.split(values, ends, axis=-2), strict=True)
            return np.concatenate([D @ part[..., : D.shape[1], :] for D, part in each], axis=-2)

        loads = outboard.loads(which, S, rate(outboard.momentum))
        loads = outboard.by_joint(loads) if has_followers else loads
        by, rates = zip(*(vars(part).values() for part in parts.values())), rate(loads)
        moved = [-(q * loads[:, None] + qdot * rates[:, None]) for q, qdot in by]
        for name, part in parts.items():
            parts[name] = MotionSensitivity(*(each[..., :joints] for each in vars(part).values()))
        parts["compliance"] = MotionSensitivity(*moved)
    if uncertainty is not None:
        wheels = motions[0].tree.wheels
        present = np.zeros(uncertainty.count(wheels, joints)) if errors is None else errors
        parts["bodies"] = uncertain_sensitivity(outboard, psi, dynamics, uncertainty, present)
    split = {
        name: zip(*(np.split(value, ends) for value in vars(part).values()))
        for name, part in parts.items()
    }
    return [
        {name: MotionSensitivity(*each) for name, each in zip(split, one)}
        for one in zip(*split.values(), strict=True)
    ]


def write_change(
    change: MotionChange, by: MotionSensitivity, motion: BaseMotion, trajectory: Trajectory
) -> None:
    """Write a sensitivity into `change`; v = −(ω × ρ + ρ') is solved for the change of ρ'."""
    change.w[:], change.com[:] = by.w[: len(change.w)], by.com
    change.screw[:] = by.screw[: len(change.screw)]
    if len(change.com_rate):
        rho = motion.dynamics.com(trajectory.state.psi)
        change.com_rate[:] = skew(rho) @ by.w - skew(trajectory.w) @ by.com - by.v


def _relative_to_base(
    motions: Sequence[BaseMotion], trajectories: Sequence[Trajectory]
) -> tuple[Outboard, BodyDynamics]:
    """Return all motions of the bodies and the target, and of the bodies, seen from the base.

    A target with rotors carries their momentum.
    """
    psi, tree = trajectories[0].state.psi, motions[0].tree
    dynamics = BodyDynamics.concatenate([motion.dynamics for motion in motions])
    joints = np.concatenate([motion.joint_motion(motion.times) for motion in motions])
    w = np.concatenate([trajectory.w for trajectory in trajectories])
    v = -(cross(w, dynamics.com(psi)) + dynamics.com_rate(psi))
    with_target = _with_target(tree, psi, dynamics)
    outboard = Outboard.at(with_target, joints[:, 0], joints[:, 1], w, v)
    spin = motions[0].constants.value(trajectories[0].state.constants, TARGET_WHEEL)
    if spin is not None:
        momentum = outboard.momentum.copy()
        momentum[outboard.inboard_of_target, :, :3] += dynamics.R_BC @ spin
        outboard = replace(outboard, momentum=momentum)
    return outboard, dynamics


def _with_target(tree: KinematicTree, psi: Array, dynamics: BodyDynamics) -> KinematicTree:
    """Return the spacecraft with a target."""
    parameters = relative_parameterization(dynamics.mass).to_parameters(psi)
    return tree.with_target(parameters_to_standard(parameters))
