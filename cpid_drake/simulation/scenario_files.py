"""Scenarios as YAML files."""

from pathlib import Path

from cpid_drake.files.checked_yaml import dump_yaml, load_yaml
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.resources import package_folders, resolve_model
from cpid_drake.sensors.presets import load_sensors, sensor_presets
from cpid_drake.simulation.joint_motions import MotionFile, load_motion
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.spacecraft.reference import SpacecraftReference


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file; absent keys have their default values.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values of the wrong type or size.

    """
    file = resolve_model(path)
    scenario = load_yaml(Scenario, file, str(path), "a scenario")
    with prefix_errors(str(path)):
        resolve_files(scenario, file.parent)
        check_files(scenario)
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario with all its defaults as YAML; `load_scenario` reads it without loss.

    Files that a scenario names are written as absolute paths, as `load_scenario` returns them.
    """
    return dump_yaml(scenario)


def resolve_files(scenario: Scenario, folder: Path) -> None:
    """Make the paths in a scenario absolute; relative ones start at a folder.

    Raises:
        InputError: a path names a user that does not exist.

    """
    target, sensors = scenario.target, scenario.sensors
    resolve_paths(scenario.spacecraft, folder)
    if target.visual_model is not None:
        target.visual_model = from_folder(folder, target.visual_model)
    if isinstance(scenario.joint_motion, MotionFile):
        scenario.joint_motion.file = from_folder(folder, scenario.joint_motion.file)
    if sensors.suite:
        sensors.suite = suite_from_folder(folder, sensors.suite)


def resolve_paths(spacecraft: SpacecraftReference, folder: Path) -> None:
    """Make the paths of a spacecraft's model absolute; see `resolve_files`."""
    spacecraft.model = from_folder(folder, spacecraft.model)
    places = spacecraft.packages.items()
    spacecraft.packages = {name: from_folder(folder, place) for name, place in places}


def check_files(scenario: Scenario) -> None:
    """Refuse a scenario whose motion or sensors cannot be read; its paths are absolute.

    Otherwise an unknown suite would stop a study that has been running for a while.
    """
    if isinstance(scenario.joint_motion, MotionFile):
        load_motion(scenario.joint_motion.file)
    if scenario.sensors.suite:
        with prefix_errors("sensors.suite"):
            load_sensors(scenario.sensors.suite)


def suite_from_folder(folder: Path, suite: str) -> str:
    """Return the name of a preset as it is, and the path of another suite from a folder."""
    return suite if suite in sensor_presets() else from_folder(folder, suite)


def from_folder(folder: Path, path: str) -> str:
    """Return a path that a file contains; relative paths start at the file's folder.

    Raises:
        InputError: the path names a user that does not exist.

    """
    try:
        return path if "://" in path else str(folder / Path(path).expanduser())
    except RuntimeError as error:  # the user in ~user does not exist
        raise InputError(f"{path:.200}: {error}") from error


def files_of(scenario: Scenario) -> list[Path]:
    """Return the files that a scenario names and that exist; packages' folders are left out."""
    names = [scenario.spacecraft.model, scenario.target.visual_model, scenario.sensors.suite]
    if isinstance(scenario.joint_motion, MotionFile):
        names.append(scenario.joint_motion.file)
    folders = package_folders(scenario.spacecraft.packages)
    found = []
    for name in filter(None, names):
        try:
            found.append(resolve_model(name, folders))
        except InputError:  # a shipped preset
            continue
    return found
