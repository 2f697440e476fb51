"""Images of a spacecraft and its target, rendered offscreen by Drake."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import MakeRenderEngineVtk, RenderEngineVtkParams
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig, ImageFileFormat, ImageIo, RgbdSensor

from cpid_drake import Scenario

_EYE, _LOOK_AT = np.array([6.6, -4.2, 3.4]), np.array([0.8, -0.1, -0.35])  # of the camera, in W [m]


def render_scenario(scenario: Scenario, states: Sequence[ArrayLike]) -> list[bytes]:
    """Return an image, PNG, of spacecraft and target in each plant state x = [q; v].

    Raises:
        InputError: the scenario cannot be built.

    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    scenario.spacecraft.make().add_to(
        plant,
        scenario.target_truth(),
        scene_graph=scene_graph,
        target_visual_model=scenario.target.visual_model,
    )
    engine = RenderEngineVtkParams(default_clear_color=[0.03, 0.035, 0.06])
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(engine))
    z = _LOOK_AT - _EYE
    x = np.cross(z, [0.0, 0.0, 1.0])
    axes = [each / np.linalg.norm(each) for each in (x, np.cross(z, x), z)]
    X_WCamera = RigidTransform(RotationMatrix(np.column_stack(axes)), _EYE)
    lens = CameraConfig(width=900, height=640, renderer_name="vtk", clipping_far=100.0)
    _, camera = lens.MakeCameras()
    sensor = builder.AddSystem(RgbdSensor(scene_graph.world_frame_id(), X_WCamera, camera))
    builder.Connect(scene_graph.get_query_output_port(), sensor.query_object_input_port())
    diagram = builder.Build()
    context, images = diagram.CreateDefaultContext(), []
    for state in states:
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), state)
        image = sensor.color_image_output_port().Eval(sensor.GetMyContextFromRoot(context))
        images.append(bytes(ImageIo().Save(image, ImageFileFormat.kPng)))
    return images
