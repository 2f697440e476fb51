"""A simulated run as files: telemetry, true parameters, scenario and versions."""

import json
import platform
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.identification.requests import Request
from cpid_drake.identification.result_files import SpacecraftReference
from cpid_drake.input_files.validation import dump_yaml, nulls
from cpid_drake.resources import version_of
from cpid_drake.scenario.files import dump_scenario
from cpid_drake.scenario.schema import Scenario
from cpid_drake.scenario.simulation import Simulation
from cpid_drake.sensing.files.telemetry_files import write_telemetry

RUN_FILES = (
    *("telemetry.csv", "truth.csv", "truth.json"),
    *("scenario.yaml", "sensors.yaml", "run.json"),
)
"""Names of the files of a run."""


def refuse_other_files(folder: Path) -> None:
    """Refuse a folder with files of these names that no earlier run has written.

    Raises:
        InputError: such files would be overwritten; one may be the scenario that is simulated.

    """
    if not (folder / "run.json").is_file():
        for name in RUN_FILES:
            if (folder / name).exists():
                raise InputError(
                    f"--out {folder}: has a {name} that no earlier run has written; give another "
                    "folder"
                )


def write_run(
    simulation: Simulation, root_context: Context, folder: Path, wall_seconds: float
) -> list[Path]:
    """Write a run into an existing folder, and replace the files of an earlier run.

    - `telemetry.csv`: the samples of the sensors; without sensors the exact motion;
    - `sensors.yaml`: the sensors' errors, if there are sensors;
    - `truth.csv`: the exact motion, every `SimulationConfig.log_period`;
    - `truth.json`: the target's true parameters, with the keys of a result file;
    - `scenario.yaml`: the complete scenario;
    - `run.json`: versions, seed, momentum drift, and the online estimate.

    Args:
        simulation: the simulation that was run.
        root_context: the Context that its `run` returned.
        folder: an existing folder.
        wall_seconds: duration of the run [s].

    Returns:
        The files, telemetry first.

    """
    truth = simulation.telemetry(root_context)
    files = [folder / "telemetry.csv", folder / "truth.csv"]
    sensors = simulation.sensors
    write_telemetry(files[0], simulation.measurements(root_context) if sensors else truth)
    write_telemetry(files[1], truth)
    scenario = simulation.scenario
    texts = {"truth.json": _json(target_document(simulation))}
    (folder / "sensors.yaml").unlink(missing_ok=True)
    if sensors:
        texts["sensors.yaml"] = dump_yaml(sensors.suite)
    texts["scenario.yaml"] = dump_scenario(scenario)
    names = [*(file.name for file in files), *texts, "run.json"]
    texts["run.json"] = _json(
        {
            "versions": versions(),
            "simulated_seconds": scenario.simulation.duration,
            "wall_seconds": round(wall_seconds, 3),
            "sensor_seed": scenario.sensors.seed if sensors else None,
            "momentum_drift": momentum_drift(simulation, truth),
            "files": names,
            "online_identification": online_document(simulation, root_context),
        }
    )
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        files.append(folder / name)
    return files


def versions() -> dict[str, str | None]:
    """Return the versions of this package and its libraries, by name."""
    packages = ("cpid-drake", "drake", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: version_of(name) for name in packages}


def target_document(simulation: Simulation) -> dict[str, Any]:
    """Return the true target in C: mass [kg], com [m], inertia about the centre of mass [kg·m²]."""
    mass, *rest = simulation.truth.to_vector().tolist()
    return {
        "mass": mass,
        "com": rest[:3],
        "inertia": rest[3:],
        "inertia_entries": list(PARAMETER_NAMES[4:]),
    }


def momentum_drift(simulation: Simulation, truth: Telemetry) -> dict[str, float]:
    """Return the largest change of the total momentum since the start, about W's origin."""
    P, L = total_momentum(simulation.spacecraft.tree, simulation.truth, truth)
    drift = {"linear_N_s": P - P[0], "angular_N_m_s": L - L[0]}
    return {name: float(np.linalg.norm(each, axis=1).max()) for name, each in drift.items()}


def online_document(simulation: Simulation, root_context: Context) -> dict[str, Any]:
    """Return the online estimate at the end; unknown values are null."""
    result = simulation.identification(root_context)
    found = {"estimate": result.parameters, "sigma": np.sqrt(np.diag(result.covariance))}
    return {
        "estimator": simulation.scenario.identification.estimator,
        "says": result.explain(),
        **{
            key: dict(zip(PARAMETER_NAMES, nulls(values), strict=True))
            for key, values in found.items()
        },
    }


def request_of_run(scenario: Scenario, folder: Path) -> Request:
    """Return the request that identifies the target from the files of a run."""
    craft, sensors = scenario.spacecraft, folder / "sensors.yaml"
    return Request(
        str(folder / "telemetry.csv"),
        SpacecraftReference(craft.model, craft.base, craft.capture_frame, craft.packages),
        sensors=str(sensors) if sensors.is_file() else None,
        momentum="unknown" if scenario.identification.unknown_momentum else "zero",
    )


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
