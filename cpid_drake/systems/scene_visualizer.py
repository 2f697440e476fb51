"""What is identified, and the momenta, in Meshcat, beside Drake's visualization of the bodies."""

import logging

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, MeshcatParams, Rgba, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import target_momentum
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.appearance import inertia_ellipsoid
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.plant_scratch import PlantScratch
from cpid_drake.systems.ports import add_connected

FRAME_PERIOD = 1 / 16
"""Time between two drawings [s]: fast enough for the eye, and a page of ten seconds stays small."""

LEGEND = {
    "orange": "estimate: 3 σ, ellipsoid of inertia",
    "skyblue": "momentum P of spacecraft; above: L",
    "yellow": "momentum P of the target; above: L",
    "white": "centre of mass of both",
}
"""What the scene shows, by colours of CSS, as short as the lines of Meshcat's panel."""

_COLORS = {
    "orange": Rgba(1.0, 0.65, 0.0, 1.0),
    "skyblue": Rgba(0.53, 0.81, 0.92, 1.0),
    "yellow": Rgba(1.0, 1.0, 0.0, 1.0),
    "white": Rgba(1.0, 1.0, 1.0, 1.0),
}
_ROOT = "/cpid"
_VIEW = np.array([1.5, -1.25, 0.85])  # from the scene to the camera, in W and reaches


class SceneVisualizer(LeafSystem):
    """Draws the estimated target, the momenta, C and the common centre of mass, at `/cpid`.

    The estimate appears when all ten parameters are known: the ellipsoid of equal inertia as a wire
    frame, the centre of mass, and the ellipsoid of its three standard deviations if that is smaller
    than the spacecraft. Centre of mass and momenta of both are computed with the true target if
    it is given, else with the estimate. The arrows of linear momentum start at the common centre of
    mass, and those of angular momentum about this point above it; the length of an arrow rises with
    the square root of the momentum.

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
        meshcat: where to draw. Its camera is moved so that the spacecraft fills the picture.
        truth: the true target; simulation only.
        period: time between drawings [s].

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        meshcat: Meshcat,
        truth: InertialParameters | None = None,
        period: float = FRAME_PERIOD,
    ) -> None:
        super().__init__()
        self.set_name("scene_visualizer")
        self._spacecraft, self._meshcat, self._truth = spacecraft, meshcat, truth
        self._scratch = PlantScratch(spacecraft.plant)
        self._reach, self._p_WC0 = _size(spacecraft)
        self._create_objects()
        self.DeclareVectorInputPort("state", spacecraft.plant.num_multibody_states())
        self.DeclareVectorInputPort("covariance", 100)
        self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
        self.DeclarePeriodicPublishEvent(period_sec=period, offset_sec=0.0, publish=self._draw)
        self.DeclareForcedPublishEvent(self._draw)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        covariance: OutputPort,
        spatial_inertia: OutputPort,
        meshcat: Meshcat,
        truth: InertialParameters | None = None,
        period: float = FRAME_PERIOD,
    ) -> "SceneVisualizer":
        """Add a visualizer and connect its inputs.

        Args:
            builder: the diagram's builder.
            spacecraft: the known spacecraft.
            state: x = [q; v], usually `MultibodyPlant.get_state_output_port()`.
            covariance: an identifier's output of this name.
            spatial_inertia: an identifier's output of this name.

        The other options are those of the constructor.

        Raises:
            InputError: a port has the wrong size for this spacecraft.

        """
        ports = {"state": state, "covariance": covariance, "spatial_inertia": spatial_inertia}
        system = SceneVisualizer(spacecraft, meshcat=meshcat, truth=truth, period=period)
        return add_connected(builder, system, ports)

    def _create_objects(self) -> None:
        """Create all objects, of unit size; drawing moves, scales and hides them."""
        orange = _COLORS["orange"]
        thin = 0.02 * self._reach
        self._add("estimate/centre", Sphere(0.6 * thin), orange)
        self._add(
            "estimate/three_sigma", Sphere(1.0), Rgba(orange.r(), orange.g(), orange.b(), 0.3)
        )
        self._add("estimate/inertia", Sphere(1.0), Rgba(*orange.rgba[:3], 0.35))
        wire = f"{_ROOT}/estimate/inertia/scaled/shape/<object>"
        self._meshcat.SetProperty(wire, "material.wireframe", True)
        self._add("centre_of_mass", Sphere(thin), _COLORS["white"])
        for owner, color in (("spacecraft", "skyblue"), ("target", "yellow")):
            for kind, width in (("linear", 1.2 * thin), ("angular", 0.8 * thin)):
                name = f"momentum/{kind}_{owner}"
                up = RigidTransform([0.0, 0.0, 0.4])
                self._add(name, Cylinder(0.4 * width, 0.8), _COLORS[color], up)
                down = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, 1.0])
                self._add(name, MeshcatCone(0.25, width, width), _COLORS[color], down, "head")
        for axis, name in zip(np.eye(3), "xyz", strict=True):
            ends = np.column_stack([np.zeros(3), 0.15 * self._reach * axis])
            self._meshcat.SetLine(f"{_ROOT}/C/{name}", ends, 3.0, Rgba(*axis))
        self._meshcat.SetProperty("/Background/<object>", "top_color", [0.02, 0.02, 0.06])
        self._meshcat.SetProperty("/Background/<object>", "bottom_color", [0.05, 0.05, 0.12])
        self._meshcat.SetProperty("/Grid", "visible", False)
        self._meshcat.SetProperty("/Axes", "visible", False)
        middle = 0.65 * self._p_WC0
        self._meshcat.SetCameraPose(middle + self._reach * _VIEW, middle)

    def _add(
        self,
        name: str,
        shape: Sphere | Cylinder | MeshcatCone,
        color: Rgba,
        X: RigidTransform | None = None,
        part: str = "shape",
    ) -> None:
        """Create an object in front of all others, at a pose in the frame that is drawn."""
        path = f"{_ROOT}/{name}/scaled/{part}"
        self._meshcat.SetObject(path, shape, color)
        self._meshcat.SetTransform(path, X or RigidTransform())
        self._meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)
        self._meshcat.SetProperty(f"{path}/<object>", "renderOrder", 10.0)

    def _draw(self, context: Context) -> EventStatus:
        time, plant, model = context.get_time(), self._spacecraft.plant, self._scratch.context
        plant.SetPositionsAndVelocities(model, self.GetInputPort("state").Eval(context))
        X_WC = self._spacecraft.capture_frame.CalcPoseInWorld(model)
        self._place("C", time, X_WC)
        estimate = self.GetInputPort("spatial_inertia").Eval(context)
        is_known = not estimate.IsNaN()
        X_WT = X_WE = X_WS = None
        semi_diameters, sigmas = np.ones(3), np.ones(3)
        if is_known:
            semi_diameters, X_CE = inertia_ellipsoid(estimate)
            X_WE = X_WC @ X_CE
            X_WT = RigidTransform(X_WC @ estimate.get_com())
            covariance = self.GetInputPort("covariance").Eval(context).reshape(10, 10)
            sigmas, R_CS = _principal_sigmas(covariance[1:4, 1:4])
            if 3 * sigmas.max() < self._reach:
                X_WS = RigidTransform(X_WC.rotation() @ R_CS, X_WT.translation())
        self._place("estimate/inertia", time, X_WE, semi_diameters)
        self._place("estimate/centre", time, X_WT)
        self._place("estimate/three_sigma", time, X_WS, np.maximum(3 * sigmas, 1e-3 * self._reach))
        target = self._truth
        if target is None and is_known:
            target = InertialParameters.from_spatial_inertia(estimate)
        self._draw_momentum(model, target, time)
        return EventStatus.Succeeded()

    def _draw_momentum(
        self, model: Context, target: InertialParameters | None, time: float
    ) -> None:
        """Draw the centre of mass and the arrows; `model` is a context of the spacecraft."""
        owners = ("spacecraft", "target")
        if target is None:
            for name in ("centre_of_mass", *(f"momentum/{k}_{o}" for k in _KINDS for o in owners)):
                self._place(name, time)
            return
        known = self._spacecraft.momentum_sample(model)
        p_WC, total = known.motion.p_WC[0], known.mass + target.mass
        p_WT = p_WC + known.motion.R_WC[0] @ target.p_CTcm_C
        p_WS = (known.mass * known.p_WKcm[0] + target.mass * p_WT) / total
        self._place("centre_of_mass", time, RigidTransform(p_WS))
        P_T, L_T = (value[0] for value in target_momentum(target, known.motion))
        above = p_WS + np.array([0.0, 0.0, 0.5 * self._reach])
        for owner, P, L in (("spacecraft", known.P[0], known.L[0]), ("target", P_T, L_T)):
            about_centre = L + np.cross(p_WC - p_WS, P)
            self._point(f"momentum/linear_{owner}", time, p_WS, P / (total * self._reach))
            rate = about_centre / (total * self._reach**2)
            self._point(f"momentum/angular_{owner}", time, above, rate)

    def _point(self, name: str, time: float, start: NDArray[np.float64], rate: ArrayLike) -> None:
        """Draw an arrow for a momentum that is given as a rate [1/s] of the whole system."""
        length = self._reach * float(np.sqrt(np.linalg.norm(rate)))
        if length < 1e-2 * self._reach:
            self._place(name, time)
            return
        R = RotationMatrix.MakeFromOneVector(rate, 2)
        self._place(name, time, RigidTransform(R, start), [1.0, 1.0, length])

    def _place(
        self,
        name: str,
        time: float,
        X_WD: RigidTransform | None = None,
        scale: ArrayLike = (1.0, 1.0, 1.0),
    ) -> None:
        """Move and scale an object at this time of a recording [s]; hide it without a pose."""
        path = f"{_ROOT}/{name}"
        self._meshcat.SetProperty(path, "visible", X_WD is not None, time)
        if X_WD is not None:
            self._meshcat.SetTransform(path, X_WD, time)
            values = [float(value) for value in np.asarray(scale)]
            self._meshcat.SetProperty(f"{path}/scaled", "scale", values, time)


_KINDS = ("linear", "angular")


def _principal_sigmas(
    covariance: NDArray[np.float64],
) -> tuple[NDArray[np.float64], RotationMatrix]:
    """Return standard deviations (3,) along principal axes; infinite if they are not known."""
    if not np.isfinite(covariance).all():
        return np.full(3, np.inf), RotationMatrix()
    values, axes = np.linalg.eigh(covariance)
    axes[:, 2] *= np.linalg.det(axes)
    return np.sqrt(np.maximum(values, 0.0)), RotationMatrix.ProjectToRotationMatrix(axes)


def _size(spacecraft: Spacecraft) -> tuple[float, NDArray[np.float64]]:
    """Return the largest distance of a body from the base, and C's place, with joints at zero."""
    plant = spacecraft.plant
    context = plant.CreateDefaultContext()
    origins = [plant.EvalBodyPoseInWorld(context, body).translation() for body in _bodies(plant)]
    p_WC = spacecraft.capture_frame.CalcPoseInWorld(context).translation()
    return float(np.linalg.norm([*origins, p_WC], axis=1).max()), p_WC


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Return all bodies but the world."""
    return [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]


def add_bodies(
    builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph, meshcat: Meshcat
) -> None:
    """Add Drake's visualization of a plant: its shapes, and hidden ellipsoids of all inertias.

    The ellipsoids are visible at once if the plant has no shapes.
    """
    bodies = _bodies(plant)
    config = VisualizationConfig(
        publish_period=FRAME_PERIOD,
        publish_proximity=False,
        publish_contacts=False,
        publish_inertia=all(body.default_mass() >= 0 for body in bodies),  # see `SprungMass`
    )
    ApplyVisualizationConfig(
        config,
        builder,
        plant=plant,
        scene_graph=scene_graph,
        meshcat=meshcat,
    )
    if not any(plant.GetVisualGeometriesForBody(body) for body in bodies):
        meshcat.SetProperty("/drake/inertia", "visible", True)


def can_be_drawn(spacecraft: Spacecraft) -> bool:
    """Return whether the (optional) geometry of a spacecraft's model can be read."""
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()  # kept for the plant
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    try:
        spacecraft.add_alone_to(plant)
    except InputError:
        return False
    return True


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
