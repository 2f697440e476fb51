"""Bodies that could be, but hardly are those of this spacecraft: far larger than the links are.

A radius of gyration is below the distance of the body's farthest point from its centre of mass.
"""

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.link_inertia import BodyFinding

FAR = 2.0
"""How often a radius of gyration exceeds the distances of the joints near a link if it is
implausible. Parts may project beyond them."""


def oversized(
    tree: KinematicTree, parse_into: Callable[[MultibodyPlant], object]
) -> Iterator[BodyFinding]:
    """Yield the bodies whose radius of gyration exceeds the joints near them, and their geometry.

    Without a geometry nothing limits the base.

    Args:
        tree: the bodies.
        parse_into: adds the model to a plant; it is called if a body needs its geometry.

    """
    meshes = [
        (k, gyration, reach)
        for k, (gyration, reach) in enumerate(zip(_gyrations(tree), _reaches(tree)))
        if reach > 0 and gyration > FAR * reach
    ]
    extents = _extents(parse_into) if meshes else {}
    for k, gyration, reach in meshes:
        body = tree.bodies[k]
        drawn = extents.get(body.name, 0.0)
        if gyration <= drawn or (not drawn and k == 0):
            continue
        size = f"its geometry is within {drawn:.2g} m"
        if not drawn:
            size = f"the joints of it and beside it are within {reach:.2g} m"
        yield BodyFinding(
            body.name,
            f"{body.mass:.3g} kg with a radius of gyration of {gyration:.2g} m",
            f"{size} of its centre of mass",
            impossible=False,
        )


def _gyrations(tree: KinematicTree) -> list[float]:
    """Return the largest radius of gyration of each body [m]; zero without a mass."""
    moments = (np.linalg.eigvalsh(body.I_BBcm)[-1] for body in tree.bodies)
    return [
        float(np.sqrt(max(moment, 0.0) / body.mass)) if body.mass > 0 else 0.0
        for body, moment in zip(tree.bodies, moments, strict=True)
    ]


def _reaches(tree: KinematicTree) -> list[float]:
    """Return how far the joints of each body and beside it are from its centre of mass [m]."""
    joints = 1 + max([body.joint for body in tree.bodies], default=-1)
    motion, _ = forward_kinematics(tree, *np.zeros((2, 1, joints)))
    coms = motion.r[:, 0]
    places = [
        r - R @ body.p_BBcm for r, R, body in zip(coms, motion.R[:, 0], tree.bodies, strict=True)
    ]
    at: list[set[int]] = [{k} if k else set() for k in range(len(tree.bodies))]
    for k, body in enumerate(tree.bodies[1:], start=1):
        at[body.parent].add(k)
    reaches = []
    for k, body in enumerate(tree.bodies):
        near = {k, *at[k], *([body.parent] if k else [])}
        points = np.array([places[j] for m in near for j in at[m]]).reshape(-1, 3)
        reaches.append(float(np.linalg.norm(points - coms[k], axis=1).max(initial=0.0)))
    return reaches


def _extents(parse_into: Callable[[MultibodyPlant], object]) -> dict[str, float]:
    """Return how far the geometry of bodies is from their centres of mass [m], by their names.

    Geometry that Drake cannot read is left out.
    """
    plant, graph, extents = MultibodyPlant(0.0), SceneGraph(), dict[str, float]()
    plant.RegisterAsSourceForSceneGraph(graph)
    try:
        parse_into(plant)
    except InputError:
        return extents
    inspector = graph.model_inspector()
    for k in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(k))
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        for role in (Role.kIllustration, Role.kProximity):
            for shape in inspector.GetGeometries(frame, role):
                if (box := inspector.GetObbInGeometryFrame(shape)) is not None:
                    corners = box.half_width() * np.array(list(product((-1, 1), repeat=3)))
                    X_BH = inspector.GetPoseInFrame(shape) @ box.pose()
                    apart = (X_BH @ corners.T).T - body.default_com()
                    size = float(np.linalg.norm(apart, axis=1).max())
                    extents[body.name()] = max(size, extents.get(body.name(), 0.0))
    return extents
