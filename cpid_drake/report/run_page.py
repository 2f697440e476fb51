"""The report of a simulated run: what was simulated, and what its telemetry says of the target."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.identification.requests import Request, identify_file
from cpid_drake.identification.result_files import SpacecraftReference
from cpid_drake.report.identification_page import (
    Findings,
    Progress,
    findings_of,
    identification_report,
)
from cpid_drake.report.page import Cell, Report, Section, Table
from cpid_drake.scenario.files import load_scenario
from cpid_drake.scenario.schema import Scenario


@dataclass(frozen=True, eq=False)
class Run:
    """A run's folder, read.

    Attributes:
        folder: where it is.
        scenario: what was simulated.
        truth: the target.
        texts: the JSON files, by name without ending.

    """

    folder: Path
    scenario: Scenario
    truth: InertialParameters
    texts: dict[str, str]


def read_run(folder: Path) -> Run:
    """Read the folder that `cpid simulate` wrote.

    Raises:
        InputError: a file is missing or is not of a run.

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


def run_report(folder: Path, progress: Progress) -> tuple[Report, Findings]:
    """Return the report of a run's folder, and what was found from its telemetry.

    Raises:
        InputError: as `read_run` and `evidence.identify_file`.

    """
    run = read_run(folder)
    craft, sensors = run.scenario.spacecraft, folder / "sensors.yaml"
    request = Request(
        str(folder / "telemetry.csv"),
        SpacecraftReference(
            str(craft.model), craft.base, craft.capture_frame, dict(craft.packages)
        ),
        sensors=str(sensors) if sensors.is_file() else None,
        unknown_momentum=run.scenario.identification.unknown_momentum,
    )
    findings = replace(
        findings_of(identify_file(request, progress), progress),
        truth=run.truth,
        visual_model=run.scenario.target.visual_model,
    )
    report = identification_report(
        findings,
        before=(Simulated(run),),
        title=f"Simulated run “{folder.resolve().name}”",
        progress=progress,
    )
    return Report(
        report.title, report.subtitle, report.sections, {**report.data, **run.texts}
    ), findings


@dataclass(frozen=True, eq=False)
class Simulated(Section):
    """What was simulated."""

    run: Run
    title: ClassVar[str] = "What was simulated"
    template: ClassVar[str] = "run.html.j2"

    @property
    def facts(self) -> list[tuple[str, str | Cell]]:
        """Names and values."""
        scenario, document = self.run.scenario, json.loads(self.run.texts["run"])
        sensors = scenario.sensors
        named = sensors.suite or "the scenario’s own"
        facts: list[tuple[str, str | Cell]] = [
            ("Spacecraft", str(scenario.spacecraft.model)),
            ("Duration", f"{scenario.simulation.duration:g} s"),
            ("Target", f"{self.run.truth.mass:g} kg"),
            ("Joint motion", type(scenario.joint_motion).__name__),
            ("Sensors", named if sensors.present else "none: the exact motion"),
            ("Online estimator", scenario.identification.estimator.replace("_", " ")),
        ]
        wanted = {
            "Seed of the sensors": ("sensor_seed",),
            "Momentum drift [N·s]": ("momentum_drift", "linear_N_s"),
            "Momentum drift [N·m·s]": ("momentum_drift", "angular_N_m_s"),
        }
        for name, path in wanted.items():
            value: Any = document
            for key in path:
                value = value.get(key) if isinstance(value, dict) else None
            if isinstance(value, (int, float)):
                text = f"{value:.2g}" if isinstance(value, float) else str(value)
                facts.append((name, Cell(text, value, ".".join(path), "run")))
        return facts

    @property
    def online(self) -> Table | None:
        """What the online identifier found by the end of the run."""
        online = json.loads(self.run.texts["run"]).get("online_identification")
        estimate = online.get("estimate") if isinstance(online, dict) else None
        if not isinstance(estimate, dict):
            return None
        cells = [
            Cell(
                f"{value:.4g}" if isinstance(value, (int, float)) else "not known",
                value,
                f"online_identification.estimate.{name}",
                "run",
            )
            for name, value in estimate.items()
        ]
        return Table(["", *estimate], [["online estimate at the end", *cells]])


def _refuse(literal: str) -> None:
    raise ValueError(f"{literal} is not a finite number")
