"""The truth of a motion, what all sensors measure of it, and the rates that techniques share."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.logs.log import Log, Samples, sample_times
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.logs.smoothing import smooth
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import TARGET_NAME, Spacecraft
from cpid_drake.studies.techniques.force_sensors import (
    ACCELERATION,
    EFFORTS,
    RATE,
    WRENCH,
    ForceSensors,
)
from cpid_drake.studies.trials import Case, base_trajectory, ideal_samples

Array = NDArray[np.float64]

_ARRAYS = ("time", "quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")

LEFT_OUT = 0.1
"""Time at both ends of a motion of which no rows are made [s]: half cosines start and end with a
step of the acceleration, which no spline follows."""

STEP = 1e-4
"""Half the interval of central differences of smoothed motion [s]: their error is 1e-8."""


@dataclass(frozen=True, eq=False)
class Rates:
    """Motion of C and of the known bodies with its rates in W, at N instants, all in C.

    Attributes:
        motion: the motion of base and joints.
        samples: the momentum of the known bodies.
        s, s_ddot: (N, 3) from the known bodies' centre of mass K to C's origin, and its second
            derivative.
        w, alpha: (N, 3) angular velocity and acceleration of C.
        a: (N, 3) acceleration of C's origin.
        K_rate: (N, 3) rate of the known bodies' angular momentum about K.
        momentum_rate: (N, 6) [L̇ + v × P; Ṗ], with L about C's origin, which moves.
        vdot: (N, 6 + J) rates of w_WB and v_WB, in W, and of the joint rates.

    """

    motion: Motion
    samples: MomentumSamples
    s: Array
    s_ddot: Array
    w: Array
    alpha: Array
    a: Array
    K_rate: Array
    momentum_rate: Array
    vdot: Array

    @classmethod
    def of(cls, tree: KinematicTree, around: Motion) -> "Rates":
        """Return them by central differences of motion (3 N) at t − `STEP`, t and t + `STEP`."""
        m = momentum_samples(tree, around)
        s = m.motion.p_WC - m.p_WKcm
        rate_of_s, L_K = m.motion.v_WC - m.P / m.mass, m.L + cross(s, m.P)
        vectors = (rate_of_s, m.motion.w_WC, m.motion.v_WC, L_K, m.L, m.P)
        values = np.stack(vectors, axis=1).reshape(-1, 3, 6, 3)
        R_WC = m.motion.R_WC[1::3]
        rates = ((values[:, 2] - values[:, 0]) / (2 * STEP)) @ R_WC  # row vectors: Rᵀ v
        motion = around.select(slice(1, None, 3))
        middle = momentum_samples(tree, motion)
        v = middle.in_C
        all_v = np.concatenate([around.w_WB, around.v_WB, around.qdot], axis=1)
        all_v = all_v.reshape(len(motion), 3, -1)
        return cls(
            motion=motion,
            samples=middle,
            s=rotate(np.swapaxes(R_WC, 1, 2), s[1::3]),
            s_ddot=rates[:, 0],
            w=v[:, 1],
            alpha=rates[:, 1],
            a=rates[:, 2],
            K_rate=rates[:, 3],
            momentum_rate=np.hstack([rates[:, 4] + cross(v[:, 0], v[:, 2]), rates[:, 5]]),
            vdot=(all_v[:, 2] - all_v[:, 0]) / (2 * STEP),
        )


@dataclass(frozen=True, eq=False)
class Trial:
    """All that a technique may use: the nominal spacecraft and what the sensors measured.

    Attributes:
        spacecraft: the known spacecraft.
        suite: the errors of the sensors of the base and of the joints.
        log: their samples.
        rates: the smoothed motion, at the instants of rows; the base's position is zero if it is
            not measured.
        force_sensors: the errors of the sensors of forces.
        forces: their samples at the same instants, by the names of `ForceSensors.measured`.
        known_bodies: uncertainty of the spacecraft's bodies; None if it is exact.
        covariance: (N, n, n) of the smoothed motion, see `SmoothedMotion`; None if it is exact.

    """

    spacecraft: Spacecraft
    suite: SensorSuite
    log: Log
    rates: Rates
    force_sensors: ForceSensors
    forces: Mapping[str, Samples]
    known_bodies: BodyUncertainty | None = None
    covariance: Array | None = None


def around(times: Array) -> Array:
    """Return t − `STEP`, t and t + `STEP` of times (N,), as (3 N,)."""
    return (times[:, None] + STEP * np.array([-1.0, 0.0, 1.0])).ravel()


@dataclass(frozen=True, eq=False)
class Truth:
    """A simulated motion: ideal samples of all sensors, forces, and the motion at their times."""

    ideal: Log
    forces: Mapping[str, Samples]
    motion: Motion
    vdot: Array


def truth_of(case: Case, spacecraft: Spacecraft, tree: KinematicTree) -> Truth:
    """Return the true motion of a spacecraft whose bodies are those of `tree`.

    The forces are Drake's: inverse dynamics for the joint torques, and the reaction in the weld
    that holds the target.
    """
    names, times = spacecraft.joint_names, sample_times(RATE, case.duration)
    times = times[(times >= LEFT_OUT - 1e-9) & (times <= case.duration - LEFT_OUT + 1e-9)]
    motion = base_trajectory(case, tree, times).to_telemetry(names, times, case.motion)
    qddot = case.motion.evaluate(times)[:, 2]
    forces, vdot = true_forces(spacecraft, tree, case.truth, motion, qddot)
    return Truth(ideal_samples(case, tree, names), forces, motion, vdot)


def true_forces(
    spacecraft: Spacecraft,
    tree: KinematicTree,
    target: InertialParameters,
    motion: Motion,
    qddot: Array,
) -> tuple[dict[str, Samples], Array]:
    """Return what force sensors without errors measure, and the rates of `Rates.vdot`.

    Args:
        spacecraft: the spacecraft.
        tree: its true bodies; their names and joints are the spacecraft's.
        target: the target.
        motion: the true motion.
        qddot: (N, J) accelerations of the joints.

    """
    plant = spacecraft.make_simulation_plant(target)
    context = plant.CreateDefaultContext()
    if tree is not spacecraft.tree:
        _set_bodies(spacecraft, plant, context, tree, motion.select(slice(1)))
    dynamics, nq = FreeFloatingDynamics(spacecraft, plant), plant.num_positions()
    names = ("w_WB", "v_WB", "qdot")
    order = np.concatenate([spacecraft.state_columns[name] for name in names]) - nq
    base = plant.GetBodyByName(spacecraft.base.name()).index()
    [weld] = (
        int(k)
        for k in plant.GetJointIndices()
        if plant.get_joint(k).child_body().name().startswith(TARGET_NAME)
    )
    applied = plant.get_applied_generalized_force_input_port()
    rows = []
    for state, R_WB, acceleration in zip(spacecraft.to_states(motion), motion.R_WB, qddot):
        plant.SetPositionsAndVelocities(context, state)
        force = dynamics.generalized_force(context, acceleration)
        applied.FixValue(context, force)
        reaction = plant.get_reaction_forces_output_port().Eval(context)[weld]
        vdot = plant.EvalTimeDerivatives(context).CopyToVector()[nq:]
        A_WB = plant.CalcSpatialAccelerationsFromVdot(context, vdot)[base]
        wrench = np.concatenate([reaction.rotational(), reaction.translational()])
        rows.append((R_WB.T @ A_WB.translational(), force[order[6:]], wrench, vdot[order]))
    *values, vdots = (np.array(each) for each in zip(*rows, strict=True))
    names = (ACCELERATION, EFFORTS, WRENCH)
    return {name: Samples(motion.time, each) for name, each in zip(names, values)}, vdots


def _set_bodies(
    spacecraft: Spacecraft,
    plant: MultibodyPlant,
    context: Context,
    tree: KinematicTree,
    motion: Motion,
) -> None:
    """Give the plant's bodies in a context the masses of a tree, by their places in one state."""
    plant.SetPositionsAndVelocities(context, spacecraft.to_states(motion)[0])
    placed, _ = forward_kinematics(tree, **motion.states)
    for body, R_WM, [p_WBcm] in zip(tree.bodies, placed.R[:, 0], placed.r):
        if body.mass > 0:
            own = plant.GetBodyByName(body.name)
            X_WB = plant.EvalBodyPoseInWorld(context, own)
            R_BM = X_WB.rotation().matrix().T @ R_WM
            inertia = InertialParameters(
                body.mass, X_WB.inverse() @ p_WBcm, R_BM @ body.I_BBcm @ R_BM.T
            )
            own.SetSpatialInertiaInBodyFrame(context, inertia.to_spatial_inertia())


def draw_trial(
    case: Case, spacecraft: Spacecraft, truth: Truth, sensors: ForceSensors, number: int
) -> Trial:
    """Return one draw of all errors and, where the spacecraft is uncertain, of its bodies.

    Every technique gets the same numbers: those of the case's seed and the trial's number.
    """
    sequence = np.random.SeedSequence(case.seed, spawn_key=(number,))
    seed, body_seed = (int(each) for each in sequence.generate_state(2))
    if case.known_bodies is not None:
        tree = perturbed(spacecraft.tree, case.known_bodies, np.random.default_rng(body_seed))
        truth = truth_of(case, spacecraft, tree)
    log, suite, tree = add_noise(case.suite, truth.ideal, seed), case.suite, spacecraft.tree
    times = around(truth.motion.time)
    smoothed = smooth(log, suite, times, with_position=suite.position is not None)
    forces = sensors.measured(truth.forces, spacecraft, seed)
    rates, covariance = Rates.of(tree, smoothed.telemetry), smoothed.covariance[1::3]
    return Trial(spacecraft, suite, log, rates, sensors, forces, case.known_bodies, covariance)


def exact_trial(case: Case, spacecraft: Spacecraft, truth: Truth, sensors: ForceSensors) -> Trial:
    """Return the trial without any errors; the rates are those of the true motion."""
    forces, motion = sensors.measured(truth.forces, spacecraft, None), truth.motion
    moved = [advanced(motion, truth.vdot, sign * STEP) for sign in (-1, 0, 1)]
    parts = (np.stack([getattr(each, name) for each in moved], axis=1) for name in _ARRAYS)
    near = Motion(motion.joint_names, *(each.reshape(-1, *each.shape[2:]) for each in parts))
    return Trial(
        spacecraft, case.suite, truth.ideal, Rates.of(spacecraft.tree, near), sensors, forces
    )


def advanced(motion: Motion, vdot: Array, step: float) -> Motion:
    """Return N samples of motion a short time later, with an error of the third order.

    Central differences of it have an error of the second order.
    """
    w, v, qdot = (
        rate + step * change
        for rate, change in zip((motion.w_WB, motion.v_WB, motion.qdot), np.split(vdot, [3, 6], 1))
    )
    turn = Rotation.from_rotvec(step * (motion.w_WB + w) / 2)
    attitude = turn * Rotation.from_quat(motion.quaternion_WB, scalar_first=True)
    return Motion(
        motion.joint_names,
        motion.time + step,
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=motion.p_WB + step * (motion.v_WB + v) / 2,
        w_WB=w,
        v_WB=v,
        q=motion.q + step * (motion.qdot + qdot) / 2,
        qdot=qdot,
    )


def require_usable(case: Case, spacecraft: Spacecraft, name: str) -> None:
    """Refuse a case that the techniques cannot share.

    Raises:
        InputError: there is a momentum, a table or forces, or a sensor is missing that all need.

    """
    suite = case.suite
    for sensor in ("attitude", "gyro", "encoders"):
        if getattr(suite, sensor) is None:
            raise InputError(
                f"sensors '{name}' have no {sensor}, which the techniques need; choose others"
            )
    if spacecraft.tree.normal_B is not None:
        raise InputError("the techniques are for a base that floats freely, not on a table")
    if case.momentum_W.any() or case.firings or case.burns or suite.disturbances is not None:
        raise InputError("the techniques are compared without momentum, thrust and disturbances")
    limits = spacecraft.limits.efforts
    if not np.isfinite(limits).all():
        joint = spacecraft.joint_names[int(np.argmin(np.isfinite(limits)))]
        raise InputError(f"the full scale of joint torques needs an effort limit of '{joint}'")
