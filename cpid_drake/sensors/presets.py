"""Sensor suites by name or from YAML files."""

from pathlib import Path

from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import load_yaml
from cpid_drake.resources import models_directory, resolve_model
from cpid_drake.sensors.suite import SensorSuite, check_sensors


def sensor_presets() -> tuple[str, ...]:
    """Return the names of the shipped sensor suites."""
    return tuple(sorted(file.stem for file in preset_folder().glob("*.yaml")))


def load_sensors(name_or_path: str | Path) -> SensorSuite:
    """Return a shipped sensor suite, or one from a YAML file.

    A sensor that the file does not name, or gives as null, is absent. Absent keys have their
    default values.

    Args:
        name_or_path: one of `sensor_presets()`, else a path or a package:// URI.

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
    return suite


def preset_folder() -> Path:
    """Return the folder with the files of the shipped sensor suites."""
    return models_directory() / "sensors"
