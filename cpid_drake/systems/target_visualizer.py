"""The target's estimated inertia in Meshcat, beside the true one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody, SpatialInertia
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort

from cpid_drake.appearance import inertia_ellipsoid

ESTIMATE_COLOR = Rgba(1.0, 0.45, 0.05, 1.0)
TRUTH_COLOR = Rgba(0.1, 0.85, 0.75, 0.4)


class TargetVisualizer(LeafSystem):
    """Draws the solid ellipsoids of the estimated inertia (wire) and of the true one (translucent).

    The estimate is hidden until there is one. Both are drawn at the capture frame, live and into a
    Meshcat recording.

    .. pydrake_system::

        name: TargetVisualizer
        input_ports:
        - body_poses
        - spatial_inertia

    - `body_poses` (abstract list of `RigidTransform`): the plant's output of that name.
    - `spatial_inertia` (abstract `SpatialInertia`): the identifier's output, NaN while unknown.

    Args:
        meshcat: where to draw.
        target_body: index of the body whose frame is C.
        truth: the true spatial inertia about C's origin in C, to draw beside it; simulation only.
        period: time between drawings [s].

    """

    def __init__(
        self,
        meshcat: Meshcat,
        target_body: BodyIndex,
        *,
        truth: SpatialInertia | None = None,
        period: float = 1 / 32,
        path: str = "/cpid/target",
    ) -> None:
        super().__init__()
        self.set_name("target_visualizer")
        self._meshcat, self._path = meshcat, path
        self._body = int(target_body)
        self.DeclareAbstractInputPort("body_poses", Value([RigidTransform()]))
        self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
        self.DeclarePeriodicPublishEvent(period_sec=period, offset_sec=0.0, publish=self._draw)
        self.DeclareForcedPublishEvent(self._draw)

        if truth is not None:
            meshcat.SetObject(f"{path}/truth/ellipsoid", Sphere(1.0), TRUTH_COLOR)
            self._place("truth", truth, time=None)
        start, end = _wire_sphere()
        meshcat.SetLineSegments(f"{path}/estimate/ellipsoid", start, end, 2.0, ESTIMATE_COLOR)
        meshcat.SetProperty(f"{path}/estimate", "visible", False)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        meshcat: Meshcat,
        plant: MultibodyPlant,
        target: RigidBody,
        spatial_inertia_port: OutputPort,
        *,
        truth: SpatialInertia | None = None,
        period: float = 1 / 32,
    ) -> "TargetVisualizer":
        """Add a visualizer and connect it to the plant and to an identifier's output."""
        system = builder.AddSystem(
            TargetVisualizer(meshcat, target.index(), truth=truth, period=period)
        )
        builder.Connect(plant.get_body_poses_output_port(), system.GetInputPort("body_poses"))
        builder.Connect(spatial_inertia_port, system.GetInputPort("spatial_inertia"))
        return system

    def _draw(self, context: Context) -> EventStatus:
        X_WC = self.GetInputPort("body_poses").Eval(context)[self._body]
        estimate = self.GetInputPort("spatial_inertia").Eval(context)
        time = context.get_time()
        self._meshcat.SetTransform(self._path, X_WC, time)
        self._meshcat.SetProperty(f"{self._path}/estimate", "visible", not estimate.IsNaN(), time)
        if not estimate.IsNaN():
            self._place("estimate", estimate, time)
        return EventStatus.Succeeded()

    def _place(self, name: str, M_TCo_C: SpatialInertia, time: float | None) -> None:
        semi_diameters, X_CE = inertia_ellipsoid(M_TCo_C)
        # Pose on one node and scale on the next: a transform would overwrite the scale.
        self._meshcat.SetTransform(f"{self._path}/{name}", X_CE, time)
        scale: Sequence[float] = semi_diameters.tolist()
        self._meshcat.SetProperty(f"{self._path}/{name}/ellipsoid", "scale", scale, time)


def _wire_sphere(
    meridians: int = 8, parallels: int = 5, arcs: int = 32
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return start and end points (3, n) of the segments of a unit sphere's wire frame."""
    angle = np.linspace(0, 2 * np.pi, arcs + 1)
    circles = []
    for longitude in np.pi * np.arange(meridians) / meridians:
        x, y, z = np.sin(angle), np.zeros_like(angle), np.cos(angle)
        circles.append(np.stack([x * np.cos(longitude), x * np.sin(longitude) + y, z]))
    for latitude in np.pi * (np.arange(1, parallels + 1) / (parallels + 1) - 0.5):
        ring = np.cos(latitude) * np.stack([np.cos(angle), np.sin(angle)])
        circles.append(np.vstack([ring, np.full_like(angle, np.sin(latitude))]))
    return (
        np.hstack([circle[:, :-1] for circle in circles]),
        np.hstack([circle[:, 1:] for circle in circles]),
    )
