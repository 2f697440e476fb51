"""Reads the folder of a simulated run."""

import json
from dataclasses import dataclass
from pathlib import Path

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.scenario.files import load_scenario
from cpid_drake.scenario.schema import Scenario


@dataclass(frozen=True, eq=False)
class Run:
    """The contents of a run's folder.

    Attributes:
        folder: its path.
        scenario: the simulated scenario.
        truth: the true target.
        texts: contents of the JSON files, by file name without ending.

    """

    folder: Path
    scenario: Scenario
    truth: InertialParameters
    texts: dict[str, str]


def read_run(folder: Path) -> Run:
    """Return the contents of a folder that `cpid simulate` wrote.

    Raises:
        InputError: a file is missing, or its contents are not those of a run.

    """
    for name in ("run.json", "truth.json", "scenario.yaml", "telemetry.csv"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: not a run: there is no {name}")
    texts, documents = {}, {}
    for name in ("truth", "run"):
        path = folder / f"{name}.json"
        try:
            texts[name] = path.read_text(encoding="utf-8")
            documents[name] = json.loads(texts[name], parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: not JSON: {error}") from error
        if not isinstance(documents[name], dict):
            raise InputError(f"{path}: must hold an object")
    try:
        ten = [documents["truth"][key] for key in ("mass", "com", "inertia")]
        truth = InertialParameters.from_vector([ten[0], *ten[1], *ten[2]])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder}/truth.json: does not hold a target: {error}") from error
    return Run(folder, load_scenario(folder / "scenario.yaml"), truth, texts)


def _refuse(literal: str) -> None:
    raise ValueError(f"{literal} is not a finite number")
