"""What a model file describes of a spacecraft: a free base, a tree of joints and C."""

import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Context

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.kinematics import CaptureMotion
from cpid_drake.dynamics.momentum import MomentumSamples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.files.digits import significant
from cpid_drake.files.errors import InputError, listed
from cpid_drake.files.resources import package_folders, resolve_model
from cpid_drake.spacecraft.appearance import add_target_appearance, switch_contact_off
from cpid_drake.spacecraft.floating_base import floating_joint
from cpid_drake.spacecraft.link_inertia import Repair
from cpid_drake.spacecraft.mimic_joints import JointCoupling, couple_joints
from cpid_drake.spacecraft.model_file import ModelFile
from cpid_drake.spacecraft.plant_columns import counterpart_columns
from cpid_drake.spacecraft.plant_names import find_element, unique_names
from cpid_drake.spacecraft.plausibility import oversized
from cpid_drake.spacecraft.reading import (
    extract_tree,
    joint_limits,
    movable_joints,
    positions_of,
)

Connect = Callable[[MultibodyPlant, Frame, Frame], object]
"""Joins the capture frame and the target's frame in a plant that is not finalized."""

TARGET_NAME = "captured_target"
"""Name of the target's body and model instance in a simulation plant; _ is added if it is taken."""


class Spacecraft:
    """The spacecraft model without the target: the only prior knowledge of an identifier.

    The model may be any tree of revolute, prismatic and fixed joints on a free base, from URDF,
    SDF, MJCF or Drake model directives. There is no gravity. `plant` is shared; a caller that
    queries it creates a context of its own.

    A name that is not unique may be scoped as `instance::name`. `joint_names` contains a joint's
    bare name if that is unique, else its scoped name.

    Args:
        model: a path or a `package://NAME/...` URI.
        base: name of the base body B, which floats.
        capture_frame: name of a frame or body C, fixed on a body that the joints move; its origin
            is the capture point.
        packages: folders, by package name, of other packages that the model's URIs refer to.
        repair_bodies: "nearest" to take the nearest body in the place of one that cannot be, which
            is refused by default.

    Attributes:
        file: the model's file, and what is not read or repaired of it.
        plant: finalized, continuous MultibodyPlant of the spacecraft alone, without gravity.
        base: the base body in `plant`.
        capture_frame: C in `plant`.
        joint_names: the movable joints in the order of q, without those that follow others (mimic).
        coupling: how other joints follow these.
        joint_columns: (2, n) columns of x with positions and rates of all joints of `coupling`.
        limits: limits of these joints.
        tree: the same spacecraft as NumPy arrays, for computations on many samples at once.
        mass: total mass [kg].
        implausible: bodies that can be, but hardly are those of this spacecraft.
        state_columns: columns of the plant state x = [q; v] that hold the members of `Motion`,
            by their names: `quaternion_WB`, `p_WB`, `w_WB`, `v_WB`, `q` and `qdot`.

    Raises:
        InputError: no such file, frame or body; base welded to the world or not the floating body;
            capture frame on the world; no mass; closed loops or constraints; joints
            of other types; bodies with an inertia that no rigid body has.

    """

    def __init__(
        self,
        model: str | Path,
        *,
        base: str,
        capture_frame: str,
        packages: Mapping[str, str | Path] | None = None,
        repair_bodies: Repair | None = None,
    ) -> None:
        self.model = str(model)
        self._capture_name = capture_frame
        self._read_with = base, capture_frame, dict(packages or {}), repair_bodies
        self.file = ModelFile(model, package_folders(packages), repair_bodies)
        self.plant = MultibodyPlant(time_step=0.0)
        self.add_alone_to(self.plant)
        self.base = find_element(self.plant, "Body", base, self.model)
        self.capture_frame = find_element(self.plant, "Frame", capture_frame, self.model)
        joints = movable_joints(self.file, self.plant, self.base, self.capture_frame)
        mimics, self._locked = self.file.content.mimics, tuple[str, ...]()
        self._read_joints(couple_joints(self.plant, joints, mimics, self.model))
        self.mass = self.tree.mass
        if not self.mass > 0:
            raise self.file.error("the spacecraft model has no mass; give its links inertias")
        notes = self.file.notes
        self.implausible = (*oversized(self.tree, self.file.parse_into), *self.file.copied())
        if self.implausible:
            notes += ("implausible: " + listed([str(each) for each in self.implausible], most=3),)
        for note in notes:
            logging.getLogger(__name__).warning("%s: %s", self.model, note)

    def _read_joints(self, coupling: JointCoupling) -> None:
        """Read the tree and the state's columns of joints that are coupled in this way."""
        self.coupling, nq = coupling, self.plant.num_positions()
        self.joint_names = unique_names(self.plant, coupling.leaders)
        self.limits = joint_limits(self.file, self.plant, coupling.leaders)
        self.tree = extract_tree(self.plant, self.base, self.capture_frame, coupling)
        floating = floating_joint(self.plant, self.base)
        q_B, v_B = floating.position_start(), nq + floating.velocity_start()
        self.state_columns = {
            "quaternion_WB": np.arange(q_B, q_B + 4),
            "p_WB": np.arange(q_B + 4, q_B + 7),
            "w_WB": np.arange(v_B, v_B + 3),
            "v_WB": np.arange(v_B + 3, v_B + 6),
        }
        starts = [(j.position_start(), nq + j.velocity_start()) for j in coupling.joints]
        self.joint_columns = np.array(starts, dtype=int).reshape(-1, 2).T
        leading = self.joint_columns[:, : coupling.count]
        self.state_columns |= {"q": leading[0], "qdot": leading[1]}

    def __reduce__(self) -> tuple[Callable[..., "Spacecraft"], tuple[Any, ...]]:
        """Return what it was read from: a plant cannot be pickled."""
        return _read_again, (self.model, *self._read_with, self.tree.normal_B, self._locked)

    def __repr__(self) -> str:
        base, capture_frame, *_ = self._read_with
        table = "" if self.tree.normal_B is None else "; on a table"
        return (
            f"Spacecraft({self.path.name}: base {base}, capture frame {capture_frame}, "
            f"{significant(self.mass, 4)} kg; joints: {listed(self.joint_names) or 'none'}{table})"
        )

    @property
    def path(self) -> Path:
        """Absolute path of the model's file."""
        return self.file.path

    def on_table(self, normal_B: ArrayLike = (0.0, 0.0, 1.0)) -> "Spacecraft":
        """Return the spacecraft on a table, which holds the base's height and tilt.

        Only the linear momentum in the plane and the angular momentum about the table's normal,
        W's z axis, are then conserved, and the estimators use nothing else; see `dynamics.plane`.
        `plant` still has a base with six degrees of freedom.

        Args:
            normal_B: (3,) the table's normal in the base's frame, of any length but zero.

        """
        normal = np.asarray(normal_B, dtype=float)
        other = _copied(self)
        other.tree = replace(self.tree, normal_B=normal / np.linalg.norm(normal))
        return other

    def locked(self, joints: Collection[str]) -> "Spacecraft":
        """Return the spacecraft with some joints fixed at their defaults, within their limits."""
        other, columns = _copied(self), [self.joint_names.index(joint) for joint in joints]
        other._locked += tuple(joints)
        other._read_joints(self.coupling.locked(columns))
        other.tree = replace(other.tree, normal_B=self.tree.normal_B)
        return other

    # -- plants ------------------------------------------------------------------------------

    def add_to(
        self,
        plant: MultibodyPlant,
        target: InertialParameters,
        *,
        scene_graph: SceneGraph | None = None,
        target_visual_model: str | Path | None = None,
        connect: Connect = MultibodyPlant.WeldFrames,
    ) -> RigidBody:
        """Add the spacecraft with a target on C to a plant, and finalize it.

        If the target is welded, the plant's state has the same layout as that of `self.plant`: a
        weld has no state.

        Args:
            plant: empty, not finalized, and continuous. A discrete plant does not conserve
                momentum: it loses 1e-3 N·s or more.
            target: physically consistent inertial parameters.
            scene_graph: the SceneGraph with which `plant` is registered, if any. Contact is
                switched off.
            target_visual_model: a model file with the target's visual geometry; default: the
                solid ellipsoid of the same inertia.
            connect: joins C and the target's frame in the plant, such as
                `CompliantWrist.connect`; default: a weld.

        Returns:
            The target's body; its frame coincides with C if springs are relaxed.

        Raises:
            InputError: the plant is finalized, discrete or not empty; the target is not
                physically consistent; the visual model cannot be read.

        """
        if plant.is_finalized() or plant.num_bodies() != 1 or plant.time_step() != 0.0:
            raise InputError("the plant must be empty, not finalized, and continuous (time_step=0)")
        if scene_graph is not None and not plant.geometry_source_is_registered():
            raise InputError("the plant is not registered with the scene graph")
        M_TCo_C = target.to_spatial_inertia()
        self.file.parse_into(plant, self._read_with[0])
        name = TARGET_NAME
        while plant.HasModelInstanceNamed(name):
            name += "_"
        body = plant.AddRigidBody(name, plant.AddModelInstance(name), M_TCo_C)
        frame_C = find_element(plant, "Frame", self._capture_name, self.model)
        connect(plant, frame_C, body.body_frame())
        if scene_graph is not None:
            look = target_visual_model and resolve_model(target_visual_model, self.file.folders)
            add_target_appearance(plant, body, M_TCo_C, look or None, self.file.folders)
        self.file.finalize(plant)
        if scene_graph is not None:  # the gripper touches the target, and the grasp is a weld
            switch_contact_off(plant, scene_graph)
        return body

    def add_alone_to(self, plant: MultibodyPlant) -> None:
        """Add the spacecraft without a target to an empty plant, and finalize it.

        Raises:
            InputError: the plant is registered with a SceneGraph and its geometry cannot be read.

        """
        self.file.parse_into(plant, self._read_with[0])
        self.file.finalize(plant)

    def make_simulation_plant(
        self, target: InertialParameters, connect: Connect = MultibodyPlant.WeldFrames
    ) -> MultibodyPlant:
        """Return a finalized zero-gravity plant of the spacecraft with this target on C."""
        plant = MultibodyPlant(time_step=0.0)
        self.add_to(plant, target, connect=connect)
        return plant

    def columns_in(
        self, plant: MultibodyPlant, instance: ModelInstanceIndex | None = None
    ) -> NDArray[np.intp]:
        """Return the columns of a plant's x = [q; v] in the order of the state of `self.plant`.

        The base and the joints are found by their names. Their model instance has the name that it
        has in `self.plant`, or it is the only one with such a base or joint.

        Args:
            plant: a finalized plant with the spacecraft, such as one with a target.
            instance: the model instance that has the whole spacecraft; default: any.

        Raises:
            InputError: the plant lacks the base or a joint, has it more than once, or has it with
                other coordinates.

        """
        return counterpart_columns(self.plant, self.base, self.coupling.joints, plant, instance)

    # -- states ------------------------------------------------------------------------------

    def to_motion(self, time: ArrayLike, states: ArrayLike) -> Motion:
        """Return plant states x = [q; v] (N, nx) at times (N,) [s] as a motion.

        A state that was logged twice at one time counts once: a second call of
        `Simulator.Initialize` does that.

        Raises:
            InputError: the times or states are no valid motion.

        """
        time = np.atleast_1d(np.asarray(time, dtype=float))
        states = np.atleast_2d(np.asarray(states, dtype=float))
        if len(time) == len(states):
            is_new = np.ones(len(time), dtype=bool)
            is_new[1:] = (np.diff(time) != 0) | np.diff(states, axis=0).any(axis=1)
            time, states = time[is_new], states[is_new]
        parts = {name: states[:, columns] for name, columns in self.state_columns.items()}
        return Motion(self.joint_names, time, **parts)

    def predicted_motion(
        self,
        target: InertialParameters,
        motion: JointMotion,
        times: ArrayLike,
        momentum_W: ArrayLike = (0.0,) * 6,
    ) -> Motion:
        """Return the motion at times (N,) [s] that conserves momentum; B is at W at the start.

        Args:
            target: the target on C.
            motion: the motion of the joints.
            times: (N,) [s], increasing.
            momentum_W: (6,) total momentum [L; P] about W's origin, in W; default: zero.

        """
        phi = target.to_standard_vector()
        base = propagate(self.tree, motion, phi, times, momentum_W=momentum_W)
        return base.to_motion(self.joint_names, times, motion)

    def initial_state(
        self, target: InertialParameters, motion: JointMotion, momentum_W: ArrayLike = (0.0,) * 6
    ) -> Array:
        """Return the state x = [q; v] (nx,) at t = 0 with B at W and the given total momentum.

        Joints that move at t = 0 contribute to the momentum; the twist of the base takes this into
        account. The arguments are those of `predicted_motion`.
        """
        start = self.predicted_motion(target, motion, [0.0], momentum_W)
        return np.asarray(self.to_states(start)[0])

    def require_joints(self, motion: Motion) -> None:
        """Refuse a motion of another spacecraft.

        Raises:
            InputError: its joints are not this spacecraft's joints, in this order.

        """
        if motion.joint_names != self.joint_names:
            raise InputError(
                f"the motion has joints {', '.join(motion.joint_names)}, but the "
                f"spacecraft has joints {', '.join(self.joint_names)}"
            )

    def to_states(self, motion: Motion) -> Array:
        """Return the plant states x = [q; v] (N, nx) of a motion; raises as `require_joints`."""
        self.require_joints(motion)
        states = np.zeros((len(motion), self.plant.num_multibody_states()))
        for name, columns in self.state_columns.items():
            states[:, columns] = getattr(motion, name)
        q, qdot = self.joint_columns
        states[:, q] = self.coupling.positions(motion.q)
        states[:, qdot] = self.coupling.rates(motion.qdot)
        return states

    def configuration(self, angles: Mapping[str, float], where: str) -> Array:
        """Return q (J,) with the named joints at the given positions and the others at zero.

        Args:
            angles: joint positions [rad or m] by joint name.
            where: the name of the input, for error messages.

        Raises:
            InputError: a joint that the spacecraft does not have, or an angle beyond a turn and
                the joint's limits that is within them if it is in degrees.

        """
        return positions_of(angles, self.joint_names, self.limits, self.tree.sliding, where)

    def momentum_sample(self, context: Context) -> MomentumSamples:
        """Return one momentum sample (N = 1) of a context of `plant`, computed by Drake."""
        X_WC = self.capture_frame.CalcPoseInWorld(context)
        V_WC = self.capture_frame.CalcSpatialVelocityInWorld(context)
        p_WC, R_WC = X_WC.translation(), X_WC.rotation().matrix()
        L_WC = self.plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WC)
        p_WKcm = self.plant.CalcCenterOfMassPositionInWorld(context)
        motion = CaptureMotion(
            R_WC[None], p_WC[None], V_WC.rotational()[None], V_WC.translational()[None]
        )
        P, L = L_WC.translational()[None], L_WC.rotational()[None]
        return MomentumSamples(motion, P, L, p_WKcm[None], self.mass)


def _copied(spacecraft: Spacecraft) -> Spacecraft:
    """Return a spacecraft with the same plant; `copy.copy` would read the file again."""
    other = Spacecraft.__new__(Spacecraft)
    vars(other).update(vars(spacecraft))
    return other


def _read_again(
    model: str,
    base: str,
    capture_frame: str,
    packages: Mapping[str, str | Path],
    repair_bodies: Repair | None,
    normal_B: Array | None,
    locked: tuple[str, ...],
) -> Spacecraft:
    """Return a spacecraft that was pickled."""
    names = {"base": base, "capture_frame": capture_frame}
    spacecraft = Spacecraft(model, **names, packages=packages, repair_bodies=repair_bodies)
    spacecraft = spacecraft.locked(locked)
    return spacecraft if normal_B is None else spacecraft.on_table(normal_B)
