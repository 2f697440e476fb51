"""Pictures of a spacecraft and its target, rendered offscreen by Drake."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    ClippingRange,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from cpid_drake.scenario.schema import Scenario

_EYE = np.array([6.6, -4.2, 3.4])  # of the camera, in W [m]: from where arms and wings are seen
_LOOK_AT = np.array([0.8, -0.1, -0.35])  # centre of the picture, in W [m]; W's z axis is up


def render_scenario(scenario: Scenario, states: Sequence[ArrayLike]) -> list[NDArray[np.uint8]]:
    """Render the scenario's spacecraft with its target in several states.

    Args:
        scenario: its spacecraft and target are drawn.
        states: plant states x = [q; v], (nx,) each.

    Returns:
        One (height, width, 3) RGB picture for each state.

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
    lens = CameraInfo(width=1350, height=960, fov_y=0.78)
    core = RenderCameraCore("vtk", lens, ClippingRange(0.05, 100.0), RigidTransform())
    z = (_LOOK_AT - _EYE) / np.linalg.norm(_LOOK_AT - _EYE)
    x = np.cross(z, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(z, [0.0, 0.0, 1.0]))
    X_WCamera = RigidTransform(RotationMatrix(np.column_stack([x, np.cross(z, x), z])), _EYE)
    camera = builder.AddSystem(
        RgbdSensor(
            scene_graph.world_frame_id(), X_WCamera, DepthRenderCamera(core, DepthRange(0.1, 50.0))
        )
    )
    builder.Connect(scene_graph.get_query_output_port(), camera.query_object_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    pictures = []
    for state in states:
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), state)
        image = camera.color_image_output_port().Eval(camera.GetMyContextFromRoot(context))
        pictures.append(image.data[:, :, :3].copy())
    return pictures
