"""How a target looks: its inertia's ellipsoid, or the geometry of a model file."""

import numpy as np
import pytest
from pydrake.geometry import Ellipsoid, Role
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from cpid_drake import InputError
from cpid_drake.spacecraft.appearance import inertia_ellipsoid

JOINT = (
    '<joint name="j" type="{}"><parent link="a"/><child link="b"/><origin xyz="0 0 1" '
    'rpy="0 0 1.5707963267948966"/><axis xyz="0 0 1"/></joint>'
)


@pytest.fixture
def draw(servicer):
    """Return a function (target, look) -> [(shape, X_CG)] of the target's visual geometry."""

    def make(target, look=None):
        builder = DiagramBuilder()
        plant = MultibodyPlant(time_step=0.0)
        _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
        body = servicer.add_to(plant, target, scene_graph=scene_graph, target_visual_model=look)
        inspector = scene_graph.model_inspector()
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        if look is None:
            assert not plant.GetCollisionGeometriesForBody(body)
        return [
            (inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry))
            for geometry in inspector.GetGeometries(frame, Role.kIllustration)
        ]

    return make


@pytest.fixture
def model(tmp_path):
    """Return a function that writes a URDF of these parts and returns its path."""

    def make(*parts, ending=".urdf"):
        path = tmp_path / f"look{ending}"
        path.write_text(f'<robot name="look">{"".join(parts)}</robot>')
        return path

    return make


def test_the_ellipsoid_of_a_solid_ellipsoid_is_itself():
    X_CE = RigidTransform(RollPitchYaw(0.3, -0.5, 0.8), [0.4, -0.1, 0.2])
    M_E = SpatialInertia.SolidEllipsoidWithMass(12.0, 0.9, 0.5, 0.3)
    M_C = M_E.ReExpress(X_CE.rotation()).Shift(-X_CE.translation())
    found, X_CF = inertia_ellipsoid(M_C)
    np.testing.assert_allclose(np.sort(found), [0.3, 0.5, 0.9], rtol=1e-10)
    np.testing.assert_allclose(X_CF.translation(), X_CE.translation(), atol=1e-12)
    shape = (X_CF.rotation().matrix() * found**2) @ X_CF.rotation().matrix().T
    R = X_CE.rotation().matrix()
    np.testing.assert_allclose(shape, R @ np.diag([0.81, 0.25, 0.09]) @ R.T, atol=1e-10)


def test_a_target_without_visual_model_is_drawn_as_its_ellipsoid(draw, skewed_target):
    ((shape, X_CG),) = draw(skewed_target)
    assert isinstance(shape, Ellipsoid)
    np.testing.assert_allclose(X_CG.translation(), skewed_target.p_CTcm_C, atol=1e-12)
    semi_diameters, _ = inertia_ellipsoid(skewed_target.to_spatial_inertia())
    np.testing.assert_allclose([shape.a(), shape.b(), shape.c()], semi_diameters)


def test_where_a_visual_model_stands_in_its_own_file_does_not_matter(draw, tmp_path, paper_target):
    """An SDF's model and link may have poses; C is the link's frame."""
    (tmp_path / "look.sdf").write_text(
        '<sdf version="1.9"><model name="m"><pose>1 2 3 0 0 0.5</pose><link name="a">'
        '<pose>-4 5 6 0.7 0 0</pose><visual name="v"><pose>0.1 0.2 0.3 0 0 0</pose><geometry><box>'
        "<size>1 2 3</size></box></geometry></visual></link></model></sdf>"
    )
    ((_, X_CG),) = draw(paper_target, tmp_path / "look.sdf")
    assert X_CG.IsNearlyEqualTo(RigidTransform([0.1, 0.2, 0.3]), 1e-12)


def refusal(draw, *args) -> str:
    with pytest.raises(InputError) as caught:
        draw(*args)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_look_that_can_move_is_refused(draw, model, paper_target):
    look = model('<link name="a"/><link name="b"/>', JOINT.format("continuous"))
    assert "one rigid body" in refusal(draw, paper_target, look)
