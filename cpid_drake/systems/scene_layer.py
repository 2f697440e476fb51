"""What a layer of the scene in Meshcat is, and what it draws.

A layer draws one `Moment` at a time, into the recording if Meshcat records. Each layer is below
its own path `/cpid/<layer>`, and the viewer decides whether it is visible.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import MomentumSamples

ROOT = "/cpid"


@dataclass(frozen=True)
class Extent:
    """Size and momenta of the motion that is drawn.

    Attributes:
        centre: (3,) centre of all bodies during the whole motion, in W [m].
        size: about half the length of the spacecraft without the target [m].
        momentum: the largest linear momentum of the spacecraft [N·s].
        angular_momentum: the largest angular momentum about the system's centre of mass, or about
            the spacecraft's own if the target is not known [N·m·s].

    """

    centre: NDArray[np.float64]
    size: float
    momentum: float
    angular_momentum: float


@dataclass(frozen=True)
class Moment:
    """State and estimate at one instant.

    Attributes:
        X_WB: pose of the base.
        X_WC: pose of the capture frame.
        known: momentum of the known bodies, one sample.
        target: the target whose centre of mass and momentum are drawn; None if unknown.
        estimate: estimated spatial inertia about C's origin, in C; None if unknown.
        covariance: (3, 3) covariance of the estimated centre of mass [m²].
        body_poses: poses of the bodies without geometry, by name.

    """

    X_WB: RigidTransform
    X_WC: RigidTransform
    known: MomentumSamples
    target: InertialParameters | None
    estimate: SpatialInertia | None
    covariance: NDArray[np.float64]
    body_poses: dict[str, RigidTransform]


class Layer(ABC):
    """One layer: its objects are created once, and moved, scaled or hidden at every moment."""

    name: str

    def __init__(self, meshcat: Meshcat, extent: Extent) -> None:
        self._meshcat, self._extent = meshcat, extent
        self._root = f"{ROOT}/{self.name}"

    @abstractmethod
    def draw(self, moment: Moment, time: float) -> None:
        """Draw one moment, at this time of a recording [s]."""

    def _show(self, path: str, visible: bool, time: float) -> None:
        self._meshcat.SetProperty(f"{self._root}/{path}", "visible", visible, time)

    def _place(
        self, path: str, X_WD: RigidTransform, scale: ArrayLike | None, time: float | None
    ) -> None:
        """Move an object. The scale is set on the child node, so a transform does not change it."""
        self._meshcat.SetTransform(f"{self._root}/{path}", X_WD, time)
        if scale is not None:
            values = [float(value) for value in np.asarray(scale)]
            self._meshcat.SetProperty(f"{self._root}/{path}/shape", "scale", values, time)

    def _in_front(self, path: str) -> None:
        """Draw an object in front of all others."""
        node = f"{self._root}/{path}/<object>"
        self._meshcat.SetProperty(node, "material.depthTest", False)
        self._meshcat.SetProperty(node, "renderOrder", 10.0)
