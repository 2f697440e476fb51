"""Layers that Meshcat shows besides the bodies, such as momenta and the inertia ellipsoid."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, Cylinder, Ellipsoid, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import SpatialInertia

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import target_momentum
from cpid_drake.spacecraft.appearance import GREY, box_of_inertia, inertia_ellipsoid
from cpid_drake.systems.scene_layer import Extent, Layer, Moment

ESTIMATE_COLOR = Rgba(1.0, 0.45, 0.05, 1.0)
TRUTH_COLOR = Rgba(0.1, 0.85, 0.75, 0.4)
CENTRE_COLOR = Rgba(1.0, 1.0, 1.0, 1.0)
SPACECRAFT_COLOR = Rgba(0.34, 0.7, 0.91, 1.0)
TARGET_COLOR = Rgba(0.94, 0.89, 0.26, 1.0)
_AXIS_COLORS = (Rgba(1.0, 0.25, 0.2, 1.0), Rgba(0.3, 0.9, 0.3, 1.0), Rgba(0.35, 0.5, 1.0, 1.0))

ABOVE = 0.45
"""Height of the angular momentum's arrows above the centre of mass, in sizes of the spacecraft."""

_LONGEST = {"linear": 0.4, "angular": 0.25}  # arrow, in sizes of the spacecraft


class Bodies(Layer):
    """Boxes of the same mass and inertia for bodies without geometry."""

    name = "bodies"

    def __init__(self, meshcat: Meshcat, extent: Extent, bodies: dict[str, SpatialInertia]) -> None:
        super().__init__(meshcat, extent)
        for name, M_BBo_B in bodies.items():
            sides, X_BE = box_of_inertia(M_BBo_B)
            meshcat.SetObject(f"{self._root}/{name}/box", Box(*sides), GREY)
            meshcat.SetTransform(f"{self._root}/{name}/box", X_BE)

    def draw(self, moment: Moment, time: float) -> None:
        """Move the boxes."""
        for name, X_WL in moment.body_poses.items():
            self._place(name, X_WL, None, time)


class Frames(Layer):
    """The axes of W (long and thin), B and C; hidden at first."""

    name = "frames"

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        super().__init__(meshcat, extent)
        for frame, length, width in (("W", 0.5, 0.004), ("B", 0.3, 0.007), ("C", 0.3, 0.007)):
            for axis in range(3):
                path, along = f"{frame}/{'xyz'[axis]}", np.eye(3)[axis]
                bar = Cylinder(width * extent.size, length * extent.size)
                meshcat.SetObject(f"{self._root}/{path}", bar, _AXIS_COLORS[axis])
                R = RotationMatrix.MakeFromOneVector(along, 2)
                X = RigidTransform(R, 0.5 * length * extent.size * along)
                meshcat.SetTransform(f"{self._root}/{path}", X)
                self._in_front(path)
        meshcat.SetProperty(self._root, "visible", False)

    def draw(self, moment: Moment, time: float) -> None:
        """Move B and C."""
        self._place("B", moment.X_WB, None, time)
        self._place("C", moment.X_WC, None, time)


class CentreOfMass(Layer):
    """The system's centre of mass."""

    name = "centre_of_mass"

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        super().__init__(meshcat, extent)
        meshcat.SetObject(f"{self._root}/now/shape", Sphere(0.02 * extent.size), CENTRE_COLOR)
        self._in_front("now/shape")

    def draw(self, moment: Moment, time: float) -> None:
        """Draw it, once the target is known."""
        self._show("now", moment.target is not None, time)
        if moment.target is not None:
            known = moment.known
            p_WS = system_centre(moment.target, moment.X_WC, known.p_WKcm[0], known.mass)
            self._place("now", RigidTransform(p_WS), None, time)


class EstimatedCentre(Layer):
    """The target's estimated centre of mass, and the ellipsoid of its three standard deviations."""

    name = "estimated_centre"

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        super().__init__(meshcat, extent)
        self._smallest = 0.012 * extent.size
        translucent = Rgba(ESTIMATE_COLOR.r(), ESTIMATE_COLOR.g(), ESTIMATE_COLOR.b(), 0.3)
        meshcat.SetObject(f"{self._root}/centre", Sphere(self._smallest), ESTIMATE_COLOR)
        meshcat.SetObject(f"{self._root}/three_sigma/shape", Sphere(1.0), translucent)
        for path in ("centre", "three_sigma/shape"):
            self._in_front(path)

    def draw(self, moment: Moment, time: float) -> None:
        """Draw the point, and the ellipsoid if it is smaller than the spacecraft."""
        is_known, semi_axes = moment.estimate is not None, np.full(3, np.inf)
        if is_known and np.isfinite(moment.covariance).all():
            values, axes = np.linalg.eigh(moment.covariance)
            semi_axes = 3 * np.sqrt(np.maximum(values, 0.0))
        is_small = bool(semi_axes.max() < self._extent.size)
        self._show("centre", is_known, time)
        self._show("three_sigma", is_small, time)
        if moment.estimate is not None:
            p_WT = moment.X_WC @ moment.estimate.get_com()
            self._place("centre", RigidTransform(p_WT), None, time)
        if is_small:
            axes[:, 2] *= np.linalg.det(axes)
            R_WE = moment.X_WC.rotation() @ RotationMatrix.ProjectToRotationMatrix(axes)
            shape = np.maximum(semi_axes, self._smallest)
            self._place("three_sigma", RigidTransform(R_WE, p_WT), shape, time)


class EstimatedInertia(Layer):
    """The solid ellipsoid of the target's estimated inertia, as a wire frame."""

    name = "estimated_inertia"

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        super().__init__(meshcat, extent)
        start, end = wire_sphere()
        meshcat.SetLineSegments(f"{self._root}/ellipsoid/shape", start, end, 2.0, ESTIMATE_COLOR)

    def draw(self, moment: Moment, time: float) -> None:
        """Draw the estimate once there is one."""
        self._show("ellipsoid", moment.estimate is not None, time)
        if moment.estimate is not None:
            semi_diameters, X_CE = inertia_ellipsoid(moment.estimate)
            self._place("ellipsoid", moment.X_WC @ X_CE, semi_diameters, time)


class TrueInertia(Layer):
    """The solid ellipsoid of the target's true inertia."""

    name = "true_inertia"

    def __init__(self, meshcat: Meshcat, extent: Extent, truth: SpatialInertia) -> None:
        super().__init__(meshcat, extent)
        semi_diameters, self._X_CE = inertia_ellipsoid(truth)
        meshcat.SetObject(f"{self._root}/ellipsoid", Ellipsoid(*semi_diameters), TRUTH_COLOR)

    def draw(self, moment: Moment, time: float) -> None:
        """Move it with the capture frame."""
        self._place("ellipsoid", moment.X_WC @ self._X_CE, None, time)


class Momentum(Layer):
    """Momentum of the spacecraft and of the target: equal and opposite while their sum is zero.

    The arrows of linear momentum start at the system's centre of mass. The arrows of angular
    momentum about that point are thinner and start above it.
    """

    name = "momentum"

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        super().__init__(meshcat, extent)
        for kind, width, shade in (("linear", 0.025, 1.0), ("angular", 0.016, 0.75)):
            for owner, color in (("spacecraft", SPACECRAFT_COLOR), ("target", TARGET_COLOR)):
                rgb = (shade * color.r(), shade * color.g(), shade * color.b())
                self._set_arrow(f"{kind}_{owner}", width * extent.size, Rgba(*rgb))

    def _set_arrow(self, name: str, width: float, color: Rgba) -> None:
        """Create an arrow of length 1 along z."""
        path = f"{self._root}/{name}/shape"
        self._meshcat.SetObject(f"{path}/shaft", Cylinder(0.4 * width, 0.8), color)
        self._meshcat.SetTransform(f"{path}/shaft", RigidTransform([0.0, 0.0, 0.4]))
        self._meshcat.SetObject(f"{path}/head", MeshcatCone(0.25, width, width), color)
        upside_down = RotationMatrix.MakeXRotation(np.pi)
        self._meshcat.SetTransform(f"{path}/head", RigidTransform(upside_down, [0.0, 0.0, 1.0]))
        for part in ("shaft", "head"):
            self._in_front(f"{name}/shape/{part}")

    def draw(self, moment: Moment, time: float) -> None:
        """Draw the four arrows, once the target is known."""
        if moment.target is None:
            for kind in ("linear", "angular"):
                for owner in ("spacecraft", "target"):
                    self._show(f"{kind}_{owner}", False, time)
            return
        known, extent = moment.known, self._extent
        p_WC = known.motion.p_WC[0]
        p_WS = system_centre(moment.target, moment.X_WC, known.p_WKcm[0], known.mass)
        P_T, L_T = (value[0] for value in target_momentum(moment.target, known.motion))
        P_K, L_K = known.P[0], known.L[0]
        above = p_WS + np.array([0.0, 0.0, ABOVE * extent.size])
        for owner, P, L in (("spacecraft", P_K, L_K), ("target", P_T, L_T)):
            about_centre = L + np.cross(p_WC - p_WS, P)
            self._point(f"linear_{owner}", p_WS, P, extent.momentum, time)
            self._point(f"angular_{owner}", above, about_centre, extent.angular_momentum, time)

    def _point(
        self, name: str, start: NDArray[np.float64], vector: ArrayLike, largest: float, time: float
    ) -> None:
        fraction = float(np.linalg.norm(vector)) / largest if largest > 0 else 0.0
        self._show(name, fraction > 0.01, time)
        if fraction > 0.01:
            R = RotationMatrix.MakeFromOneVector(vector, 2)
            length = _LONGEST[name.split("_")[0]] * self._extent.size * fraction
            width = min(1.0, 3 * fraction)
            self._place(name, RigidTransform(R, start), [width, width, length], time)


def make_layers(
    meshcat: Meshcat,
    extent: Extent,
    bodies: dict[str, SpatialInertia],
    truth: InertialParameters | None,
) -> list[Layer]:
    """Return all layers; `bodies` have no shapes, and `truth` is the target if known."""
    kinds = (Frames, CentreOfMass, EstimatedCentre, EstimatedInertia, Momentum)
    layers: list[Layer] = [
        Bodies(meshcat, extent, bodies),
        *(kind(meshcat, extent) for kind in kinds),
    ]
    if truth is not None:
        layers.append(TrueInertia(meshcat, extent, truth.to_spatial_inertia()))
    return layers


def system_centre(
    target: InertialParameters, X_WC: RigidTransform, p_WK: ArrayLike, mass: float
) -> NDArray[np.float64]:
    """Return the centre of mass (3,) in W of a target on C and known bodies around p_WK [m]."""
    p_WT = X_WC @ target.p_CTcm_C
    return (mass * np.asarray(p_WK) + target.mass * p_WT) / (mass + target.mass)


def wire_sphere(
    meridians: int = 8, parallels: int = 5, arcs: int = 32
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return start and end points (3, n) of the segments of a unit sphere's wire frame."""
    angle = np.linspace(0, 2 * np.pi, arcs + 1)
    circles = []
    for longitude in np.pi * np.arange(meridians) / meridians:
        x, z = np.sin(angle), np.cos(angle)
        circles.append(np.stack([x * np.cos(longitude), x * np.sin(longitude), z]))
    for latitude in np.pi * (np.arange(1, parallels + 1) / (parallels + 1) - 0.5):
        ring = np.cos(latitude) * np.stack([np.cos(angle), np.sin(angle)])
        circles.append(np.vstack([ring, np.full_like(angle, np.sin(latitude))]))
    return (
        np.hstack([circle[:, :-1] for circle in circles]),
        np.hstack([circle[:, 1:] for circle in circles]),
    )
