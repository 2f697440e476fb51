"""What a parsed plant says of a spacecraft: its names, its tree of joints, and their limits."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from pydrake.math import RigidTransform
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

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.files.errors import InputError, listed
from cpid_drake.spacecraft.model_file import ModelFile

_Element = TypeVar("_Element", RigidBody, Joint)


def find_element(plant: MultibodyPlant, kind: str, name: str, where: str) -> Any:
    """Return the "Body" or "Frame" of this name, bare or scoped as `instance::name`.

    Raises:
        InputError: there is none, or more than one; the message begins with `where`.

    """
    scope, _, bare = name.rpartition("::")
    find = getattr(plant, f"Get{kind}ByName")
    try:
        return find(bare, plant.GetModelInstanceByName(scope)) if scope else find(name)
    except RuntimeError as error:
        text = str(error).partition("(): ")[2]
        remedy = "scope a name as INSTANCE::NAME"
        if where.endswith(".xml"):
            remedy += "; a <site> is not read: write a <body> in its place"
        raise InputError(f"{where}: {text:.400}; {remedy}") from error


def find_counterpart(
    plant: MultibodyPlant,
    element: _Element,
    has: Callable[[str, ModelInstanceIndex], bool],
    get: Callable[[str, ModelInstanceIndex], _Element],
    instance: ModelInstanceIndex | None = None,
) -> _Element:
    """Return the body or joint of another plant that has this one's name.

    Its model instance is the given one, or that of the same name, or the only one that has it.

    Args:
        plant: the other plant.
        element: the body or joint.
        has, get: the other plant's methods that find such an element by name and instance.
        instance: the model instance; default: any.

    Raises:
        InputError: there is none, or more than one.

    """
    name = element.name()
    scope = element.GetParentPlant().GetModelInstanceName(element.model_instance())
    instances = [ModelInstanceIndex(k) for k in range(plant.num_model_instances())]
    among = [k for k in instances if instance in (None, k) and has(name, k)]
    scopes = [plant.GetModelInstanceName(k) for k in among]
    if not among:
        raise InputError(
            f"the plant has no '{name}' of the spacecraft model: connect the state of a plant of "
            "the same spacecraft"
        )
    if len(among) > 1 and scope not in scopes:
        raise InputError(
            f"the plant has '{name}' in {listed(scopes)}: connect its "
            "get_state_output_port(model_instance) of one of them"
        )
    return get(name, among[scopes.index(scope) if scope in scopes else 0])


def floating_joint(plant: MultibodyPlant, base: RigidBody) -> QuaternionFloatingJoint:
    """Return the joint on which a base floats freely in W, with a quaternion as attitude.

    Raises:
        InputError: the base is on another joint.

    """
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        frames = joint.frame_on_parent(), joint.frame_on_child()
        if (
            isinstance(joint, QuaternionFloatingJoint)
            and joint.child_body().index() == base.index()
            and all(frame.is_body_frame() for frame in frames)
        ):
            return joint
    raise InputError(
        f"the base '{base.name()}' must float freely in the plant, with a quaternion as attitude "
        "(QuaternionFloatingJoint from world), not with roll, pitch and yaw or on another joint"
    )


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
    loose = [body for body in floating if body.index() != base.index()]
    if plant.IsAnchored(base):
        raise model.error(
            f"base '{base.name()}' is welded to the world; a spacecraft's base must be free. Take "
            "that weld out of a copy of the file (MJCF: add a freejoint); to put an arm on a base, "
            "write model directives (.dmd.yaml): add_model the base, add_model the arm, add_weld "
            "with parent BASE::LINK and child ARM::FIRST_LINK"
        )
    if len(loose) == len(floating):
        names = listed(sorted(body.name() for body in floating)) or "none"
        raise model.error(f"'{base.name()}' is not the floating base; free bodies are: {names}")
    if loose:
        names = listed(sorted(body.name() for body in loose))
        raise model.error(f"bodies not connected to the base '{base.name()}': {names}")
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
    for body in (body for joint in movable for body in (joint.parent_body(), joint.child_body())):
        welded, hollow = plant.GetBodiesWeldedTo(body), model.hollow
        named = [each.name() for each in welded if each.name() in hollow]
        if named and not any(b.default_mass() > 0 and b.name() not in hollow for b in welded):
            raise model.error(
                f"link '{named[0]}' moves and has a geometry but no <inertial>: give it a mass and "
                "an inertia"
            )
    return sorted(movable, key=lambda joint: joint.position_start())


def extract_tree(
    plant: MultibodyPlant, base: RigidBody, capture_frame: Frame, joints: Sequence[Joint]
) -> KinematicTree:
    """Return the tree of a finalized plant, from the base outwards.

    The parent link of a joint in the file may be inboard or outboard. A body's frame in the tree is
    its joint's outboard frame M.

    Args:
        plant: holds one tree of revolute, prismatic and weld joints on `base`.
        base: body B.
        capture_frame: frame C, fixed on a body of the tree.
        joints: the movable joints in the order of the tree's columns of q.

    """
    column = {joint.index(): k for k, joint in enumerate(joints)}
    adjacent: dict[BodyIndex, list[Joint]] = {}
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        for body in (joint.parent_body(), joint.child_body()):
            adjacent.setdefault(body.index(), []).append(joint)
    # For each body, its place in the tree and the pose of its own frame in the joint's frame.
    found, queue = {base.index(): (0, RigidTransform())}, [base]
    bodies = [_tree_body(base, RigidTransform())]
    for inboard in queue:
        for joint in adjacent[inboard.index()]:
            forward = joint.parent_body().index() == inboard.index()
            outboard = joint.child_body() if forward else joint.parent_body()
            if outboard.index() in found or outboard.index() == plant.world_body().index():
                continue
            frames = [joint.frame_on_parent(), joint.frame_on_child()]
            X_PF, X_BM = (f.GetFixedPoseInBodyFrame() for f in frames[:: 1 if forward else -1])
            parent, X_MP = found[inboard.index()]
            X_MF, X_MB, axis = X_MP @ X_PF, X_BM.inverse(), np.zeros(3)
            if isinstance(joint, WeldJoint):
                X_FM = joint.X_FM() if forward else joint.X_FM().inverse()
                X_MF, X_MB = X_MF @ X_FM @ X_MB, RigidTransform()
            elif isinstance(joint, RevoluteJoint):
                axis = joint.revolute_axis()
            else:
                axis = joint.translation_axis()
            found[outboard.index()] = (len(bodies), X_MB)
            bodies.append(
                _tree_body(
                    outboard,
                    X_MB,
                    parent=parent,
                    joint=column.get(joint.index(), -1),
                    prismatic=isinstance(joint, PrismaticJoint),
                    axis_F=axis if forward else -axis,
                    R_PF=X_MF.rotation().matrix(),
                    p_PF=X_MF.translation(),
                )
            )
            queue.append(outboard)
    place, X_MB = found[capture_frame.body().index()]
    X_MC = X_MB @ capture_frame.GetFixedPoseInBodyFrame()
    return KinematicTree(tuple(bodies), place, X_MC.rotation().matrix(), X_MC.translation())


def _tree_body(body: RigidBody, X_MB: RigidTransform, **joint: Any) -> TreeBody:
    """Return a body with its mass properties in M, and the members of its joint."""
    mass, com, inertia, R_MB = body.default_mass(), np.zeros(3), np.zeros((3, 3)), X_MB.rotation()
    if mass > 0:
        own = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
        com, inertia = X_MB @ own.p_CTcm_C, R_MB.matrix() @ own.I_TTcm_C @ R_MB.matrix().T
    return TreeBody(name=body.name(), mass=mass, p_BBcm=com, I_BBcm=inertia, **joint)


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of J joints; infinite where the model has none.

    Attributes:
        lowest: (J,) lowest positions [rad or m].
        highest: (J,) highest positions [rad or m].
        rates: (J,) largest speeds [rad/s or m/s].
        efforts: (J,) largest efforts of the motors [N·m or N].

    """

    lowest: Array
    highest: Array
    rates: Array
    efforts: Array


def joint_limits(model: ModelFile, plant: MultibodyPlant, joints: Sequence[Joint]) -> JointLimits:
    """Return the limits of these joints of a finalized plant of the model.

    The effort limit is that of the joint's actuator in the plant. A joint without actuator has the
    limit in its URDF. An effort limit of zero means that none is stated.
    """
    actuators = [plant.get_joint_actuator(k) for k in plant.GetJointActuatorIndices()]
    stated = {each.joint().index(): each.effort_limit() for each in actuators}
    efforts = [
        stated.get(joint.index()) or model.efforts.get(joint.name()) or np.inf for joint in joints
    ]
    return JointLimits(
        lowest=np.array([joint.position_lower_limit() for joint in joints]),
        highest=np.array([joint.position_upper_limit() for joint in joints]),
        rates=np.array([joint.velocity_upper_limits()[0] for joint in joints]),
        efforts=np.array(efforts),
    )
