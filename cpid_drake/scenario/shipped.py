"""Finds scenario files by name. Imports nothing heavy: a wrong name is reported at once."""

from pathlib import Path

from cpid_drake.errors import InputError, choose_from
from cpid_drake.resources import models_directory, resolve_model


def shipped_scenario(name: str) -> Path:
    """Return the path of a scenario that comes with the package, such as "paper".

    Raises:
        InputError: there is none of this name.

    """
    folder = models_directory() / "scenarios"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        names = sorted(file.stem for file in folder.glob("*.yaml"))
        raise InputError(f"no shipped scenario '{name}'; {choose_from(name, names)}")
    return path


def find_scenario(name_or_path: str) -> Path | str:
    """Return the scenario file that a user means: a path, or a shipped one's name such as "paper".

    A name with an ending or a slash is a path or a package:// URI.

    Raises:
        InputError: there is no such file, or no shipped scenario of this name.

    """
    if not (Path(name_or_path).suffix or "/" in name_or_path):
        return shipped_scenario(name_or_path)
    resolve_model(name_or_path)
    return name_or_path
