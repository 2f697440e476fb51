"""The folder of a simulated run, and its section in a report."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.checked_yaml import from_tree, load_json
from cpid_drake.files.errors import InputError
from cpid_drake.report.page import Section, Table
from cpid_drake.simulation.limits import LimitCheck
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.simulation.scenario_files import load_scenario


@dataclass(frozen=True, eq=False)
class RunFile:
    """The keys of `run.json`."""

    versions: Mapping[str, str | None]
    simulated_seconds: float
    wall_seconds: float
    sensor_seed: int | None
    momentum_drift: Mapping[str, float]
    limits: LimitCheck
    files: list[str]
    online_identification: Mapping[str, Any]
    bytes: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Run:
    """The contents of a run's folder.

    Attributes:
        folder: path of the folder.
        scenario: the simulated scenario.
        truth: the true target.
        about: the contents of `run.json`.
        texts: contents of the JSON files, by file name without ending.

    """

    folder: Path
    scenario: Scenario
    truth: InertialParameters
    about: RunFile
    texts: dict[str, str]


def read_run(folder: Path) -> Run:
    """Return the contents of a folder that `cpid simulate` wrote.

    Raises:
        InputError: a file is missing or cut off, or the contents are not those of a run.

    """
    for name in ("run.json", "truth.json", "scenario.yaml", "telemetry.csv"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: not a whole run: there is no {name}")
    texts = {name: (folder / f"{name}.json").read_text("utf-8-sig") for name in ("truth", "run")}
    where = f"{folder}/run.json"
    about = from_tree(
        RunFile, load_json(texts["run"].encode(), where), where, "the record of a run"
    )
    for name, size in about.bytes.items():
        path = folder / Path(name).name
        actual = path.stat().st_size if path.is_file() else 0
        if actual < size:
            raise InputError(
                f"{path}: has {actual} of {size} bytes: it was cut off; copy the run again, or "
                "give the log itself"
            )
    scenario = load_scenario(folder / "scenario.yaml")
    return Run(folder, scenario, scenario.target_truth(), about, texts)


def simulated_section(run: Run) -> Section:
    """Return the section with the simulated scenario and the online estimate at its end.

    Its warnings are the limits of the spacecraft that the joint motion exceeds.
    """
    scenario, about, drift = run.scenario, run.about, run.about.momentum_drift
    estimate = about.online_identification["estimate"]
    named = scenario.sensors.suite or "defined in the scenario"
    facts = [
        ("Spacecraft", scenario.spacecraft.model),
        ("Duration", f"{scenario.simulation.duration:g} s"),
        ("Mass of the target", f"{run.truth.mass:g} kg"),
        ("Joint motion", type(scenario.joint_motion).__name__),
        ("Sensors", named if scenario.sensors.present else "none (exact motion)"),
        ("Seed of the noise", "none" if about.sensor_seed is None else str(about.sensor_seed)),
        ("Online estimator", scenario.online_estimator.replace("_", " ")),
        ("Momentum drift", f"{drift['linear_N_s']:.2g} N·s, {drift['angular_N_m_s']:.2g} N·m·s"),
        ("Closest bodies", about.limits.closest or "not checked"),
    ]
    cells = ["not identifiable" if value is None else f"{value:.4g}" for value in estimate.values()]
    return Section(
        "Simulation",
        facts=facts,
        tables=[Table(["", *estimate], [["online estimate", *cells]])],
        warnings=[f"The spacecraft cannot make this motion: {e}." for e in about.limits.exceeded],
        folded=not about.limits.exceeded,
    )
