"""A simulated run as files: telemetry, true parameters, scenario and versions."""

import json
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.drafts import draft_folder
from cpid_drake.files.dumping import dump_yaml, nulls
from cpid_drake.files.resources import version_of
from cpid_drake.logs.formats import write_log
from cpid_drake.simulation.limits import LimitCheck
from cpid_drake.simulation.scenario_files import dump_scenario
from cpid_drake.simulation.simulation import Simulation

RUN_FILES = (
    *("telemetry.csv", "truth.csv", "truth.json"),
    *("scenario.yaml", "sensors.yaml", "run.json"),
)
"""Names of the files of a run. The last shows that the run is whole."""


def write_run(
    simulation: Simulation,
    root_context: Context,
    folder: Path,
    wall_seconds: float,
    limits: LimitCheck,
) -> list[Path]:
    """Write a run into a folder, and replace files of an earlier run together; return the files.

    - `telemetry.csv`: the samples of the sensors; without sensors the exact motion;
    - `sensors.yaml`: the sensors' errors, if there are sensors;
    - `truth.csv`: the exact motion, every `SimulationConfig.log_period`;
    - `truth.json`: the target's true parameters, with the keys of a result file;
    - `scenario.yaml`: the complete scenario;
    - `run.json`: versions, seed, momentum drift, exceeded limits, the online estimate, and the
      sizes of the logs.

    Args:
        root_context: the Context that `run` of the simulation returned.
        wall_seconds: duration of the run [s].

    Raises:
        InputError: a file cannot be written; the files of an earlier run are then unchanged.

    """
    truth, sensors = simulation.motion(root_context), simulation.sensors
    scenario = simulation.scenario
    mass, *rest = simulation.truth.to_vector().tolist()
    names = list(PARAMETER_NAMES[4:])
    target = {"mass": mass, "com": rest[:3], "inertia": rest[3:], "inertia_entries": names}
    texts = {"truth.json": _json(target)}
    # That of all bodies has to be that at the start, and what the forces from outside gave.
    error = simulation.momentum(root_context) - simulation.expected_momentum(root_context)
    drift = {"linear_N_s": error[:, 3:], "angular_N_m_s": error[:, :3]}
    if sensors:
        texts["sensors.yaml"] = dump_yaml(sensors.suite)
    texts["scenario.yaml"] = dump_scenario(scenario)
    logs = {
        "telemetry.csv": simulation.log(root_context) if sensors else truth,
        "truth.csv": truth,
    }
    names = [*logs, *texts, "run.json"]
    about = {
        "versions": versions(),
        "simulated_seconds": scenario.simulation.duration,
        "wall_seconds": round(wall_seconds, 3),
        "sensor_seed": scenario.sensors.seed if sensors else None,
        "momentum_drift": {k: np.linalg.norm(x, axis=1).max() for k, x in drift.items()},
        "limits": asdict(limits),
        "files": names,
        "online_identification": online_document(simulation, root_context),
    }
    with draft_folder(folder, RUN_FILES) as draft:
        for name, log in logs.items():
            write_log(draft / name, log)
        for name, text in texts.items():
            (draft / name).write_text(text, encoding="utf-8")
        # A log that was cut off when the folder was copied still looks like a log.
        sizes = {name: (draft / name).stat().st_size for name in logs}
        (draft / "run.json").write_text(_json({**about, "bytes": sizes}), encoding="utf-8")
    return [folder / name for name in names]


def versions() -> dict[str, str | None]:
    """Return the versions of this package and its libraries, by name."""
    packages = ("cpid-drake", "drake", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: version_of(name) for name in packages}


def online_document(simulation: Simulation, root_context: Context) -> dict[str, Any]:
    """Return the online estimate at the end; unknown values are null."""
    result = simulation.identification(root_context)
    document = {"estimate": result.parameters, "sigma": np.sqrt(np.diag(result.covariance))}
    return {
        "estimator": simulation.scenario.online_estimator,
        "failures": list(result.failures),
        "says": result.explain(),
        **{
            key: dict(zip(PARAMETER_NAMES, nulls(values), strict=True))
            for key, values in document.items()
        },
    }


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
