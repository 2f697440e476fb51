"""Sensor suites by name or from YAML files."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from cpid_drake.files.checked_yaml import load_yaml
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import from_folder, models_directory, resolve_model
from cpid_drake.sensors.suite import SensorSuite, check_sensors


def sensor_presets() -> tuple[str, ...]:
    """Return the names of the shipped sensor suites."""
    return tuple(sorted(file.stem for file in preset_folder().glob("*.yaml")))


def load_sensors(name_or_path: str | Path, unstated: Literal["exact"] | None = None) -> SensorSuite:
    """Return a shipped sensor suite, or one from a YAML file.

    A sensor that the file does not name, or gives as null, is absent. Absent keys have their
    default values. An error whose σ is null or absent is not stated; one of zero does not exist.

    Args:
        name_or_path: one of `sensor_presets()`, else a path or a package:// URI.
        unstated: "exact" if errors without a stated σ are zero, as in a simulation of these
            sensors alone; default: as the file says.

    Raises:
        InputError: neither a preset nor a file, not YAML, unknown keys, values of the wrong type,
            or impossible sensors: see `suite.check_sensors`.

    """
    where, presets = str(name_or_path), sensor_presets()
    if where in presets:
        file = preset_folder() / f"{where}.yaml"
    else:
        try:
            file = resolve_model(name_or_path)
        except InputError as error:
            choices = ", ".join(presets)
            raise InputError(
                f"no sensors: {error}; choose from {choices}, or give a file"
            ) from error
    suite = load_yaml(SensorSuite, file, where, "a sensor suite")
    check_sensors(suite, where)
    return suite if unstated is None else replace(suite, unstated=unstated)


def suite_from_folder(folder: Path, suite: str) -> str:
    """Return the name of a preset as it is, and the path of another suite from a folder."""
    return suite if suite in sensor_presets() else from_folder(folder, suite)


def preset_folder() -> Path:
    """Return the folder with the files of the shipped sensor suites."""
    return models_directory() / "sensors"
