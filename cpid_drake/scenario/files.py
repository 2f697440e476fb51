"""Scenarios as YAML files."""

from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from cpid_drake.errors import InputError
from cpid_drake.resources import resolve_model
from cpid_drake.scenario.checks import check_scenario
from cpid_drake.scenario.naming import naming
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensing.presets import load_sensors, sensor_presets
from cpid_drake.yaml_files import load_strictly


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
