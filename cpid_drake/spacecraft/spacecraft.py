"""A model file becomes a known spacecraft: a free base, a tree of joints and a capture frame."""

import logging
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)
from pydrake.systems.framework import Context

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import CaptureMotion
from cpid_drake.dynamics.momentum import MomentumSamples
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.errors import InputError
from cpid_drake.resources import forget_remote_packages, package_map, resolve_model
from cpid_drake.spacecraft.appearance import add_target_appearance
from cpid_drake.spacecraft.model_checks import check_model

TARGET_NAME = "captured_target"
"""Name of the target's body and model instance in a simulation plant (with _ if it is taken)."""

_MODEL_ENDINGS = (".urdf", ".sdf", ".xml", ".dmd.yaml")


# What Drake's parser only warns of, and then goes on with another spacecraft than the file's: parts
# of its warnings, and what they mean here.
_SILENT_REPAIRS = {
    "While parsing inertia matrix": "a body's inertia is not physically possible",
    "While re-expressing as central inertia": "a body's mass or inertia is not possible",
    "has invalid inertia": "a body's inertia is not physically possible",
    "found as a child of 'equality'": "an equality constraint closes a loop or couples joints",
    "The attribute 'settotalmass'": "masses other than the bodies' own",
    "The attribute 'boundmass'": "masses other than the bodies' own",
    "The attribute 'boundinertia'": "inertias other than the bodies' own",
    "The attribute 'balanceinertia'": "inertias other than the bodies' own",
    "The attribute 'inertiagrouprange'": "inertias other than the bodies' own",
}


class Spacecraft:
    """The known spacecraft, without the target: what an identifier is allowed to know.

    Any tree of revolute, prismatic and fixed joints on a free base, from URDF, SDF, MJCF or Drake
    model directives. Gravity is off. `plant` is for queries with contexts of the caller's own.

    Names may be scoped as `instance::name` where they are not unique. A joint is called by its
    bare name if that is unique, else by its scoped name.

    Args:
        model: a path or a `package://NAME/...` URI.
        base: name of the base body B: the one that floats.
        capture_frame: name of a frame or body C, fixed on a body that the joints move; its origin
            is the capture point.
        packages: folders, by name, of further packages that the model's URIs refer to.

    Attributes:
        plant: target-free, finalized, zero-gravity, continuous MultibodyPlant.
        base: the base body in `plant`.
        capture_frame: C in `plant`.
        joint_names: the movable joints in the order of q.
        tree: the same spacecraft as NumPy arrays, for batches of samples.
        mass: total mass of the known bodies [kg].

    Raises:
        InputError: no such file, frame or body; base welded to the world or not the floating body;
            capture frame on the base or on the world; no mass; closed loops or constraints; joints
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
        self._given = {"base": base, "capture_frame": capture_frame, "packages": packages}
        self._packages = package_map(packages)
        self._path = resolve_model(model, self._packages)
        if not self._path.name.endswith(_MODEL_ENDINGS):
            raise self._error(f"not a model file: its name must end in {', '.join(_MODEL_ENDINGS)}")
        self._capture_name = capture_frame
        check_model(self._path, self.model, self._packages)

        self.plant = MultibodyPlant(time_step=0.0)
        warnings = self._parse_into(self.plant)
        self._finalize(self.plant)
        self.base = self._find_body(base)
        self.capture_frame = self._find_frame(self.plant, capture_frame)
        self._require_tree_on_free_base()
        self._joints = self._movable_joints()
        self.joint_names = self._name_joints()
        self.tree = self._extract_tree()
        self.mass = self.tree.mass
        if not self.mass > 0:
            raise self._error("the known spacecraft has no mass; give its links inertias")

        nq = self.plant.num_positions()
        q_B = self.base.floating_positions_start()
        v_B = nq + self.base.floating_velocities_start_in_v()
        self._columns = {
            "quaternion_WB": np.arange(q_B, q_B + 4),
            "p_WB": np.arange(q_B + 4, q_B + 7),
            "w_WB": np.arange(v_B, v_B + 3),
            "v_WB": np.arange(v_B + 3, v_B + 6),
            "q": np.array([joint.position_start() for joint in self._joints], dtype=int),
            "qdot": np.array([nq + joint.velocity_start() for joint in self._joints], dtype=int),
        }
        for warning in warnings:  # not of a model that is refused: the error says what matters
            logging.getLogger("drake").warning(warning)

    @property
    def path(self) -> Path:
        """The model's file."""
        return self._path

    def reread(self, model: str | Path) -> "Spacecraft":
        """Return the spacecraft of another model with this one's base, C and packages by name."""
        return Spacecraft(model, **self._given)

    # -- plants ------------------------------------------------------------------------------

    def add_to(
        self,
        plant: MultibodyPlant,
        target: InertialParameters,
        *,
        scene_graph: SceneGraph | None = None,
        target_visual_model: str | Path | None = None,
    ) -> RigidBody:
        """Add the spacecraft with a target welded on C to a plant, and finalize it.

        The plant's state is laid out as that of `self.plant`: the weld adds nothing to it.

        Args:
            plant: empty, not finalized, and continuous: a discrete plant loses 1e-3 N·s and more.
            target: feasible inertial parameters.
            scene_graph: the one that `plant` is registered with, if any. Contact is switched off.
            target_visual_model: a model whose visual geometry the target takes; default: the
                solid ellipsoid of the same inertia.

        Returns:
            The target's body; its frame coincides with C.

        Raises:
            InputError: the plant is finalized, discrete or not empty; the target is not feasible.

        """
        if plant.is_finalized() or plant.num_bodies() != 1 or plant.time_step() != 0.0:
            raise InputError("the plant must be empty, not finalized, and continuous (time_step=0)")
        if scene_graph is not None and not plant.geometry_source_is_registered():
            raise InputError("the plant is not registered with the scene graph")
        M_TCo_C = target.to_spatial_inertia()
        self._parse_into(plant)
        name = TARGET_NAME
        while plant.HasModelInstanceNamed(name):
            name += "_"
        body = plant.AddRigidBody(name, plant.AddModelInstance(name), M_TCo_C)
        plant.WeldFrames(self._find_frame(plant, self._capture_name), body.body_frame())
        if scene_graph is not None:
            look = target_visual_model and resolve_model(target_visual_model, self._packages)
            add_target_appearance(plant, body, M_TCo_C, look or None)
        self._finalize(plant)
        if scene_graph is not None:
            _exclude_all_contact(plant, scene_graph)
        return body

    def add_alone_to(self, plant: MultibodyPlant) -> None:
        """Add the spacecraft without a target to an empty plant, and finalize it.

        Raises:
            InputError: with a SceneGraph: some of its geometry cannot be read.

        """
        self._parse_into(plant)
        self._finalize(plant)

    def make_simulation_plant(self, target: InertialParameters) -> MultibodyPlant:
        """Return a finalized zero-gravity plant of the spacecraft with this target welded on C."""
        plant = MultibodyPlant(time_step=0.0)
        self.add_to(plant, target)
        return plant

    # -- states ------------------------------------------------------------------------------

    def to_telemetry(self, time: ArrayLike, states: ArrayLike) -> Telemetry:
        """Return plant states (N, nx) at times (N,) as telemetry."""
        states = np.atleast_2d(np.asarray(states, dtype=float))
        parts = {name: states[:, columns] for name, columns in self._columns.items()}
        return Telemetry(self.joint_names, np.atleast_1d(time), **parts)

    def to_states(self, telemetry: Telemetry) -> NDArray[np.float64]:
        """Return the plant states (N, nx), x = [q; v], of telemetry of this spacecraft's joints."""
        if telemetry.joint_names != self.joint_names:
            raise InputError(
                f"telemetry of joints {', '.join(telemetry.joint_names)} is not of this "
                f"spacecraft, whose joints are {', '.join(self.joint_names)}"
            )
        states = np.zeros((len(telemetry), self.plant.num_multibody_states()))
        for name, columns in self._columns.items():
            states[:, columns] = getattr(telemetry, name)
        return states

    @property
    def quaternion_columns(self) -> NDArray[np.intp]:
        """Columns (4,) of the plant state x = [q; v] that hold the base's quaternion."""
        return self._columns["quaternion_WB"]

    @property
    def joint_state_columns(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Columns of the plant state x = [q; v] that hold the joints' q and q̇, (J,) each."""
        return self._columns["q"], self._columns["qdot"]

    def configuration(self, angles: Mapping[str, float], where: str) -> NDArray[np.float64]:
        """Return q (J,) with the named joints at the given positions and the others at zero.

        Args:
            angles: joint positions [rad or m] by joint name.
            where: what is being read, for the error message.

        Raises:
            InputError: a joint that the spacecraft does not have, or a position out of limits.

        """
        q = np.zeros(len(self.joint_names))
        for name, value in angles.items():
            if name not in self.joint_names:
                raise InputError(
                    f"{where}: no joint '{name}'; joints are {', '.join(self.joint_names)}"
                )
            k = self.joint_names.index(name)
            low, high = (
                self._joints[k].position_lower_limit(),
                self._joints[k].position_upper_limit(),
            )
            if not low <= value <= high:
                raise InputError(f"{where}: {name} = {value:g} is outside [{low:g}, {high:g}]")
            q[k] = value
        return q

    @property
    def position_limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(J,) lowest and highest positions of the joints; infinite where none [rad or m]."""
        return (
            np.array([joint.position_lower_limit() for joint in self._joints]),
            np.array([joint.position_upper_limit() for joint in self._joints]),
        )

    @property
    def velocity_limits(self) -> NDArray[np.float64]:
        """(J,) largest joint speeds of the model; infinite where it sets none [rad/s or m/s]."""
        return np.array([joint.velocity_upper_limits()[0] for joint in self._joints])

    def momentum_sample(self, context: Context) -> MomentumSamples:
        """Return one momentum sample (N = 1) of a context of `plant`, by Drake's kinematics."""
        frame = self.capture_frame
        X_WC = frame.CalcPoseInWorld(context)
        p_WC = X_WC.translation()
        V_WC = frame.CalcSpatialVelocityInWorld(context)
        L_WC = self.plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WC)
        motion = CaptureMotion(
            X_WC.rotation().matrix()[None],
            p_WC[None],
            V_WC.rotational()[None],
            V_WC.translational()[None],
        )
        return MomentumSamples(
            motion,
            L_WC.translational()[None],
            L_WC.rotational()[None],
            self.plant.CalcCenterOfMassPositionInWorld(context)[None],
            self.mass,
        )

    # -- reading the model -------------------------------------------------------------------

    def _error(self, problem: str) -> InputError:
        return InputError(f"{self.model}: {problem}")

    def _of_drake(self, message: object) -> str:
        """Return a message of Drake's without the file's name, which stands before it, and ours."""
        path = re.escape(str(self._path))
        text = re.sub(rf"/?{path}:(\d+): (error|warning): ", r"line \1: ", _one_line(message))
        text = re.sub(rf"{path}:(\d+):(\d+): ", r"line \1, column \2: ", text)
        text = re.sub(r" (for <root> )?while (accepting|visiting) .*", "", text)
        return re.sub(rf"^(error|warning): |{path}: |Failure at \S+ in \w+\(\): ", "", text)

    def _parse_into(self, plant: MultibodyPlant) -> list[str]:
        """Add the model to a plant without gravity, and return what the parser warned of."""
        parser = Parser(plant)
        forget_remote_packages(parser.package_map())
        parser.package_map().AddMap(self._packages)
        if self._path.suffix == ".sdf" and b"<mimic" in self._path.read_bytes():
            raise self._error("a mimic joint couples joints; Drake's SDF reader would ignore it")
        try:
            with _parser_warnings() as warnings:
                parser.AddModels(str(self._path))
        except (RuntimeError, ValueError, SystemExit) as error:
            raise self._error(self._of_drake(error)) from error
        for warning in warnings:
            for phrase, problem in _SILENT_REPAIRS.items():
                if phrase in warning:
                    raise self._error(f"{problem}: {self._of_drake(warning)}")
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        return warnings

    def _finalize(self, plant: MultibodyPlant) -> None:
        if plant.num_constraints() > 0:
            raise self._error(
                f"{plant.num_constraints()} constraint(s) couple its joints (closed loop, mimic or "
                "equality); only trees of independent joints can be identified with: in a copy of "
                "the file, make joints fixed that hold still, such as a hand's fingers"
            )
        try:
            plant.Finalize()
        except (RuntimeError, SystemExit) as error:
            if "loop" in str(error):
                raise self._error(
                    "its joints form a closed loop; only trees are supported"
                ) from None
            raise self._error(self._of_drake(error)) from error

    def _find_body(self, name: str) -> RigidBody:
        bodies = [
            self.plant.get_body(k)
            for instance in _model_instances(self.plant)
            for k in self.plant.GetBodyIndices(instance)
        ]
        return self._find_named(self.plant, "body", bodies, name)

    def _find_frame(self, plant: MultibodyPlant, name: str) -> Frame:
        frames = [
            plant.get_frame(k)
            for instance in _model_instances(plant)
            for k in plant.GetFrameIndices(instance)
        ]
        return self._find_named(plant, "frame", [frame for frame in frames if frame.name()], name)

    def _find_named(
        self, plant: MultibodyPlant, kind: str, candidates: list, name: str
    ) -> RigidBody | Frame:
        scope, _, bare = str(name).rpartition("::")
        matches = [
            candidate
            for candidate in candidates
            if candidate.name() == name
            or (
                candidate.name() == bare
                and scope == plant.GetModelInstanceName(candidate.model_instance())
            )
        ]
        if not matches:
            names = _listed([candidate.name() for candidate in candidates])
            raise self._error(f"no {kind} '{name}'; choose from: {names}")
        if len(matches) > 1:
            raise self._error(
                f"{len(matches)} of its {kind} names are '{name}'; say instance::name"
            )
        return matches[0]

    def _require_tree_on_free_base(self) -> None:
        plant, base = self.plant, self.base
        floating = [plant.get_body(k) for k in sorted(plant.GetFloatingBaseBodies(), key=int)]
        if plant.IsAnchored(base):
            raise self._error(
                f"base '{base.name()}' is welded to the world{self._weld_to_world()}; a "
                "spacecraft's base must be free. Take that weld out of a copy of the file (MJCF: "
                "add a freejoint); to put an arm on a base, write model directives (.dmd.yaml): "
                "add_model the base, add_model the arm, add_weld with parent BASE::LINK and child "
                "ARM::FIRST_LINK"
            )
        if base.index() not in [body.index() for body in floating]:
            names = _listed([body.name() for body in floating])
            raise self._error(
                f"'{base.name()}' is not the floating base; free bodies are: {names or 'none'}"
            )
        if len(floating) > 1:
            loose = _listed([body.name() for body in floating if body.index() != base.index()])
            raise self._error(f"bodies not connected to the base '{base.name()}': {loose}")
        carrier = self.capture_frame.body()
        with_base = [body.index() for body in plant.GetBodiesWeldedTo(base)]
        if carrier.index() in with_base:
            raise self._error(
                f"capture frame '{self.capture_frame.name()}' is on the base (body "
                f"'{carrier.name()}'); it must be on a body that joints move against the base"
            )
        if plant.IsAnchored(carrier):
            raise self._error(f"capture frame '{self.capture_frame.name()}' is fixed in the world")
        for k in plant.GetJointIndices():
            joint = plant.get_joint(k)
            of_base = (
                isinstance(joint, QuaternionFloatingJoint)
                and joint.child_body().index() == base.index()
            )
            if not of_base and not isinstance(joint, (RevoluteJoint, PrismaticJoint, WeldJoint)):
                raise self._error(
                    f"joint '{joint.name()}' is of type {joint.type_name()}; only revolute, "
                    "prismatic and fixed joints are supported"
                )

    def _weld_to_world(self) -> str:
        """Name the joint that holds the base in the world: a vendor's arm may have brought it."""
        joints = [self.plant.get_joint(k) for k in self.plant.GetJointIndices()]
        welds = [
            f"{joint.name()} (on {joint.child_body().name()})"
            for joint in joints
            if isinstance(joint, WeldJoint)
            and joint.parent_body().index() == self.plant.world_body().index()
        ]
        return f" by {_listed(welds)}" if welds else ""

    def _movable_joints(self) -> list[Joint]:
        joints = [self.plant.get_joint(k) for k in self.plant.GetJointIndices()]
        movable = [joint for joint in joints if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
        if not movable:
            raise self._error("it has no revolute or prismatic joint to move the target with")
        return sorted(movable, key=lambda joint: joint.position_start())

    def _name_joints(self) -> tuple[str, ...]:
        count = Counter(joint.name() for joint in self._joints)
        instances = [
            self.plant.GetModelInstanceName(joint.model_instance()) for joint in self._joints
        ]
        return tuple(
            joint.name() if count[joint.name()] == 1 else f"{instance}::{joint.name()}"
            for joint, instance in zip(self._joints, instances, strict=True)
        )

    def _extract_tree(self) -> KinematicTree:
        """Read the plant once, outwards from the base; joints may point either way in the file."""
        plant = self.plant
        column = {joint.index(): k for k, joint in enumerate(self._joints)}
        adjacent: dict[BodyIndex, list[Joint]] = {}
        for k in plant.GetJointIndices():
            joint = plant.get_joint(k)
            for body in (joint.parent_body(), joint.child_body()):
                adjacent.setdefault(body.index(), []).append(joint)

        order = {self.base.index(): 0}
        bodies = [_tree_body(self.base)]
        queue = [self.base]
        for inboard in queue:
            for joint in adjacent[inboard.index()]:
                forward = joint.parent_body().index() == inboard.index()
                outboard = joint.child_body() if forward else joint.parent_body()
                if outboard.index() in order or outboard.index() == plant.world_body().index():
                    continue
                frames = [joint.frame_on_parent(), joint.frame_on_child()]
                frame_F, frame_M = frames if forward else frames[::-1]
                axis = np.zeros(3)
                if isinstance(joint, RevoluteJoint):
                    axis = joint.revolute_axis()
                elif isinstance(joint, PrismaticJoint):
                    axis = joint.translation_axis()
                X_PF = frame_F.GetFixedPoseInBodyFrame()
                X_MB = frame_M.GetFixedPoseInBodyFrame().inverse()
                if isinstance(joint, WeldJoint):
                    X_FM = joint.X_FM() if forward else joint.X_FM().inverse()
                    X_MB = X_FM @ X_MB
                order[outboard.index()] = len(bodies)
                bodies.append(
                    _tree_body(
                        outboard,
                        parent=order[inboard.index()],
                        joint=column.get(joint.index(), -1),
                        prismatic=isinstance(joint, PrismaticJoint),
                        axis_F=axis if forward else -axis,
                        R_PF=X_PF.rotation().matrix(),
                        p_PF=X_PF.translation(),
                        R_MB=X_MB.rotation().matrix(),
                        p_MB=X_MB.translation(),
                    )
                )
                queue.append(outboard)
        X_BC = self.capture_frame.GetFixedPoseInBodyFrame()
        return KinematicTree(
            tuple(bodies),
            order[self.capture_frame.body().index()],
            X_BC.rotation().matrix(),
            X_BC.translation(),
        )


def _tree_body(
    body: RigidBody,
    parent: int = -1,
    joint: int = -1,
    prismatic: bool = False,
    axis_F: ArrayLike = (0.0, 0.0, 0.0),
    R_PF: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    p_PF: ArrayLike = (0.0, 0.0, 0.0),
    R_MB: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    p_MB: ArrayLike = (0.0, 0.0, 0.0),
) -> TreeBody:
    mass, com, inertia = body.default_mass(), np.zeros(3), np.zeros((3, 3))
    if mass > 0:
        parameters = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
        com, inertia = parameters.p_CTcm_C, parameters.I_TTcm_C
    arrays = (np.array(values, dtype=float) for values in (axis_F, R_PF, p_PF, R_MB, p_MB))
    return TreeBody(body.name(), parent, joint, prismatic, *arrays, mass, com, inertia)


def _model_instances(plant: MultibodyPlant) -> list[ModelInstanceIndex]:
    """All model instances but the world's."""
    return [ModelInstanceIndex(k) for k in range(1, plant.num_model_instances())]


def _exclude_all_contact(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Switch contact off: a target held in a gripper touches it, and the grasp is a weld."""
    geometries = [
        geometry
        for k in range(plant.num_bodies())
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(k)))
    ]
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeWithin(GeometrySet(geometries))
    )


@contextmanager
def _parser_warnings() -> Iterator[list[str]]:
    """Collect what Drake's parser warns of (it tells nobody but its logger), and log it after."""
    messages: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(_one_line(record.getMessage()))

    # However quiet the caller has made the log: nothing that it hides may be missed here.
    logger, manager = logging.getLogger("drake"), logging.root.manager
    names = ("level", "disabled", "handlers", "filters", "propagate")
    saved, switch = {name: getattr(logger, name) for name in names}, manager.disable
    logger.setLevel(logging.WARNING)
    logger.disabled, manager.disable = False, 0
    logger.handlers, logger.filters, logger.propagate = [Collector()], [], False
    try:
        yield messages
    finally:
        for name, value in saved.items():
            setattr(logger, name, value)
        logger.setLevel(saved["level"])  # not an attribute alone: it is cached elsewhere
        manager.disable = switch


def _one_line(message: object) -> str:
    return " ".join(str(message).split())


def _listed(names: list[str]) -> str:
    shown = ", ".join(sorted(names)[:40])
    return shown + (f" and {len(names) - 40} more" if len(names) > 40 else "")
