"""A spacecraft and the estimate of its target in Meshcat, state by state, without a simulation."""

from pathlib import Path

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.identification.result import Identification
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.scene_visualizer import SceneVisualizer, add_bodies


class Scene:
    """What `SceneVisualizer` and Drake draw of a spacecraft, at states that are given.

    Args:
        spacecraft: the spacecraft model.
        meshcat: where to draw.
        truth: the true target, if it is known from a simulation.
        visual_model: model file with the true target's shape; default: an ellipsoid of its inertia.

    Raises:
        InputError: shapes of the model cannot be read.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        meshcat: Meshcat,
        *,
        truth: InertialParameters | None = None,
        visual_model: str | Path | None = None,
    ) -> None:
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        if truth is None:
            spacecraft.add_alone_to(self._plant)
        else:
            spacecraft.add_to(
                self._plant, truth, scene_graph=scene_graph, target_visual_model=visual_model
            )
        add_bodies(builder, self._plant, scene_graph, meshcat)
        visualizer = SceneVisualizer(spacecraft, meshcat=meshcat, truth=truth)
        self._scene = builder.AddSystem(visualizer)
        builder.Connect(self._plant.get_state_output_port(), self._scene.GetInputPort("state"))
        self._place = spacecraft.state_columns["p_WB"]
        self._start: Array | None = None
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def draw(self, time: float, state: Array, estimate: Identification | None = None) -> None:
        """Draw the spacecraft at a state x = [q; v], and an estimate; the first is at W's origin.

        Args:
            time: of a recording [s]; it must not decrease.
            state: (nx,) of the spacecraft's plant.
            estimate: the identification; None for none yet.

        """
        values = (np.full(100, np.nan), SpatialInertia.NaN(), 0.0)
        if estimate is not None:
            values = (
                estimate.covariance.ravel(),
                estimate.spatial_inertia(),
                float(estimate.passed),
            )
        inputs = self._scene.GetMyMutableContextFromRoot(self._context)
        self._scene.GetInputPort("covariance").FixValue(inputs, values[0])
        self._scene.GetInputPort("spatial_inertia").FixValue(inputs, Value(values[1]))
        self._scene.GetInputPort("checks_passed").FixValue(inputs, [values[2]])
        if self._start is None:
            self._start = state[self._place]
        near = state.copy()
        near[self._place] -= self._start
        plant = self._plant.GetMyMutableContextFromRoot(self._context)
        self._plant.SetPositionsAndVelocities(plant, near)
        self._context.SetTime(time)
        self._diagram.ForcedPublish(self._context)
