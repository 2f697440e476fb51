"""Scenarios as YAML files."""

from pathlib import Path

from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.input_files.validation import dump_yaml, load_yaml
from cpid_drake.resources import package_folders, resolve_model
from cpid_drake.scenario.joint_motions import MOTION_TAGS, MotionFile, load_motion
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.presets import load_sensors, sensor_presets


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file; absent keys have their default values.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values of the wrong type or size.

    """
    file = resolve_model(path)
    scenario = load_yaml(Scenario, file, str(path), "a scenario", MOTION_TAGS)
    spacecraft, target = scenario.spacecraft, scenario.target
    with prefix_errors(str(path)):
        spacecraft.model = _from_folder(file.parent, spacecraft.model)
        spacecraft.packages = {
            name: _from_folder(file.parent, folder) for name, folder in spacecraft.packages.items()
        }
        if target.visual_model is not None:
            target.visual_model = _from_folder(file.parent, target.visual_model)
        if isinstance(scenario.joint_motion, MotionFile):
            scenario.joint_motion.file = _from_folder(file.parent, scenario.joint_motion.file)
            load_motion(scenario.joint_motion.file)
    _find_suites(scenario, file.parent, str(path))
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario with all its defaults as YAML; `load_scenario` reads it without loss.

    Files that a scenario names are written as absolute paths, as `load_scenario` returns them.
    """
    return dump_yaml(scenario, MOTION_TAGS)


def _from_folder(folder: Path, path: str) -> str:
    """Resolve a path that a scenario's file contains; relative paths start at the file's folder."""
    try:
        return path if "://" in path else str(folder / Path(path).expanduser())
    except RuntimeError as error:  # the user in ~user does not exist
        raise InputError(f"{path:.200}: {error}") from error


def _find_suites(scenario: Scenario, folder: Path, where: str) -> None:
    """Resolve the paths of the sensor suites from the folder, and check that all can be read.

    Otherwise an unknown suite would stop a study that has been running for a while.
    """
    known = sensor_presets()

    def find(suite: str, key: str) -> str:
        with prefix_errors(f"{where}: {key}"):
            found = suite if suite in known else _from_folder(folder, suite)
            load_sensors(found)
        return found

    if scenario.sensors.suite:
        scenario.sensors.suite = find(scenario.sensors.suite, "sensors.suite")
    presets = scenario.accuracy.presets
    presets[:] = [find(suite, f"accuracy.presets[{k}]") for k, suite in enumerate(presets)]


def files_of(scenario: Scenario) -> list[Path]:
    """Return the files that a scenario names and that exist; packages' folders are left out."""
    presets = [scenario.sensors.suite, *scenario.accuracy.presets]
    names = [scenario.spacecraft.model, scenario.target.visual_model, *presets]
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
