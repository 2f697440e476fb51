"""Scenarios as YAML files."""

from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from cpid_drake.errors import InputError
from cpid_drake.resources import models_directory, resolve_model
from cpid_drake.scenario.checks import check_scenario
from cpid_drake.scenario.naming import naming
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensing.presets import load_sensors, sensor_presets
from cpid_drake.yaml_files import choose_from, load_strictly


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
    """Return what a user means by a scenario: a file, or a shipped one's name, such as "paper".

    What has an ending or a slash is a file (or a package:// URI), whether it exists or not.

    Raises:
        InputError: a name of no shipped scenario.

    """
    is_file = Path(name_or_path).suffix or "/" in name_or_path
    return name_or_path if is_file else shipped_scenario(name_or_path)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file; keys it leaves out keep their defaults.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values of the wrong type or size.

    """
    file = resolve_model(path)
    scenario = load_strictly(Scenario, file, str(path), "a scenario")
    check_scenario(scenario, str(path))
    spacecraft, target = scenario.spacecraft, scenario.target
    with naming(str(path)):
        spacecraft.model = _from_folder(file.parent, spacecraft.model)
        spacecraft.packages = {
            name: _from_folder(file.parent, folder) for name, folder in spacecraft.packages.items()
        }
        if target.visual_model is not None:
            target.visual_model = _from_folder(file.parent, target.visual_model)
    _find_suites(scenario, file.parent, str(path))
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario with all its defaults as YAML; `load_scenario` gives the same again.

    Files that a scenario names are written as absolute paths, as it has been loaded.
    """
    text = yaml_dump_typed(scenario)
    # Not every version of Drake knows this key, and a simulation here does not depend on it.
    lines = [line for line in text.splitlines() if "publish_every_time_step:" not in line]
    return "\n".join(lines) + "\n"


def _from_folder(folder: Path, path: str) -> str:
    """Return a path that the scenario's author wrote, seen from the scenario's folder."""
    try:
        return path if "://" in path else str(folder / Path(path).expanduser())
    except RuntimeError as error:  # there is no such user
        raise InputError(f"{path:.200}: {error}") from error


def _find_suites(scenario: Scenario, folder: Path, where: str) -> None:
    """Turn the sensor suites' paths into those seen from the folder, and see that all can be read.

    An unknown suite would else be missed only when a study has been running for a while.
    """
    known = sensor_presets()

    def find(suite: str, key: str) -> str:
        try:
            found = suite if suite in known else _from_folder(folder, suite)
            load_sensors(found)
        except InputError as error:
            raise InputError(f"{where}: {key}: {error}") from error
        return found

    if scenario.sensors.suite:
        scenario.sensors.suite = find(scenario.sensors.suite, "sensors.suite")
    presets = scenario.accuracy.presets
    presets[:] = [find(suite, f"accuracy.presets[{k}]") for k, suite in enumerate(presets)]
