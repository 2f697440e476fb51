"""Motion of the base as a function of the target and other unknowns.

The joint motion is given; the base's attitude and position follow from conservation of momentum
(`body_dynamics`). Attitude is integrated over a grid of equal steps by the fourth-order Magnus
formula, with angular velocities from a cubic spline:

    L = L₀ + ∫ τ dt,      ω = J⁻¹ (Rᵀ L − h),      Ṙ = R ω×.

Source: Ning et al. 2016, Eqs. 5 and 9, about the system's centre of mass.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.rotations import cross, exponentials, rotate, sines, skew
from cpid_drake.dynamics.sensitivity import MotionSensitivity
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.actuators import ThrustLog
from cpid_drake.estimation.likelihood.attitude_steps import (
    carried,
    integrated_attitude,
    step_angles,
)
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.forces import (
    Force,
    TurningTorque,
    steady_forces,
    white_forces,
)
from cpid_drake.estimation.likelihood.joint_errors import JointErrors
from cpid_drake.estimation.likelihood.joint_model import JointPart
from cpid_drake.estimation.likelihood.thrust import BlockThrust, transition
from cpid_drake.estimation.likelihood.uniform_spline import (
    UniformSpline,
    spline_weights,
    step_weights,
)
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.suite import SensorSuite

_STEPS_PER_PIECE = 3.5
"""Grid steps per piece of the joint motion's splines, so that the grid resolves errors of rates."""

_ROUNDS = 120
"""Most rounds of Newton's iteration, each of which follows the rotation about a radian farther."""

_MOST_STEPS = 400
"""Grid steps of a block: one that is longer than 10 s has encoders that show no faster motion."""


@dataclass(frozen=True, eq=False)
class TrajectoryState:
    """All unknowns that determine the base's motion and the readings of its sensors.

    Attributes:
        psi: (10,) relative unknowns (μ, μc, I_*), about the present mass of the spacecraft.
        attitude: R_WB at the start.
        p_Wcm: (3,) the system's centre of mass at the start, in W [m].
        v_Wcm: (3,) its velocity [m/s].
        L: (3,) angular momentum about the centre of mass, in W [N·m·s].
        constants: (k,) constant errors in units of their σ; see `constants.Constants`.
        forces: (K,) entries of white forces in units of their σ; see `forces`.

    """

    psi: Array
    attitude: Rotation
    p_Wcm: Array
    v_Wcm: Array
    L: Array
    constants: Array = field(default_factory=lambda: np.empty(0))
    forces: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The base's motion for one state, at U instants, the first N of which are the grid's nodes.

    Attributes:
        motion: which moves so for this state.
        state: the unknowns.
        R: (U, 3, 3) attitude R_WB.
        w: (U, 3) angular velocity, in B [rad/s].
        inverse: (U, 3, 3) inverse of the system's inertia, in B; see `BodyDynamics.mobility`.
        spline: w between the nodes.
        L: (U, 3) angular momentum about the centre of mass, in W, with that of `rotors` [N·m·s].
        travel: (U, 6) what logged thrust adds to position [m] and velocity [m/s] of the centre of
            mass, in W; None without thrust.
        rotors: (U, 3) angular momentum of rotors that the model does not have, in B [N·m·s].
        by: derivatives of the kinematics, by names; see `kinematic_changes.with_changes`.

    """

    motion: "BaseMotion"
    state: TrajectoryState
    R: Array
    w: Array
    inverse: Array
    spline: UniformSpline
    L: Array
    travel: Array | None
    rotors: Array
    by: Mapping[str, MotionSensitivity] = field(default_factory=dict)

    @property
    def w_by_L(self) -> Array:
        """∂ω/∂L (N, 3, 3) at the nodes, of ω in B and L in W."""
        N = self.spline.c.shape[1] + 1
        return self.inverse[:N] @ np.swapaxes(self.R[:N], -1, -2)

    def rotations(self, times: Array) -> Array:
        """Return R_WB (M, 3, 3) at times between the grid's ends, by the formula of whole steps."""
        k, t, angle = self.spline.since_node(times)
        angle = angle + t[:, None] ** 2 / 12 * cross(self.w[k], self.spline(times))
        return np.asarray(self.R[k] @ exponentials(angle))


class BaseMotion:
    """Predicts the base's motion for one joint motion.

    Args:
        tree: the spacecraft model.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.
        errors: (c,) their present errors in units of σ, which the tree has; None for zero.
        joints: its joint motion, from the start to the end of the base's motion.
        times: (M,) further times in it, at which the spacecraft's dynamics are needed [s].
        step: longest step of the grid [s]; a joint motion of many pieces makes it shorter.
        constants: the constant errors, external forces among them.
        nominal: (k,) their values in units of their σ: by some the joint motion is too large.
        origin: time at which zeros and clocks that drift have their values [s].
        suite: the sensors' errors, with the orbit of W's origin and white forces.
        thrust: the log of thrust, if any.

    Attributes:
        joint_errors: what the joint motion has too much.
        nodes: (N,) times of the grid [s].
        times: (U,) the N nodes, then the M further times [s].
        free: ψ, the inverse (U, 3, 3) of the system's inertia in B, and h (U, 3) of
            `BodyDynamics`; None before they are needed.

    """

    def __init__(
        self,
        tree: KinematicTree,
        known_bodies: BodyUncertainty | None,
        errors: Array | None,
        joints: JointPart,
        times: Array,
        step: float,
        constants: Constants,
        nominal: Array,
        origin: float,
        suite: SensorSuite,
        thrust: ThrustLog | None,
    ) -> None:
        self.tree, self.joints, self.constants, self.origin = tree, joints, constants, origin
        self.orbit, self.known_bodies = suite.orbit, known_bodies
        self.white = white_forces(suite, joints.start, joints.end, tree.normal_B is not None)
        count = known_bodies.count(tree.wheels, joints.coefficients.shape[1]) if known_bodies else 0
        self.body_errors = np.zeros(count) if errors is None else errors
        steady = steady_forces(constants, joints.start, joints.end)
        self.forces = {force.name: force for force in (*self.white, *steady)}
        self.joint_errors = JointErrors(joints, constants, nominal, origin, tree)
        length = joints.end - joints.start
        step = min(step, length / joints.pieces / _STEPS_PER_PIECE)
        steps = int(np.clip(np.ceil(length / step), 4, _MOST_STEPS))
        self.nodes = np.linspace(joints.start, joints.end, steps + 1)
        self.times, self._log = np.concatenate([self.nodes, times]), thrust
        self.free: tuple[Array, ...] | None = None

    @cached_property
    def dynamics(self) -> BodyDynamics:
        """The spacecraft's dynamics at all times; see also `kinematic_changes.relate`."""
        q, qdot = np.moveaxis(self.joint_motion(self.times), 1, 0)
        return BodyDynamics.at(self.tree, q, qdot)

    @cached_property
    def grid(self) -> BodyDynamics:
        """The dynamics at the nodes only."""
        return self.dynamics.part(slice(0, len(self.nodes)))

    @cached_property
    def thrust(self) -> BlockThrust | None:
        """The thrust between the first and the last node; None if there is none."""
        if self._log is None or not self._log.acts(self.nodes[0], self.nodes[-1]):
            return None
        return BlockThrust(self._log, self)

    @cached_property
    def torques(self) -> tuple[TurningTorque | BlockThrust, ...]:
        """The torques that change with the attitude."""
        turns = self.orbit is not None or self.constants.acting["torque_B"]
        turning = (TurningTorque(self),) if turns else ()
        return (*turning, self.thrust) if self.thrust is not None else turning

    def capture_pose(self, times: Array) -> tuple[Array, Array]:
        """Return R_BC (M, 3, 3) and p_BC (M, 3) of the capture frame at times (M,)."""
        q, qdot = np.moveaxis(self.joint_motion(times), 1, 0)
        _, capture = forward_kinematics(self.tree, q, qdot)
        return capture.R_WC, capture.p_WC

    def joint_motion(self, times: Array) -> Array:
        """Return true positions and rates (M, 2, J) of the joints at times (M,) [s]."""
        return self.joint_errors.motion(times)

    def trajectory(self, state: TrajectoryState) -> Trajectory:
        """Integrate the base's attitude over the grid.

        Raises:
            InputError: the system's inertia is not positive definite for this target, or the base
                rotates by more than about a radian in a step.

        """
        N, psi = len(self.nodes), state.psi
        if self.free is None or not np.array_equal(self.free[0], psi):
            self.free = psi, self.dynamics.mobility(psi), self.dynamics.momentum_at_rest(psi)
        _, inverse, h = self.free
        step = self.nodes[1] - self.nodes[0]
        first = state.attitude.as_matrix()
        R = np.broadcast_to(first, (N, 3, 3))
        L = np.broadcast_to(state.L, (len(self.times), 3))
        rotors = self._rotors(state)
        for force in self.forces.values():
            if force.turns:
                L = L + force.impulse(self.times) @ self._entries(force, state)
        # rotors s count as h, and in L, which at the start is that of the other bodies alone
        h, L = h + rotors, L + first @ rotors[0]
        last = 0.0
        # With momentum the velocity depends on the attitude: iterate until the next change, by the
        # ratio of those before, is rounding error. Where Picard's iteration does not fall fast, it
        # multiplies rounding errors by the exponential of the rotation: then it is Newton's.
        for _ in range(_ROUNDS):
            total = L
            for torque in self.torques:
                total = total + torque.momentum(R, state)
            # ω = J⁻¹ (Rᵀ L − h)
            w = rotate(inverse[:N], rotate(np.swapaxes(R, -1, -2), total[:N]) - h[:N])
            spline = UniformSpline(self.nodes[0], step, w)
            if self.thrust is not None:
                spline = self.thrust.spline(w, inverse[:N], R, state.psi)
            turned = integrated_attitude(first, step_angles(spline.steps(), w, step))
            change = float(np.abs(turned - R).max())
            if change > last / 10 > 0:
                # of a turn ξ of R, ξ̇ = A ξ + ẏ with A = R J⁻¹ Rᵀ L×, and y what the steps miss
                back = np.swapaxes(R, -1, -2)
                A = R @ inverse[:N] @ back @ skew(total[:N])
                miss = np.diff(sines(turned @ back), axis=0)[..., None]
                turn = carried(A[:-1], A[1:], miss, np.zeros((3, 1)), step)[..., 0]
                turned = exponentials(turn) @ R
            R = turned
            if change**2 <= 1e-12 * max(change, last):
                break
            last = change
        else:
            raise InputError(f"the base rotates too fast to follow in steps of {step:.3g} s")
        travel = None
        if self.thrust is not None:
            travel = self.thrust.travel(R, state.psi)
        nodes = Trajectory(self, state, R, w, inverse, spline, total[:N], travel, rotors)
        times = self.times[N:]
        if not len(times):
            return nodes
        R = np.concatenate([R, nodes.rotations(times)])
        L_B = rotate(np.swapaxes(R, -1, -2), total)
        return replace(nodes, R=R, w=rotate(inverse, L_B - h), L=total)

    def accumulated(self, rates: Array) -> Array:
        """Return the integrals of rates (N, ...) at the nodes from the start to each node."""
        h = self.nodes[1] - self.nodes[0]
        steps = h * np.tensordot(step_weights(len(rates)), rates, axes=1)
        return np.concatenate([np.zeros_like(rates[:1]), np.cumsum(steps, axis=0)])

    def at_instants(self, values: Array) -> Array:
        """Return values (N, ...) at the nodes at all instants, (U, ...)."""
        later = self.interpolation(self.times[len(self.nodes) :]) @ values.reshape(len(values), -1)
        return np.concatenate([values, later.reshape(-1, *values.shape[1:])])

    def com_motion(self, trajectory: Trajectory, rows: slice) -> Array:
        """Return position [m] and velocity [m/s] (M, 6) of the centre of mass in W, at instants."""
        state, times, start = trajectory.state, self.times[rows], self.joints.start
        first = np.concatenate([state.p_Wcm, state.v_Wcm])
        # [p; v] = Φ(t) [p₀; v₀] + ∫∫ a, ∫ a
        moved = np.asarray(transition(start, times, self.orbit) @ first)
        for force in self.forces.values():
            if not force.turns:
                both = np.concatenate([force.travel(times), force.impulse(times)], axis=1)
                moved = moved + both @ self._entries(force, state)
        return moved if trajectory.travel is None else moved + trajectory.travel[rows]

    def _rotors(self, state: TrajectoryState) -> Array:
        """Return the angular momentum of rotors that the model does not have; see `Trajectory`."""
        # s = s_B + R_BC s_C
        base = self.constants.sum(state.constants, "", "rotors_B", 3)
        target = self.constants.sum(state.constants, "", "rotors_C", 3)
        return np.asarray(self.dynamics.R_BC @ target + base)

    def _entries(self, force: Force, state: TrajectoryState) -> Array:
        return (state.forces if force in self.white else state.constants)[force.rows]

    def end(self, trajectory: Trajectory) -> TrajectoryState:
        """Return the state at the end of a trajectory."""
        return self.at_node(trajectory, len(self.nodes) - 1)

    def at_node(self, trajectory: Trajectory, k: int) -> TrajectoryState:
        """Return the state at a node of the grid."""
        state, L = trajectory.state, trajectory.L[k] - trajectory.R[k] @ trajectory.rotors[k]
        p, v = np.split(self.com_motion(trajectory, slice(k, k + 1))[0], 2)
        return replace(state, attitude=Rotation.from_matrix(trajectory.R[k]), p_Wcm=p, v_Wcm=v, L=L)

    def interpolation(self, times: Array) -> Array:
        """Return (M, N) weights of the nodes at times (M,): those of the spline of w.

        The same weights for w and for its derivatives let the errors of the joints' splines, which
        vary fast, cancel exactly.
        """
        return spline_weights(self.nodes, times)
