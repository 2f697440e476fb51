"""Reads the folder of a simulated run."""

from dataclasses import dataclass
from pathlib import Path

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import load_json
from cpid_drake.output_files.drafts import refuse_unfinished
from cpid_drake.scenario.files import load_scenario
from cpid_drake.scenario.schema import Scenario


@dataclass(frozen=True, eq=False)
class Run:
    """The contents of a run's folder.

    Attributes:
        folder: path of the folder.
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
        InputError: the folder is unfinished, a file is missing or cut off, or its contents are not
            those of a run.

    """
    refuse_unfinished(folder)
    for name in ("run.json", "truth.json", "scenario.yaml", "telemetry.csv"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: not a run: there is no {name}")
    texts, documents = {}, {}
    for name in ("truth", "run"):
        path = folder / f"{name}.json"
        document = load_json(path.read_bytes(), str(path))
        if not isinstance(document, dict):
            raise InputError(f"{path}: must hold an object")
        texts[name], documents[name] = path.read_text(encoding="utf-8-sig"), document
    _refuse_cut_logs(folder, documents["run"].get("bytes"))
    try:
        ten = [documents["truth"][key] for key in ("mass", "com", "inertia")]
        truth = InertialParameters.from_vector([ten[0], *ten[1], *ten[2]])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder}/truth.json: does not hold a target: {error}") from error
    return Run(folder, load_scenario(folder / "scenario.yaml"), truth, texts)


def _refuse_cut_logs(folder: Path, sizes: object) -> None:
    """Refuse a folder with a log that is missing or smaller than when it was written."""
    if not isinstance(sizes, dict):
        return  # of an earlier version
    for name, size in sizes.items():
        path = folder / Path(name).name
        found = path.stat().st_size if path.is_file() else 0
        if isinstance(size, int) and found < size:
            raise InputError(
                f"{path}: has {found} of {size} bytes: it was cut off; copy the run again, or give "
                "the log itself"
            )
