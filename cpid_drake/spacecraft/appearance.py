"""Geometry of a target, from a model file or its inertia."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    CollisionFilterDeclaration,
    Ellipsoid,
    GeometrySet,
    ProximityProperties,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody, SpatialInertia

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.model_file import ModelFile

OPACITY = 0.5
"""Of a target, so that an estimate inside of it is seen."""


def inertia_ellipsoid(M_TCo_C: SpatialInertia) -> tuple[Array, RigidTransform]:
    """Return the solid, homogeneous ellipsoid that has this spatial inertia.

    Returns:
        Semi-diameters (3,) [m], each at least 2 % of the largest so that a flat body is visible,
        and the pose X_CE of the ellipsoid's frame E in C.

    """
    semi_diameters, X_CE = M_TCo_C.CalcPrincipalSemiDiametersAndPoseForSolidEllipsoid()
    return np.maximum(semi_diameters, max(0.02 * semi_diameters.max(), 1e-4)), X_CE


def three_sigma_ellipsoid(p_CTcm_C: Array, covariance: Array) -> tuple[Array, RigidTransform]:
    """Return the ellipsoid of three standard deviations of a centre of mass.

    Args:
        p_CTcm_C: (3,) the centre of mass [m].
        covariance: (3, 3) of it.

    Returns:
        Semi-diameters (3,) [m], and the pose X_CS of the ellipsoid's frame S in C.

    """
    variances, axes = np.linalg.eigh(covariance)
    axes[:, 2] *= np.linalg.det(axes)
    R_CS = RotationMatrix.ProjectToRotationMatrix(axes)
    return 3 * np.sqrt(np.maximum(variances, 0.0)), RigidTransform(R_CS, p_CTcm_C)


def add_target_appearance(
    plant: MultibodyPlant,
    body: RigidBody,
    M_TCo_C: SpatialInertia,
    visual_model: Path | None,
    folders: Mapping[str, Path],
) -> None:
    """Add visual and collision geometry to a target's body, before the plant is finalized.

    Args:
        plant: a plant that is registered with a SceneGraph.
        body: the target's body, whose frame is C.
        M_TCo_C: the target's spatial inertia about C's origin, in C.
        visual_model: a model file; its root body's frame is placed on C. Without one, the visual
            geometry is the solid ellipsoid of the same inertia, and there is no collision geometry.
        folders: see `ModelFile`.

    Raises:
        InputError: the model file cannot be read, or its bodies can move relative to each other.

    """
    if visual_model is None:
        semi_diameters, X_CE = inertia_ellipsoid(M_TCo_C)
        grey = [0.6, 0.6, 0.62, OPACITY]
        plant.RegisterVisualGeometry(body, X_CE, Ellipsoid(*semi_diameters), "ellipsoid", grey)
        return
    file, model, scene_graph = ModelFile(visual_model, folders), MultibodyPlant(0.0), SceneGraph()
    model.RegisterAsSourceForSceneGraph(scene_graph)
    file.parse_into(model)
    file.finalize(model)
    if model.num_bodies() == 1 or model.num_velocities() > 6:
        raise InputError(f"{visual_model}: a target is one rigid body, without joints")
    context, inspector = model.CreateDefaultContext(), scene_graph.model_inspector()
    bodies = [model.get_body(BodyIndex(k)) for k in range(1, model.num_bodies())]
    X_RW = model.EvalBodyPoseInWorld(context, bodies[0]).inverse()
    properties = ProximityProperties()
    AddContactMaterial(properties, friction=CoulombFriction(0.0, 0.0))
    for part in bodies:
        X_RP = X_RW @ model.EvalBodyPoseInWorld(context, part)
        frame = model.GetBodyFrameIdOrThrow(part.index())
        for role in (Role.kIllustration, Role.kProximity):
            for geometry in inspector.GetGeometries(frame, role):
                X_RG = X_RP @ inspector.GetPoseInFrame(geometry)
                name = f"{part.name()}_{inspector.GetName(geometry).rpartition('::')[2]}"
                if role == Role.kProximity:
                    shape = inspector.GetShape(geometry)
                    plant.RegisterCollisionGeometry(body, X_RG, shape, name, properties)
                    continue
                instance = inspector.CloneGeometryInstance(geometry)
                instance.set_pose(X_RG)
                instance.set_name(name)
                material = instance.mutable_illustration_properties()
                if material.HasProperty("phong", "diffuse"):
                    color = material.GetProperty("phong", "diffuse")
                    assert isinstance(color, Rgba)
                    color.update(a=OPACITY * color.a())
                    material.UpdateProperty("phong", "diffuse", color)
                plant.RegisterVisualGeometry(body, instance)


def switch_contact_off(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Let no bodies of a finalized plant touch each other."""
    bodies = (plant.get_body(BodyIndex(k)) for k in range(plant.num_bodies()))
    shapes = [g for each in bodies for g in plant.GetCollisionGeometriesForBody(each)]
    filters = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(shapes))
    scene_graph.collision_filter_manager().Apply(filters)
