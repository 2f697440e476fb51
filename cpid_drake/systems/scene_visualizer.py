"""A capture in Meshcat, live or recorded: momenta, centre of mass and estimated inertia."""

import logging
from collections.abc import Collection
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatParams, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import angular_momentum, linear_momentum
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import TreeBody
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.appearance import has_shape, inertia_ellipsoid
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.plant_scratch import PlantScratch
from cpid_drake.systems.ports import add_connected
from cpid_drake.systems.scene_layer import Extent, Moment
from cpid_drake.systems.scene_layers import make_layers

FRAME_PERIOD = 1 / 16
"""Time between two drawings [s]."""

_VIEW = np.array([1.35, -1.2, 0.8])  # from the scene to the camera, in W and sizes of the scene


class SceneVisualizer(LeafSystem):
    """Draws the layers of `scene_layers` of a spacecraft that holds a target, at `/cpid/LAYER`.

    The system's centre of mass and the momentum are computed with the true target if it is given,
    else with the estimate. The estimate is not drawn before there is one.

    .. pydrake_system::

        name: SceneVisualizer
        input_ports:
        - state
        - covariance
        - spatial_inertia

    - `state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state).
    - `covariance` (100) and `spatial_inertia`: an identifier's outputs, NaN while unknown.

    Args:
        spacecraft: the known spacecraft.
        meshcat: the Meshcat instance in which the layers are drawn.
        extent: size and momenta of the motion; see `extent_of`.
        truth: the true target; simulation only.
        shapeless: bodies of the spacecraft to draw as boxes; see `shapeless_bodies`.
        period: time between drawings [s].

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        meshcat: Meshcat,
        extent: Extent,
        truth: InertialParameters | None = None,
        shapeless: Collection[BodyIndex] = (),
        period: float = FRAME_PERIOD,
    ) -> None:
        super().__init__()
        self.set_name("scene_visualizer")
        plant = spacecraft.plant
        self._spacecraft, self._truth = spacecraft, truth
        self._scratch = PlantScratch(plant)
        bodies = [plant.get_body(index) for index in shapeless]
        self._bodies = {f"{int(body.index())}_{body.name()}": body for body in bodies}
        inertias = {name: b.default_spatial_inertia() for name, b in self._bodies.items()}
        self._layers = make_layers(meshcat, extent, inertias, truth)
        self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorInputPort("covariance", 100)
        self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
        self.DeclarePeriodicPublishEvent(period_sec=period, offset_sec=0.0, publish=self._draw)
        self.DeclareForcedPublishEvent(self._draw)

    @property
    def has_boxes(self) -> bool:
        """Whether some bodies are drawn as boxes."""
        return bool(self._bodies)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        covariance: OutputPort,
        spatial_inertia: OutputPort,
        **options: Any,
    ) -> "SceneVisualizer":
        """Add a visualizer and connect its inputs.

        Args:
            builder: the diagram's builder.
            spacecraft: the known spacecraft.
            state: x = [q; v], usually `MultibodyPlant.get_state_output_port()`.
            covariance: an identifier's output of this name.
            spatial_inertia: an identifier's output of this name.
            options: further arguments of the constructor.

        Raises:
            InputError: a port has the wrong size for this spacecraft.

        """
        ports = {
            "state": state,
            "covariance": covariance,
            "spatial_inertia": spatial_inertia,
        }
        return add_connected(builder, SceneVisualizer(spacecraft, **options), ports)

    def _draw(self, context: Context) -> EventStatus:
        plant, scratch = self._spacecraft.plant, self._scratch.context
        state = self.GetInputPort("state").Eval(context)
        plant.SetPositionsAndVelocities(scratch, state)
        known = self._spacecraft.momentum_sample(scratch)
        motion = known.motion
        estimate = self.GetInputPort("spatial_inertia").Eval(context)
        estimate = None if estimate.IsNaN() else estimate
        target = self._truth
        if target is None and estimate is not None:
            target = InertialParameters.from_spatial_inertia(estimate)
        moment = Moment(
            plant.EvalBodyPoseInWorld(scratch, self._spacecraft.base),
            RigidTransform(RotationMatrix(motion.R_WC[0]), motion.p_WC[0]),
            known,
            target,
            estimate,
            self.GetInputPort("covariance").Eval(context).reshape(10, 10)[1:4, 1:4],
            {name: plant.EvalBodyPoseInWorld(scratch, b) for name, b in self._bodies.items()},
        )
        for layer in self._layers:
            layer.draw(moment, context.get_time())
        return EventStatus.Succeeded()


def can_be_drawn(spacecraft: Spacecraft) -> bool:
    """Return whether the (optional) geometry of a spacecraft's model can be read."""
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()  # kept for the plant
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    try:
        spacecraft.add_alone_to(plant)
    except InputError:
        return False
    return True


def shapeless_bodies(
    spacecraft: Spacecraft,
    drawn: MultibodyPlant | None = None,
    scene_graph: SceneGraph | None = None,
) -> list[BodyIndex]:
    """Return the spacecraft's bodies that have mass and no shape in the scene.

    Args:
        spacecraft: the spacecraft.
        drawn: the plant that it was added to.
        scene_graph: the scene that `drawn` is registered with; without one no body has a shape.

    """
    plant = spacecraft.plant
    indices = [BodyIndex(k) for k in range(1, plant.num_bodies())]
    indices = [index for index in indices if plant.get_body(index).default_mass() > 0]
    if drawn is None or scene_graph is None:
        return indices
    inspector = scene_graph.model_inspector()
    return [k for k in indices if not has_shape(drawn, drawn.get_body(k), inspector)]


def extent_of(
    spacecraft: Spacecraft, telemetry: Telemetry, target: InertialParameters | None = None
) -> Extent:
    """Return the extent of a motion, from about fifty of its samples.

    Every body is treated as a ball with the largest semi-diameter of its inertia ellipsoid.

    Args:
        spacecraft: the known spacecraft.
        telemetry: the spacecraft's motion.
        target: the target, if it is known.

    """
    some = np.unique(np.linspace(0, len(telemetry) - 1, 50).round().astype(int))
    tree, samples = spacecraft.tree, telemetry.select(some)
    motion, capture = forward_kinematics(tree, **samples.states)
    balls = [*zip(motion.r, map(_radius, tree.bodies)), (capture.p_WC, 0.0)]
    if target is not None:
        semi_diameters, X_CE = inertia_ellipsoid(target.to_spatial_inertia())
        p_WE = capture.p_WC + capture.R_WC @ X_CE.translation()
        balls.append((p_WE, float(semi_diameters.max())))
    centres = np.array([p for p, _ in balls])
    radii = np.array([radius for _, radius in balls])[:, None, None]
    low, high = (centres - radii).min(axis=0), (centres + radii).max(axis=0)
    size = float(np.linalg.norm(high - low, axis=1).max() / 2)
    centre = (low.min(axis=0) + high.max(axis=0)) / 2
    P = linear_momentum(tree, motion)
    p_WS = sum(body.mass * r for body, r in zip(tree.bodies, motion.r, strict=True))
    p_WS = p_WS / spacecraft.mass
    if target is not None:
        p_WT = capture.p_WC + capture.R_WC @ target.p_CTcm_C
        mass = spacecraft.mass + target.mass
        p_WS = (spacecraft.mass * p_WS + target.mass * p_WT) / mass
    L = angular_momentum(tree, motion, p_WS)
    return Extent(
        centre=centre,
        size=size,
        momentum=float(np.linalg.norm(P, axis=1).max()),
        angular_momentum=float(np.linalg.norm(L, axis=1).max()),
    )


def _radius(body: TreeBody) -> float:
    """Return the largest semi-diameter of a body's ellipsoid of inertia [m]; 0 without mass."""
    if not body.mass > 0:
        return 0.0
    moments = np.linalg.eigvalsh(body.I_BBcm)
    return float(np.sqrt(max(2.5 * (moments.sum() - 2 * moments[0]) / body.mass, 0.0)))


def open_meshcat(host: str = "localhost") -> Meshcat:
    """Return a Meshcat that writes nothing to the log.

    Args:
        host: who may connect: "localhost" for this machine alone, "*" for all.

    Raises:
        InputError: none of Meshcat's ports is free.

    """
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host=host))
    except RuntimeError as error:
        raise InputError(f"Meshcat cannot be opened: {error}") from error
    finally:
        logger.setLevel(level)


def prepare_meshcat(meshcat: Meshcat, extent: Extent) -> None:
    """Give Meshcat a dark background, light, and a camera."""
    meshcat.SetProperty("/Background/<object>", "top_color", [0.02, 0.02, 0.06])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.05, 0.05, 0.12])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.2)
    meshcat.SetCameraPose(extent.centre + extent.size * _VIEW, extent.centre)
