"""Conversion of a plant's bodies and joints to a `KinematicTree` of NumPy arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
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

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.tree import KinematicTree, TreeBody


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

    identity = RigidTransform()
    order = {base.index(): 0}
    bodies = [_tree_body(base, -1, -1, False, np.zeros(3), identity, identity)]
    queue = [base]
    for inboard in queue:
        for joint in adjacent[inboard.index()]:
            forward = joint.parent_body().index() == inboard.index()
            outboard = joint.child_body() if forward else joint.parent_body()
            if outboard.index() in order or outboard.index() == plant.world_body().index():
                continue
            frames = [joint.frame_on_parent(), joint.frame_on_child()]
            frame_F, frame_M = frames if forward else frames[::-1]
            X_MB = frame_M.GetFixedPoseInBodyFrame().inverse()
            if isinstance(joint, WeldJoint):
                X_FM = joint.X_FM() if forward else joint.X_FM().inverse()
                X_MB = X_FM @ X_MB
            order[outboard.index()] = len(bodies)
            bodies.append(
                _tree_body(
                    outboard,
                    order[inboard.index()],
                    column.get(joint.index(), -1),
                    isinstance(joint, PrismaticJoint),
                    _axis(joint) if forward else -_axis(joint),
                    frame_F.GetFixedPoseInBodyFrame(),
                    X_MB,
                )
            )
            queue.append(outboard)
    X_BC = capture_frame.GetFixedPoseInBodyFrame()
    return KinematicTree(
        tuple(bodies),
        order[capture_frame.body().index()],
        X_BC.rotation().matrix(),
        X_BC.translation(),
    )


def _axis(joint: Joint) -> NDArray[np.float64]:
    """Return the unit vector (3,) of a joint's axis in its frames F and M; zero for a weld."""
    if isinstance(joint, RevoluteJoint):
        return joint.revolute_axis()
    return joint.translation_axis() if isinstance(joint, PrismaticJoint) else np.zeros(3)


def _tree_body(
    body: RigidBody,
    parent: int,
    joint: int,
    prismatic: bool,
    axis_F: NDArray[np.float64],
    X_PF: RigidTransform,
    X_MB: RigidTransform,
) -> TreeBody:
    mass, com, inertia = body.default_mass(), np.zeros(3), np.zeros((3, 3))
    if mass > 0:
        parameters = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
        com, inertia = parameters.p_CTcm_C, parameters.I_TTcm_C
    return TreeBody(
        body.name(),
        parent,
        joint,
        prismatic,
        axis_F,
        R_PF=X_PF.rotation().matrix(),
        p_PF=X_PF.translation(),
        R_MB=X_MB.rotation().matrix(),
        p_MB=X_MB.translation(),
        mass=mass,
        p_BBcm=com,
        I_BBcm=inertia,
    )
