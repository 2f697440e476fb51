"""What a file for --scenario says about a spacecraft."""

from dataclasses import dataclass, field, replace
from typing import Literal

import cpid_drake as cpid
from cpid_drake import simulation
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.checked_yaml import from_tree, parse_yaml
from cpid_drake.files.resources import find_scenario, resolve_model

EXPLICIT = "sensors.explicit"
"""The sensors of a scenario that lists them itself: no file that a request could name."""


@dataclass
class SpacecraftFile:
    """The keys of a YAML file for --scenario that is no scenario: what is known of a spacecraft.

    Paths in such a file are relative to its folder.
    """

    model: str
    base: str
    capture_frame: str
    packages: dict[str, str] = field(default_factory=dict)
    sensors: str | None = None
    momentum: Literal["zero", "unknown"] | None = None
    planar: bool | None = None
    known_bodies: BodyUncertainty = field(default_factory=BodyUncertainty)

    def reference(self) -> "cpid.SpacecraftReference":
        """Return the spacecraft as a request names it."""
        return cpid.SpacecraftReference(self.model, self.base, self.capture_frame, self.packages)


def load_spacecraft_file(name: str) -> SpacecraftFile:
    """Return what a scenario, or a spacecraft's own file, says about the spacecraft.

    The target and the motion of a scenario are not used.

    Raises:
        InputError: no such file, or for the same reasons as `cpid_drake.load_scenario`.

    """
    place = find_scenario(name)
    file = resolve_model(place)
    tree = parse_yaml(file.read_bytes(), name, simulation.MOTION_TAGS)
    if not (isinstance(tree, dict) and "spacecraft" in tree):
        found = from_tree(SpacecraftFile, tree, name, "the file of a spacecraft")
        folder = file.parent
        local = found.sensors is not None and (folder / found.sensors).is_file()
        return replace(
            found,
            model=found.model if "://" in found.model else str(folder / found.model),
            packages={key: str(folder / each) for key, each in found.packages.items()},
            sensors=str(folder / found.sensors) if local and found.sensors else found.sensors,
        )
    scenario = cpid.load_scenario(place)
    craft = scenario.spacecraft
    return SpacecraftFile(
        craft.model,
        craft.base,
        craft.capture_frame,
        craft.packages,
        sensors=EXPLICIT if scenario.sensors.explicit else scenario.sensors.suite or None,
        momentum="unknown" if scenario.identification.unknown_momentum else "zero",
        planar=True if craft.on_table else None,
        known_bodies=scenario.known_bodies,
    )
