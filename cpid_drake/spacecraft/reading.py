"""What a parsed plant says of a spacecraft: its names, its tree of joints, and their limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    Joint,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.files.errors import InputError, choose_from, listed
from cpid_drake.spacecraft.floating_base import connected, joints_of
from cpid_drake.spacecraft.mimic_joints import JointCoupling
from cpid_drake.spacecraft.model_file import ModelFile

_LINES = (
    '<inertial><mass value="M"/><inertia ixx="A" iyy="A" izz="C" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>",
    "<inertial><mass>M</mass><inertia><ixx>A</ixx><iyy>A</iyy><izz>C</izz></inertia></inertial>",
)
"""The lines that a link without inertia lacks, in URDF and in SDF."""


def movable_joints(
    model: ModelFile, plant: MultibodyPlant, base: RigidBody, capture_frame: Frame
) -> list[Joint]:
    """Return the revolute and prismatic joints of a finalized plant, in the order of q.

    Raises:
        InputError: the base does not float, a body with a mass is not connected to it, C is fixed
            in the world, a joint is of a type that is not supported, or a body that joints move has
            a geometry and no inertia.

    """
    joints, bodies = joints_of(plant), [*connected(plant, base)]
    tree = {body.index() for body, _ in bodies}
    own = [j for j in joints if j.parent_body().index() in tree and j.child_body().index() in tree]
    path = bodies[-1][1]  # after Finalize one leads to the world
    if path[0].num_velocities() != 6:
        raise model.error(
            f"base '{base.name()}' does not float freely: joint '{path[-1].name()}' holds it in "
            'the world; take that joint out of a copy of the file, or write type="floating"'
        )
    others = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    others = [body for body in others if body.index() not in tree]
    loose = [body for body in others if body.default_mass() > 0 or not plant.IsAnchored(body)]
    if loose:
        names = listed(sorted(body.name() for body in loose))
        raise model.error(
            f"bodies not connected to the base '{base.name()}': {names}; join them to it, or take "
            "them out of a copy of the file"
        )
    if plant.IsAnchored(capture_frame.body()):
        raise model.error(f"capture frame '{capture_frame.name()}' is fixed in the world")

    movable = [joint for joint in own if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
    for joint in own:
        of_base = joint.child_body().index() == base.index() and joint.num_velocities() == 6
        if not (of_base or isinstance(joint, (RevoluteJoint, PrismaticJoint, WeldJoint))):
            raise model.error(
                f"joint '{joint.name()}' is of type {joint.type_name()}; only revolute, "
                "prismatic and fixed joints are supported"
            )
    for body in (body for joint in movable for body in (joint.parent_body(), joint.child_body())):
        welded, hollow = plant.GetBodiesWeldedTo(body), model.content.hollow
        named = [each.name() for each in welded if each.name() in hollow]
        if named and not any(b.default_mass() > 0 and b.name() not in hollow for b in welded):
            raise model.error(
                f"link '{named[0]}' moves and has a geometry but no <inertial>; write in it "
                f"{_LINES[model.path.suffix == '.sdf']} with its mass M and its moments A and C; a "
                "wheel of radius r and width w about z has C = M r²/2 and A = C/2 + M w²/12"
            )
    return sorted(movable, key=lambda joint: joint.position_start())


def extract_tree(
    plant: MultibodyPlant, base: RigidBody, capture_frame: Frame, coupling: JointCoupling
) -> KinematicTree:
    """Return the tree of a finalized plant, from the base outwards.

    The parent link of a joint in the file may be inboard or outboard. A body's frame in the tree is
    its joint's outboard frame M.

    Args:
        plant: holds one tree of revolute, prismatic and weld joints on `base`.
        base: body B.
        capture_frame: frame C, fixed on a body of the tree.
        coupling: the movable joints, and which of them are the tree's columns of q.

    """
    leaders = {joint.index() for joint in coupling.leaders}
    adjacent: dict[BodyIndex, list[Joint]] = {}
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        for body in (joint.parent_body(), joint.child_body()):
            adjacent.setdefault(body.index(), []).append(joint)
    # For each body, its place in the tree and the pose of its own frame in the joint's frame.
    places, queue = {base.index(): (0, RigidTransform())}, [base]
    bodies = [_tree_body(base, RigidTransform())]
    for inboard in queue:
        for joint in adjacent[inboard.index()]:
            forward = joint.parent_body().index() == inboard.index()
            outboard = joint.child_body() if forward else joint.parent_body()
            if outboard.index() in places or outboard.index() == plant.world_body().index():
                continue
            frames = [joint.frame_on_parent(), joint.frame_on_child()]
            X_PF, X_BM = (f.GetFixedPoseInBodyFrame() for f in frames[:: 1 if forward else -1])
            parent, X_MP = places[inboard.index()]
            X_MF, X_MB, axis = X_MP @ X_PF, X_BM.inverse(), np.zeros(3)
            if isinstance(joint, WeldJoint):
                X_FM = joint.X_FM() if forward else joint.X_FM().inverse()
                X_MF, X_MB = X_MF @ X_FM @ X_MB, RigidTransform()
            elif isinstance(joint, RevoluteJoint):
                axis = joint.revolute_axis()
            else:
                axis = joint.translation_axis()
            axis = axis if forward else -axis
            column, multiplier, offset = -1, 1.0, 0.0
            if not isinstance(joint, WeldJoint):
                column, multiplier, offset = coupling.of(joint)
            if isinstance(joint, RevoluteJoint) and offset:
                X_MF = X_MF @ RigidTransform(AngleAxis(offset, axis), np.zeros(3))
            elif offset:
                X_MF = X_MF @ RigidTransform(offset * axis)
            places[outboard.index()] = (len(bodies), X_MB)
            bodies.append(
                _tree_body(
                    outboard,
                    X_MB,
                    parent=parent,
                    joint=column,
                    multiplier=multiplier,
                    follows=joint.index() not in leaders,
                    joint_name="" if isinstance(joint, WeldJoint) else joint.name(),
                    prismatic=isinstance(joint, PrismaticJoint),
                    axis_F=axis,
                    R_PF=X_MF.rotation().matrix(),
                    p_PF=X_MF.translation(),
                )
            )
            queue.append(outboard)
    place, X_MB = places[capture_frame.body().index()]
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
        stated.get(joint.index()) or model.content.efforts.get(joint.name()) or np.inf
        for joint in joints
    ]
    return JointLimits(
        lowest=np.array([joint.position_lower_limit() for joint in joints]),
        highest=np.array([joint.position_upper_limit() for joint in joints]),
        rates=np.array([joint.velocity_upper_limits()[0] for joint in joints]),
        efforts=np.array(efforts),
    )


def positions_of(
    angles: Mapping[str, float],
    names: Sequence[str],
    limits: JointLimits,
    sliding: set[int],
    where: str,
) -> Array:
    """Return q (J,) of joints; see `Spacecraft.configuration`."""
    q = np.zeros(len(names))
    for name, value in angles.items():
        if name not in names:
            raise InputError(f"{where}: no joint '{name}'; {choose_from(name, names)}")
        if not np.isfinite(value):
            raise InputError(f"{where}: {name} = {value:g} is not a finite number")
        k = names.index(name)
        low, high, radians = limits.lowest[k], limits.highest[k], np.radians(value)
        turns = k not in sliding and abs(value) > 2 * np.pi
        if turns and not low <= value <= high and low <= radians <= high:
            raise InputError(
                f"{where}: {name} = {value:g} is outside [{low:g}, {high:g}]; angles are in "
                f"radians: {value:g} degrees are {radians:.4g}"
            )
        q[k] = value
    return q
