"""Sensor suites by name or from YAML files."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from cpid_drake.files.checked_yaml import from_tree, read_yaml
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import models_directory, resolve_model
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.suite import SensorSuite, check_sensors


def sensor_presets() -> tuple[str, ...]:
    """Return the names of the shipped sensor suites."""
    return tuple(sorted(file.stem for file in preset_folder().glob("*.yaml")))


_ERRORS = {kind.field for kind in KINDS.values()} | {"bias_random_walk"}
_ERRORS |= {f"{n}_{kind}" for n in ("acceleration", "torque") for kind in ("walk", "noise")}


def load_sensors(name_or_path: str | Path, unstated: Literal["exact"] | None = None) -> SensorSuite:
    """Return a shipped sensor suite, or one from a YAML file.

    A sensor that the file does not name, or gives as null, is absent. Absent keys have their
    default values. An error whose σ is null or absent is not stated, and one of zero does not
    exist; in a file without `version: 2`, zeros are not stated either.

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
    tree = read_yaml(file, where, "a sensor suite")
    if isinstance(tree, dict) and "version" not in tree:
        without = _without_zeros(tree)
        tree = {**without, "version": 2 if without == tree else 1}
    suite = from_tree(SensorSuite, tree, where, "a sensor suite")
    check_sensors(suite, where)
    return suite if unstated is None else replace(suite, unstated=unstated)


def _without_zeros(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a tree without the σ of zero of errors: by a file of the first version, no one."""
    found = dict[str, Any]()
    for key, value in tree.items():
        if isinstance(value, dict):
            found[key] = value if key == "orbit" else _without_zeros(value)
        elif key in _ERRORS and value == 0 and not isinstance(value, bool):
            found[key] = None
        else:
            found[key] = value
    return found


def preset_folder() -> Path:
    """Return the folder with the files of the shipped sensor suites."""
    return models_directory() / "sensors"
