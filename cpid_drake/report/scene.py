"""Pictures of a spacecraft and its target, rendered offscreen by Drake."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from cpid_drake.scenario.schema import Scenario

_SPACE = (0.03, 0.035, 0.06)
_OVERSAMPLING = 2
_SIZE = (900, 640)  # of the pictures [px]
_EYE = np.array([6.6, -4.2, 3.4])  # position of the camera, in W [m]
_LOOK_AT = np.array([0.8, -0.1, -0.35])  # centre of the picture, in W [m]; W's z axis is up
_FIELD_OF_VIEW = 0.78  # vertical [rad]


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
    plant = MultibodyPlant(time_step=0.0)
    _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
    spacecraft = scenario.spacecraft.make()
    spacecraft.add_to(
        plant,
        scenario.target_truth(),
        scene_graph=scene_graph,
        target_visual_model=scenario.target.visual_model,
    )

    engine = RenderEngineVtkParams(default_clear_color=list(_SPACE))
    engine.cast_shadows = False
    engine.lights = [
        LightParameter(
            type="directional", direction=[-0.6, 0.5, -0.9], intensity=1.2, frame="world"
        ),
        LightParameter(
            type="directional", direction=[0.0, -0.2, 1.0], intensity=0.45, frame="camera"
        ),
    ]
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(engine))
    width, height = (_OVERSAMPLING * length for length in _SIZE)
    core = RenderCameraCore(
        "vtk",
        CameraInfo(width, height, _FIELD_OF_VIEW),
        ClippingRange(0.05, 100.0),
        RigidTransform(),
    )
    camera = builder.AddSystem(
        RgbdSensor(
            scene_graph.world_frame_id(),
            _look_at(_EYE, _LOOK_AT),
            ColorRenderCamera(core, False),
            DepthRenderCamera(core, DepthRange(0.1, 50.0)),
        )
    )
    builder.Connect(scene_graph.get_query_output_port(), camera.query_object_input_port())
    diagram = builder.Build()

    context = diagram.CreateDefaultContext()
    pictures = []
    for state in states:
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), state)
        image = camera.color_image_output_port().Eval(camera.GetMyContextFromRoot(context))
        pixels = np.array(image.data[:, :, :3], dtype=float)
        blocks = pixels.reshape(_SIZE[1], _OVERSAMPLING, _SIZE[0], _OVERSAMPLING, 3)
        pictures.append(blocks.mean(axis=(1, 3)).round().astype(np.uint8))
    return pictures


def _look_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> RigidTransform:
    """Return the pose X_WCamera of a camera at `eye`: z forward, x right, y down."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    return RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=1)), eye)
