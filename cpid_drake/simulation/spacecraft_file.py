"""What a file says about a spacecraft: its own, or a scenario."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.checked_yaml import from_tree, parse_yaml
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import find_scenario, resolve_model
from cpid_drake.identification.request import Request
from cpid_drake.simulation.scenario_files import load_scenario, resolve_paths, suite_from_folder
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

    def request(self, telemetry: str, sensors: str | None = None, **given: Any) -> Request:
        """Return the request to identify a log: what is given, else what the file says.

        Args:
            telemetry: the log's file.
            sensors: a preset or a file.
            **given: other fields of `Request`; None for what the file says.

        Raises:
            InputError: the file lists its sensors itself, and no others are given.

        """
        sensors = sensors or self.sensors
        if sensors == EXPLICIT:
            raise InputError(
                "the scenario lists its sensors itself; write them into a file of their own, and "
                "give it as --sensors"
            )
        bodies = ",".join(f"{key}={value}" for key, value in vars(self.known_bodies).items())
        own: dict[str, Any] = {"momentum": self.momentum, "planar": self.planar}
        own["known_bodies"] = None if self.known_bodies.is_zero else bodies
        own |= {key: value for key, value in given.items() if value is not None}
        return Request(telemetry, self.reference(), sensors=sensors, **own)


def load_spacecraft(name: str | Path) -> SpacecraftFile:
    """Return what a scenario, or a spacecraft's own file, says about the spacecraft.

    The target and the motion of a scenario are not used.

    Raises:
        InputError: no such file, or for the same reasons as `cpid_drake.load_scenario`.

    """
    name = str(name)
    if name.lower().endswith((".urdf", ".sdf", ".xml", ".dmd.yaml", ".dmd.yml")):
        raise InputError(
            f"{name}: is a model, and does not say which body is the base; give it as --model, "
            "with --base and --capture-frame"
        )
    place = find_scenario(name)
    file = resolve_model(place)
    tree = parse_yaml(file.read_bytes(), name)
    if not (isinstance(tree, dict) and "spacecraft" in tree):
        found = from_tree(SpacecraftFile, tree, name, "the file of a spacecraft")
        resolve_paths(found, file.parent)
        found.sensors = found.sensors and suite_from_folder(file.parent, found.sensors)
        return found
    scenario = load_scenario(place)
    craft = scenario.spacecraft
    return SpacecraftFile(
        craft.model,
        craft.base,
        craft.capture_frame,
        craft.packages,
        sensors=EXPLICIT if scenario.sensors.explicit else scenario.sensors.suite or None,
        momentum=scenario.identification.momentum,
        planar=True if craft.on_table else None,
        known_bodies=scenario.known_bodies,
    )
