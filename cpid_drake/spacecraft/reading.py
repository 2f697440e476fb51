"""What a parsed plant says of a spacecraft: its names, its tree of joints, and their limits."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.spacecraft.parsing import ModelFile

_Element = TypeVar("_Element", bound=Any)  # RigidBody or Frame


# -- names, bare or scoped as `instance::name` ----------------------------------------------------


def find_body(model: ModelFile, plant: MultibodyPlant, name: str) -> RigidBody:
    """Return the body of this name; raises InputError if there is none, or more than one."""
    return _find(model, plant, "body", _elements(plant, plant.GetBodyIndices, plant.get_body), name)


def find_frame(model: ModelFile, plant: MultibodyPlant, name: str) -> Frame:
    """Return the frame of this name; a body's name means its body frame; raises as `find_body`."""
    frames = _elements(plant, plant.GetFrameIndices, plant.get_frame)
    return _find(model, plant, "frame", [frame for frame in frames if frame.name()], name)


def unique_names(
    plant: MultibodyPlant, elements: Sequence[Joint] | Sequence[RigidBody]
) -> tuple[str, ...]:
    """Return the bare names of joints or bodies where they are unique, else the scoped names."""
    count = Counter(element.name() for element in elements)
    instances = [plant.GetModelInstanceName(element.model_instance()) for element in elements]
    return tuple(
        element.name() if count[element.name()] == 1 else f"{instance}::{element.name()}"
        for element, instance in zip(elements, instances, strict=True)
    )


def _elements(
    plant: MultibodyPlant, indices: Callable, element: Callable[..., _Element]
) -> list[_Element]:
    """Return the elements of all model instances except those of the world."""
    instances = map(ModelInstanceIndex, range(1, plant.num_model_instances()))
    return [element(k) for instance in instances for k in indices(instance)]


def _find(
    model: ModelFile, plant: MultibodyPlant, kind: str, candidates: list[_Element], name: str
) -> _Element:
    scope, _, bare = str(name).rpartition("::")
    matches = [
        each
        for each in candidates
        if each.name() == name
        or (each.name() == bare and scope == plant.GetModelInstanceName(each.model_instance()))
    ]
    if not matches:
        names = _listed(candidate.name() for candidate in candidates)
        raise model.error(f"no {kind} '{name}'; choose from: {names}")
    if len(matches) > 1:
        raise model.error(
            f"{len(matches)} of its {kind} names are '{name}'; give it as instance::name"
        )
    return matches[0]


def _listed(names: Iterable[str]) -> str:
    """Return names in alphabetical order for an error message, at most 40 of them."""
    ordered = sorted(names)
    more = f" and {len(ordered) - 40} more" if len(ordered) > 40 else ""
    return ", ".join(ordered[:40]) + more


# -- a tree of supported joints on a free base -----------------------------------------------------


def movable_joints(
    model: ModelFile, plant: MultibodyPlant, base: RigidBody, capture_frame: Frame
) -> list[Joint]:
    """Return the revolute and prismatic joints of a finalized plant, in the order of q.

    Raises:
        InputError: the base is welded to the world or does not float, a body is not connected to
            it, C is fixed in the world, a joint is of a type that is not supported,
            or a body that joints move has a geometry and no inertia.

    """
    joints = [plant.get_joint(k) for k in plant.GetJointIndices()]
    floating = [plant.get_body(k) for k in plant.GetFloatingBaseBodies()]
    if plant.IsAnchored(base):
        welds = _listed(
            f"{joint.name()} (on {joint.child_body().name()})"
            for joint in joints
            if isinstance(joint, WeldJoint)
            and joint.parent_body().index() == plant.world_body().index()
        )
        raise model.error(
            f"base '{base.name()}' is welded to the world{welds and ' by '}{welds}; a "
            "spacecraft's base must be free. Take that weld out of a copy of the file (MJCF: "
            "add a freejoint); to put an arm on a base, write model directives (.dmd.yaml): "
            "add_model the base, add_model the arm, add_weld with parent BASE::LINK and child "
            "ARM::FIRST_LINK"
        )
    if base.index() not in [body.index() for body in floating]:
        names = _listed(body.name() for body in floating)
        raise model.error(
            f"'{base.name()}' is not the floating base; free bodies are: {names or 'none'}"
        )
    if len(floating) > 1:
        loose = _listed(body.name() for body in floating if body.index() != base.index())
        raise model.error(f"bodies not connected to the base '{base.name()}': {loose}")
    if plant.IsAnchored(capture_frame.body()):
        raise model.error(f"capture frame '{capture_frame.name()}' is fixed in the world")

    movable = [joint for joint in joints if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
    for joint in joints:
        of_base = joint.child_body().index() == base.index() and joint.num_velocities() == 6
        if not (of_base or isinstance(joint, (RevoluteJoint, PrismaticJoint, WeldJoint))):
            raise model.error(
                f"joint '{joint.name()}' is of type {joint.type_name()}; only revolute, "
                "prismatic and fixed joints are supported"
            )
    for joint in movable:
        for body in (joint.parent_body(), joint.child_body()):
            _require_inertia(model, plant, body)
    return sorted(movable, key=lambda joint: joint.position_start())


def _require_inertia(model: ModelFile, plant: MultibodyPlant, body: RigidBody) -> None:
    """Refuse bodies that are welded together and have a geometry, but no inertia in their file."""
    welded = plant.GetBodiesWeldedTo(body)
    hollow = [each.name() for each in welded if each.name() in model.contents.hollow]
    if hollow and not any(b.default_mass() > 0 and b.name() not in hollow for b in welded):
        raise model.error(
            f"link '{hollow[0]}' moves and has a geometry but no <inertial>: give it a mass and an "
            "inertia"
        )


# -- the tree as arrays ----------------------------------------------------------------------------


def extract_tree(
    plant: MultibodyPlant, base: RigidBody, capture_frame: Frame, joints: Sequence[Joint]
) -> KinematicTree:
    """Return the tree of a finalized plant, from the base outwards.

    The parent link of a joint in the file may be inboard or outboard.

    Args:
        plant: holds one tree of revolute, prismatic and weld joints on `base`.
        base: body B.
        capture_frame: frame C, fixed on a body of the tree.
        joints: the movable joints in the order of the tree's columns of q.

    """
    column = {joint.index(): k for k, joint in enumerate(joints)}
    adjacent: dict[BodyIndex, list[Joint]] = {}
    for k in plant.GetJointIndices():
        joint = plant.get_joint(k)
        for body in (joint.parent_body(), joint.child_body()):
            adjacent.setdefault(body.index(), []).append(joint)
    order, queue = {base.index(): 0}, [base]
    bodies = [_tree_body(base)]
    for inboard in queue:
        for joint in adjacent[inboard.index()]:
            forward = joint.parent_body().index() == inboard.index()
            outboard = joint.child_body() if forward else joint.parent_body()
            if outboard.index() in order or outboard.index() == plant.world_body().index():
                continue
            frames = [joint.frame_on_parent(), joint.frame_on_child()]
            frame_F, frame_M = frames if forward else frames[::-1]
            X_PF, X_MB = frame_F.GetFixedPoseInBodyFrame(), frame_M.GetFixedPoseInBodyFrame()
            X_MB = X_MB.inverse()
            axis = np.zeros(3)
            if isinstance(joint, WeldJoint):
                X_MB = (joint.X_FM() if forward else joint.X_FM().inverse()) @ X_MB
            elif isinstance(joint, RevoluteJoint):
                axis = joint.revolute_axis()
            else:
                axis = joint.translation_axis()
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
    X_BC = capture_frame.GetFixedPoseInBodyFrame()
    place = order[capture_frame.body().index()]
    return KinematicTree(tuple(bodies), place, X_BC.rotation().matrix(), X_BC.translation())


def _tree_body(body: RigidBody, **members: Any) -> TreeBody:
    """Return a body with these members of its joint; the base has none."""
    mass, com, inertia = body.default_mass(), np.zeros(3), np.zeros((3, 3))
    if mass > 0:
        parameters = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
        com, inertia = parameters.p_CTcm_C, parameters.I_TTcm_C
    return TreeBody(name=body.name(), mass=mass, p_BBcm=com, I_BBcm=inertia, **members)


# -- limits ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of J joints; infinite where the model has none.

    Attributes:
        lowest: (J,) lowest positions [rad or m].
        highest: (J,) highest positions [rad or m].
        rates: (J,) largest speeds [rad/s or m/s].
        efforts: (J,) largest efforts of the motors [N·m or N].

    """

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    rates: NDArray[np.float64]
    efforts: NDArray[np.float64]


def joint_limits(model: ModelFile, plant: MultibodyPlant, joints: Sequence[Joint]) -> JointLimits:
    """Return the limits of these joints of a finalized plant of the model.

    The effort limit is that of the joint's actuator in the plant. A joint without actuator has the
    limit in its URDF. An effort limit of zero means that none is stated.
    """
    actuators = [plant.get_joint_actuator(k) for k in plant.GetJointActuatorIndices()]
    stated = {each.joint().index(): each.effort_limit() for each in actuators}
    efforts = [
        stated.get(joint.index()) or model.contents.efforts.get(joint.name()) or np.inf
        for joint in joints
    ]
    return JointLimits(
        lowest=np.array([joint.position_lower_limit() for joint in joints]),
        highest=np.array([joint.position_upper_limit() for joint in joints]),
        rates=np.array([joint.velocity_upper_limits()[0] for joint in joints]),
        efforts=np.array(efforts),
    )
