"""The section that says what was simulated."""

import json
from dataclasses import dataclass
from typing import Any

from cpid_drake.report.page import Cell, Section, Table
from cpid_drake.report.run_folder import Run


@dataclass(frozen=True, eq=False)
class Simulated(Section):
    """The simulated scenario, and the online estimate at its end."""

    run: Run
    title = "Simulation"
    template = "run.html.j2"

    @property
    def facts(self) -> list[tuple[str, str | Cell]]:
        """Names and values, for a list."""
        scenario, document = self.run.scenario, json.loads(self.run.texts["run"])
        sensors = scenario.sensors
        named = sensors.suite or "defined in the scenario"
        facts: list[tuple[str, str | Cell]] = [
            ("Spacecraft", str(scenario.spacecraft.model)),
            ("Duration", f"{scenario.simulation.duration:g} s"),
            ("Mass of the target", f"{self.run.truth.mass:g} kg"),
            ("Joint motion", type(scenario.joint_motion).__name__),
            ("Sensors", named if sensors.present else "none (exact motion)"),
            ("Online estimator", scenario.identification.estimator.replace("_", " ")),
        ]
        wanted = {
            "Seed of the noise": ("sensor_seed",),
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
        """The online estimate at the end of the run; None if there is none."""
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
        return Table(["", *estimate], [["online estimate", *cells]])
