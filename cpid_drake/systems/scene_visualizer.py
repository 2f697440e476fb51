"""What is identified, and the momenta, in Meshcat, beside Drake's visualization of the bodies."""

from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatCone, Rgba, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, OutputPort
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import MomentumSamples, target_momentum
from cpid_drake.spacecraft.appearance import inertia_ellipsoid, three_sigma_ellipsoid
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.ports import SpacecraftSystem
from cpid_drake.systems.scene_page import LEGEND, estimate_lines, keep_scene

FRAME_PERIOD = 1 / 16
"""Time between two drawings [s]: fast enough for the eye, and a page of ten seconds stays small."""

_RGB = {"orange": (1, 0.65, 0), "skyblue": (0.5, 0.8, 0.9), "yellow": (1, 1, 0), "white": (1, 1, 1)}
_VIEW = np.array([1.1, -0.91, 0.62])  # from the scene to the camera, in W and reaches
_STRETCH = 3.0  # a momentum that moves or turns all by a reach or radian in 9 s is one reach long


class SceneVisualizer(SpacecraftSystem):
    """Draws the estimated target, the momenta, C and the common centre of mass, at `/cpid`.

    The estimate appears when all ten parameters are known: the ellipsoid of equal inertia as a wire
    frame, and the ellipsoid of three standard deviations of the centre of mass if that is smaller
    than the spacecraft. Centre of mass and momenta are computed with the true target if it is
    given, else with the estimate. Needles show the linear momenta at the common centre of mass, and
    the angular momenta about it above; their length rises with the square root of the momentum.

    .. pydrake_system::

        name: SceneVisualizer
        input_ports:
        - state
        - covariance
        - spatial_inertia
        - checks_passed

    - `state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state).
    - `covariance` (100), `spatial_inertia` and `checks_passed` (1): an identifier's outputs; the
      first two are NaN while unknown.

    Meshcat's controls show the legend and the numbers of the estimate; `keep` writes a page with
    them. As Meshcat's recording, the numbers over time belong to this object and to no Context.

    Args:
        spacecraft: the spacecraft model.
        meshcat: where to draw. Its camera is moved so that the spacecraft fills the picture.
        truth: the true target; simulation only.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        meshcat: Meshcat,
        truth: InertialParameters | None = None,
    ) -> None:
        super().__init__()
        self.set_name("scene_visualizer")
        self._spacecraft, self._meshcat, self._truth = spacecraft, meshcat, truth
        plant = spacecraft.plant
        self._plant_context = self._declare_plant_context(plant)
        indices = [BodyIndex(k) for k in range(1, plant.num_bodies())]
        bodies = [plant.get_body(index).body_frame() for index in indices]
        frames, at_rest = [*bodies, spacecraft.capture_frame], plant.CreateDefaultContext()
        places = [frame.CalcPoseInWorld(at_rest).translation() for frame in frames]
        # All frames may be at one place: then the mass reaches as far as its radius of gyration.
        inertia = plant.CalcSpatialInertia(at_rest, plant.world_frame(), indices)
        gyration = np.sqrt(inertia.get_unit_inertia().get_moments().sum() / 2)
        self._reach = float(max(np.linalg.norm(places, axis=1).max(), gyration))
        self._names = ["C"]
        self._texts: list[tuple[float, str]] = []
        self._buttons: list[str] = []
        size, middle = 0.02 * self._reach, 0.4 * places[-1]
        self._add("estimate/inertia", Sphere(1.0), "orange", 0.35)
        self._add("estimate/three_sigma", Sphere(1.0), "orange", 0.5)
        self._add("centre_of_mass", Sphere(size), "white")
        for owner, color in (("spacecraft", "skyblue"), ("target", "yellow")):
            for kind in ("linear", "angular"):
                self._add(
                    f"momentum/{kind}_{owner}", MeshcatCone(1.0, 0.8 * size, 0.8 * size), color
                )
        for axis, name in zip(np.eye(3), "xyz", strict=True):
            ends = np.column_stack([np.zeros(3), 0.15 * self._reach * axis])
            meshcat.SetLine(f"/cpid/C/{name}", ends, 3.0, Rgba(*axis))
        wire = "/cpid/estimate/inertia/scaled/shape/<object>"
        meshcat.SetProperty(wire, "material.wireframe", True)
        for property_name in ("top_color", "bottom_color"):
            meshcat.SetProperty("/Background/<object>", property_name, [0.03, 0.03, 0.08])
        for path in ("/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)
        meshcat.SetCameraPose(middle + self._reach * _VIEW, middle)
        for color, text in LEGEND.items():
            meshcat.AddButton(f"{color}: {text}")

        self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorInputPort("covariance", 100)
        self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
        self.DeclareVectorInputPort("checks_passed", 1)
        self.DeclarePeriodicPublishEvent(FRAME_PERIOD, 0.0, self._draw)
        self.DeclareForcedPublishEvent(self._draw)

    @classmethod
    def AddToBuilder(
        cls,
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        covariance: OutputPort,
        spatial_inertia: OutputPort,
        checks_passed: OutputPort,
        meshcat: Meshcat,
        truth: InertialParameters | None = None,
    ) -> Self:
        """Add a visualizer to a diagram and connect it; for the options see the class.

        Raises:
            InputError: a port has another size.

        """
        return cls(spacecraft, meshcat=meshcat, truth=truth).connected(
            builder,
            state=state,
            covariance=covariance,
            spatial_inertia=spatial_inertia,
            checks_passed=checks_passed,
        )

    def _add(self, name: str, shape: Sphere | MeshcatCone, color: str, alpha: float = 1.0) -> None:
        """Create an object of unit size in front of all others; drawing moves and scales it."""
        self._names.append(name)
        path = f"/cpid/{name}/scaled/shape"
        self._meshcat.SetObject(path, shape, Rgba(*_RGB[color], alpha))
        if isinstance(shape, MeshcatCone):  # Meshcat's have their tip at the origin
            X = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, 1.0])
            self._meshcat.SetTransform(path, X)
        self._meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)
        self._meshcat.SetProperty(f"{path}/<object>", "renderOrder", 10.0)

    def keep(self, path: str | Path, *, wait: bool = False) -> None:
        """Write the recorded scene as a page, and print its name; see `scene_page.keep_scene`."""
        keep_scene(path, self._meshcat, self._texts, wait=wait)

    def _show_numbers(self, context: Context) -> None:
        """Show the estimate in Meshcat's controls, and remember it for the page."""
        estimate, time = self.GetInputPort("spatial_inertia").Eval(context), context.get_time()
        values = np.full(10, np.nan)
        if not estimate.IsNaN():
            values = InertialParameters.from_spatial_inertia(estimate).to_vector()
        covariance = self.GetInputPort("covariance").Eval(context).reshape(10, 10)
        lines = estimate_lines(values, 1.96 * np.sqrt(np.diag(covariance)), self._truth)
        if np.isfinite(values).all() and not self.GetInputPort("checks_passed").Eval(context)[0]:
            lines.append("a check failed: do not use it")
        self._texts = [each for each in self._texts if each[0] < time]
        if self._texts and self._texts[-1][1] == "\n".join(lines):
            return
        self._texts.append((time, "\n".join(lines)))
        for button in self._buttons:
            self._meshcat.DeleteButton(button)
        self._buttons = list(dict.fromkeys(map(str.strip, lines)))
        for button in self._buttons:
            self._meshcat.AddButton(button)

    def _draw(self, context: Context) -> EventStatus:
        self._show_numbers(context)
        time, model = context.get_time(), self._plant_context(context)
        state = self.GetInputPort("state").Eval(context)
        self._spacecraft.plant.SetPositionsAndVelocities(model, state)
        X_WC = self._spacecraft.capture_frame.CalcPoseInWorld(model)
        estimate, target = self.GetInputPort("spatial_inertia").Eval(context), self._truth
        # Poses in W, and scales; what is not in it is hidden.
        drawn: dict[str, tuple[RigidTransform, ArrayLike]] = {"C": (X_WC, np.ones(3))}
        if not estimate.IsNaN():
            target = target or InertialParameters.from_spatial_inertia(estimate)
            semi_diameters, X_CE = inertia_ellipsoid(estimate)
            drawn["estimate/inertia"] = X_WC @ X_CE, semi_diameters
            covariance = self.GetInputPort("covariance").Eval(context).reshape(10, 10)[1:4, 1:4]
            if 9 * np.trace(covariance) < self._reach**2:
                three_sigma, X_CS = three_sigma_ellipsoid(estimate.get_com(), covariance)
                sizes = np.maximum(three_sigma, 1e-3 * self._reach)
                drawn["estimate/three_sigma"] = X_WC @ X_CS, sizes
        if target is not None:
            drawn |= self._momenta(self._spacecraft.momentum_sample(model), target)
        for name in self._names:
            path, (X_WD, scale) = f"/cpid/{name}", drawn.get(name, (None, None))
            self._meshcat.SetProperty(path, "visible", X_WD is not None, time)
            if X_WD is not None:
                self._meshcat.SetTransform(path, X_WD, time)
                values = [float(value) for value in np.asarray(scale)]
                self._meshcat.SetProperty(f"{path}/scaled", "scale", values, time)
        return EventStatus.Succeeded()

    def _momenta(
        self, samples: MomentumSamples, target: InertialParameters
    ) -> dict[str, tuple[RigidTransform, ArrayLike]]:
        """Return the common centre of mass and the needles of the momenta."""
        reach, p_WC, total = self._reach, samples.motion.p_WC[0], samples.mass + target.mass
        p_WT = p_WC + samples.motion.R_WC[0] @ target.p_CTcm_C
        p_WS = (samples.mass * samples.p_WKcm[0] + target.mass * p_WT) / total
        drawn: dict[str, tuple[RigidTransform, ArrayLike]] = {
            "centre_of_mass": (RigidTransform(p_WS), np.ones(3))
        }
        of_target = target_momentum(target, samples.motion)
        for owner, (P, L) in (("spacecraft", (samples.P, samples.L)), ("target", of_target)):
            about_centre = L[0] + np.cross(p_WC - p_WS, P[0])
            above = p_WS + [0.0, 0.0, 0.5 * reach]
            # As rates [1/s] of the whole system, so that one scale serves both.
            for kind, start, rate in (
                ("linear", p_WS, P[0] / (total * reach)),
                ("angular", above, about_centre / (total * reach**2)),
            ):
                length = _STRETCH * reach * float(np.sqrt(np.linalg.norm(rate)))
                if length > 1e-2 * reach:
                    X = RigidTransform(RotationMatrix.MakeFromOneVector(rate, 2), start)
                    drawn[f"momentum/{kind}_{owner}"] = X, [1.0, 1.0, length]
        return drawn


def add_bodies(
    builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph, meshcat: Meshcat
) -> None:
    """Add Drake's visualization of a plant: its shapes, else ellipsoids of inertia."""
    masses = [plant.get_body(BodyIndex(k)).default_mass() for k in range(1, plant.num_bodies())]
    config = VisualizationConfig(
        publish_period=FRAME_PERIOD,
        publish_proximity=False,
        publish_contacts=False,
        publish_inertia=min(masses) >= 0,  # see `SprungMass`
    )
    ApplyVisualizationConfig(config, builder, meshcat=meshcat)
    if not scene_graph.model_inspector().num_geometries():
        meshcat.SetProperty("/drake/inertia", "visible", True)
