"""The text of model files in URDF, SDF and MJCF, from a list of links."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import jinja2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw

from cpid_drake.dynamics.inertia import InertialParameters

WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
"""Comment at the beginning of every file."""


@dataclass(frozen=True, eq=False)
class Link:
    """A link and the joint to its parent, whose frame at q = 0 is the link's own frame L.

    Attributes:
        body: mass, centre of mass and inertia in L; None without mass.
        kind: "revolute", "prismatic" or "fixed"; empty for the first link, which is free.
        limits: lowest and highest position, and largest rate; infinite for none.

    """

    name: str
    body: InertialParameters | None
    parent: str = ""
    joint: str = ""
    kind: str = ""
    X_PL: RigidTransform = field(default_factory=RigidTransform)
    axis_L: NDArray[np.float64] | None = None
    limits: tuple[float, float, float] = (-np.inf, np.inf, np.inf)

    @property
    def finite_limits(self) -> list[tuple[str, float]]:
        """The limits that are not infinite, with their names in URDF and SDF."""
        named = zip(("lower", "upper", "velocity"), self.limits, strict=True)
        return [(name, value) for name, value in named if np.isfinite(value)]

    @property
    def rpy_PL(self) -> NDArray[np.float64]:
        """(3,) roll, pitch and yaw of the link in its parent."""
        return np.asarray(RollPitchYaw(self.X_PL.rotation()).vector())

    @property
    def moments(self) -> list[tuple[str, float]]:
        """The moments of inertia, with their names in URDF and SDF."""
        assert self.body is not None
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        return list(zip(names, self.body.to_vector()[4:].tolist(), strict=True))


def model_text(format: str, links: Sequence[Link]) -> str:
    """Return the text of a model in "urdf", "sdf" or "mjcf"; links are inboard before outboard."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cpid_drake.spacecraft"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["numbers"] = _numbers
    return environment.get_template(f"{format}.xml").render(links=links, what=WHAT).lstrip()


def _numbers(values: ArrayLike) -> str:
    numbers = np.ravel(np.asarray(values, dtype=float))
    # Some readers refuse numbers below the smallest normal number.
    numbers = np.where(np.abs(numbers) < sys.float_info.min, 0.0, numbers)
    return " ".join(map(repr, numbers.tolist()))
