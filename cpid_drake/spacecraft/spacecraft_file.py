"""The keys of a spacecraft's own file."""

from dataclasses import dataclass, field
from typing import Literal

from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.spacecraft.reference import SpacecraftReference

EXPLICIT = "sensors.explicit"
"""The sensors of a scenario that lists them itself: no file that a request could name."""


@dataclass
class SpacecraftFile(SpacecraftReference):
    """The keys of a spacecraft's own file; paths in it are relative to its folder.

    Attributes:
        sensors: name of a preset or a YAML file; None if they are unknown.
        momentum: the total momentum; None to test whether it is zero.
        planar: whether a table carries the spacecraft; None to recognize it from the log.
        known_bodies: uncertainty of the spacecraft's bodies, geometry and grasp.

    """

    sensors: str | None = None
    momentum: Literal["zero", "unknown"] | None = None
    planar: bool | None = None
    known_bodies: BodyUncertainty = field(default_factory=BodyUncertainty)
