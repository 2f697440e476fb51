"""Scenarios, and spacecraft in them or alone, as YAML files."""

from pathlib import Path

from cpid_drake.files.checked_yaml import from_tree, load_yaml, parse_yaml
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.resources import (
    find_scenario,
    from_folder,
    package_folders,
    resolve_model,
)
from cpid_drake.sensors.presets import load_sensors, suite_from_folder
from cpid_drake.simulation.joint_motions import MotionFile, load_motion
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.spacecraft.spacecraft_file import EXPLICIT, SpacecraftFile


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


def load_spacecraft(name: str | Path) -> SpacecraftFile:
    """Return what a scenario, or a spacecraft's own file, says about the spacecraft.

    The target and the motion of a scenario are not used.

    Raises:
        InputError: no such file, or for the same reasons as `load_scenario`.

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
        spacecraft = from_tree(SpacecraftFile, tree, name, "the file of a spacecraft")
        spacecraft.resolve(file.parent)
        if spacecraft.sensors:
            spacecraft.sensors = suite_from_folder(file.parent, spacecraft.sensors)
        return spacecraft
    scenario = load_scenario(place)
    reference = scenario.spacecraft
    return SpacecraftFile(
        **vars(reference.reference()),
        sensors=EXPLICIT if scenario.sensors.explicit else scenario.sensors.suite or None,
        momentum=scenario.identification.momentum,
        planar=True if reference.on_table else None,
        known_bodies=scenario.known_bodies,
    )


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
    scenario.spacecraft.resolve(folder)
    if target.visual_model is not None:
        target.visual_model = from_folder(folder, target.visual_model)
    if isinstance(scenario.joint_motion, MotionFile):
        scenario.joint_motion.file = from_folder(folder, scenario.joint_motion.file)
    if sensors.suite:
        sensors.suite = suite_from_folder(folder, sensors.suite)


def check_files(scenario: Scenario) -> None:
    """Refuse a scenario whose motion or sensors cannot be read; its paths are absolute.

    Otherwise an unknown suite would stop a study that has been running for a while.
    """
    if isinstance(scenario.joint_motion, MotionFile):
        load_motion(scenario.joint_motion.file)
    if scenario.sensors.suite:
        with prefix_errors("sensors.suite"):
            load_sensors(scenario.sensors.suite)


def files_of(scenario: Scenario) -> list[Path]:
    """Return the files that a scenario names and that exist; packages' folders are left out."""
    names = [scenario.spacecraft.model, scenario.target.visual_model, scenario.sensors.suite]
    if isinstance(scenario.joint_motion, MotionFile):
        names.append(scenario.joint_motion.file)
    folders = package_folders(scenario.spacecraft.packages)
    files = []
    for name in filter(None, names):
        try:
            files.append(resolve_model(name, folders))
        except InputError:  # a shipped preset
            continue
    return files
