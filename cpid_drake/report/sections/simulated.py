"""The section that describes the simulated scenario."""

import json

from cpid_drake.report.page import Cell, Section, Table
from cpid_drake.report.run_folder import Run


def simulated_section(run: Run) -> Section:
    """Return the section with the simulated scenario and the online estimate at its end.

    Its warnings are the limits of the spacecraft that the joint motion exceeds.
    """
    scenario, document = run.scenario, json.loads(run.texts["run"])
    sensors = scenario.sensors
    named = sensors.suite or "defined in the scenario"
    facts: list[tuple[str, str | Cell]] = [
        ("Spacecraft", str(scenario.spacecraft.model)),
        ("Duration", f"{scenario.simulation.duration:g} s"),
        ("Mass of the target", f"{run.truth.mass:g} kg"),
        ("Joint motion", type(scenario.joint_motion).__name__),
        ("Sensors", named if sensors.present else "none (exact motion)"),
        ("Online estimator", scenario.online_estimator.replace("_", " ")),
    ]
    wanted = {
        "Seed of the noise": "sensor_seed",
        "Momentum drift [N·s]": "momentum_drift.linear_N_s",
        "Momentum drift [N·m·s]": "momentum_drift.angular_N_m_s",
    }
    for name, path in wanted.items():
        value = _at(document, path)
        if isinstance(value, (int, float)):
            text = f"{value:.2g}" if isinstance(value, float) else str(value)
            facts.append((name, Cell(text, value, path, "run")))
    closest, exceeded = _at(document, "limits.closest"), _at(document, "limits.exceeded")
    if closest:
        facts.append(("Closest bodies", Cell(str(closest), str(closest), "limits.closest", "run")))
    texts = exceeded if isinstance(exceeded, list) else []
    return Section(
        "Simulation",
        facts=facts,
        tables=_online(document),
        warnings=[f"The spacecraft cannot make this motion: {text}." for text in texts],
    )


def _online(document: object) -> list[Table]:
    """Return a table of the online estimate, if there is one."""
    path = "online_identification.estimate"
    estimate = _at(document, path)
    if not isinstance(estimate, dict):
        return []
    cells = [
        Cell(
            f"{value:.4g}" if isinstance(value, (int, float)) else "not known",
            value,
            f"{path}.{name}",
            "run",
        )
        for name, value in estimate.items()
    ]
    return [Table(["", *estimate], [["online estimate", *cells]])]


def _at(document: object, path: str) -> object:
    """Return the value at a path such as "a.b" in JSON; None if there is none."""
    for key in path.split("."):
        document = document.get(key) if isinstance(document, dict) else None
    return document
