"""What a model file describes of a spacecraft: a free base, a tree of joints and C."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, ModelInstanceIndex, RevoluteJoint, RigidBody
from pydrake.systems.framework import Context

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.kinematics import CaptureMotion
from cpid_drake.dynamics.momentum import MomentumSamples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.files.digits import significant
from cpid_drake.files.errors import InputError, choose_from, listed
from cpid_drake.files.resources import package_folders, resolve_model
from cpid_drake.spacecraft.appearance import add_target_appearance
from cpid_drake.spacecraft.model_file import ModelFile
from cpid_drake.spacecraft.reading import (
    extract_tree,
    find_counterpart,
    find_element,
    floating_joint,
    joint_limits,
    movable_joints,
    unique_names,
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

    Attributes:
        plant: finalized, continuous MultibodyPlant of the spacecraft alone, without gravity.
        base: the base body in `plant`.
        capture_frame: C in `plant`.
        joint_names: the movable joints in the order of q.
        limits: limits of these joints.
        tree: the same spacecraft as NumPy arrays, for computations on many samples at once.
        mass: total mass [kg].
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
    ) -> None:
        self.model = str(model)
        self._capture_name = capture_frame
        self._read_with = base, capture_frame, dict(packages or {})
        self._file = ModelFile(model, package_folders(packages))
        self.plant = MultibodyPlant(time_step=0.0)
        self.add_alone_to(self.plant)
        self.base = find_element(self.plant, "Body", base, self.model)
        self.capture_frame = find_element(self.plant, "Frame", capture_frame, self.model)
        self._joints = movable_joints(self._file, self.plant, self.base, self.capture_frame)
        self.joint_names = unique_names(self.plant, self._joints)
        self.limits = joint_limits(self._file, self.plant, self._joints)
        self.tree = extract_tree(self.plant, self.base, self.capture_frame, self._joints)
        self.mass = self.tree.mass
        if not self.mass > 0:
            raise self._file.error("the spacecraft model has no mass; give its links inertias")

        nq = self.plant.num_positions()
        q_B = self.base.floating_positions_start()
        v_B = nq + self.base.floating_velocities_start_in_v()
        self.state_columns = {
            "quaternion_WB": np.arange(q_B, q_B + 4),
            "p_WB": np.arange(q_B + 4, q_B + 7),
            "w_WB": np.arange(v_B, v_B + 3),
            "v_WB": np.arange(v_B + 3, v_B + 6),
            "q": np.array([joint.position_start() for joint in self._joints], dtype=int),
            "qdot": np.array([nq + joint.velocity_start() for joint in self._joints], dtype=int),
        }

    def __reduce__(self) -> tuple[Callable[..., "Spacecraft"], tuple[Any, ...]]:
        """Return what it was read from: a plant cannot be pickled."""
        return _read_again, (self.model, *self._read_with, self.tree.normal_B)

    def __repr__(self) -> str:
        base, capture_frame, _ = self._read_with
        table = "" if self.tree.normal_B is None else "; on a table"
        return (
            f"Spacecraft({self.path.name}: base {base}, capture frame {capture_frame}, "
            f"{significant(self.mass, 4)} kg; joints: {listed(self.joint_names) or 'none'}{table})"
        )

    @property
    def path(self) -> Path:
        """Absolute path of the model's file."""
        return self._file.path

    def on_table(self, normal_B: ArrayLike = (0.0, 0.0, 1.0)) -> "Spacecraft":
        """Return the spacecraft on a table, which holds the base's height and tilt.

        Only the linear momentum in the plane and the angular momentum about the table's normal,
        W's z axis, are then conserved, and the estimators use nothing else; see `dynamics.plane`.
        `plant` still has a base with six degrees of freedom.

        Args:
            normal_B: (3,) the table's normal in the base's frame, of any length but zero.

        """
        normal = np.asarray(normal_B, dtype=float)
        other = copy(self)
        other.tree = replace(self.tree, normal_B=normal / np.linalg.norm(normal))
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
        self._file.parse_into(plant)
        name = TARGET_NAME
        while plant.HasModelInstanceNamed(name):
            name += "_"
        body = plant.AddRigidBody(name, plant.AddModelInstance(name), M_TCo_C)
        frame_C = find_element(plant, "Frame", self._capture_name, self.model)
        connect(plant, frame_C, body.body_frame())
        if scene_graph is not None:
            look = target_visual_model and resolve_model(target_visual_model, self._file.folders)
            add_target_appearance(plant, body, M_TCo_C, look or None, self._file.folders)
        self._file.finalize(plant)
        if scene_graph is not None:  # the gripper touches the target, and the grasp is a weld
            bodies = (plant.get_body(BodyIndex(k)) for k in range(plant.num_bodies()))
            shapes = [g for each in bodies for g in plant.GetCollisionGeometriesForBody(each)]
            filters = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(shapes))
            scene_graph.collision_filter_manager().Apply(filters)
        return body

    def add_alone_to(self, plant: MultibodyPlant) -> None:
        """Add the spacecraft without a target to an empty plant, and finalize it.

        Raises:
            InputError: the plant is registered with a SceneGraph and its geometry cannot be read.

        """
        self._file.parse_into(plant)
        self._file.finalize(plant)

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
        columns = np.empty(self.plant.num_multibody_states(), dtype=np.intp)
        base, nq, own_nq = self.base, plant.num_positions(), self.plant.num_positions()
        B = find_counterpart(plant, base, plant.HasBodyNamed, plant.GetBodyByName, instance)
        theirs = floating_joint(plant, B)
        own_q, own_v = base.floating_positions_start(), base.floating_velocities_start_in_v()
        columns[own_q + np.arange(7)] = theirs.position_start() + np.arange(7)
        columns[own_nq + own_v + np.arange(6)] = nq + theirs.velocity_start() + np.arange(6)
        for joint in self._joints:
            J = find_counterpart(plant, joint, plant.HasJointNamed, plant.GetJointByName, instance)
            if J.type_name() != joint.type_name():
                raise InputError(
                    f"joint '{joint.name()}' must be {joint.type_name()} in the plant, as in the "
                    f"spacecraft model, not {J.type_name()}"
                )
            columns[joint.position_start()] = J.position_start()
            columns[own_nq + joint.velocity_start()] = nq + J.velocity_start()
        return columns

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
        q = np.zeros(len(self.joint_names))
        for name, value in angles.items():
            if name not in self.joint_names:
                choices = choose_from(name, self.joint_names)
                raise InputError(f"{where}: no joint '{name}'; {choices}")
            if not np.isfinite(value):
                raise InputError(f"{where}: {name} = {value:g} is not a finite number")
            k = self.joint_names.index(name)
            low, high, radians = self.limits.lowest[k], self.limits.highest[k], np.radians(value)
            turns = isinstance(self._joints[k], RevoluteJoint) and abs(value) > 2 * np.pi
            if turns and not low <= value <= high and low <= radians <= high:
                raise InputError(
                    f"{where}: {name} = {value:g} is outside [{low:g}, {high:g}]; angles are in "
                    f"radians: {value:g} degrees are {radians:.4g}"
                )
            q[k] = value
        return q

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


def require_spacecraft(given: object) -> None:
    """Raise an InputError for what is no spacecraft, such as a path."""
    if isinstance(given, Spacecraft):
        return
    model = repr(str(given)) if isinstance(given, (str, Path)) else "model"
    raise InputError(
        f"the spacecraft must be a Spacecraft, not {given!r:.80}: a model alone does not say which "
        "body is the base and which frame holds the target; give "
        f"Spacecraft({model}, base=..., capture_frame=...)"
    )


def _read_again(
    model: str,
    base: str,
    capture_frame: str,
    packages: Mapping[str, str | Path],
    normal_B: Array | None,
) -> Spacecraft:
    """Return a spacecraft that was pickled."""
    found = Spacecraft(model, base=base, capture_frame=capture_frame, packages=packages)
    return found if normal_B is None else found.on_table(normal_B)
