"""`cpid list`."""

import re

from rich.table import Table

from cpid_drake.commands.options import log_console
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.files.resources import models_directory
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.sensors.presets import load_sensors, preset_folder, sensor_presets


def list() -> None:
    """List the shipped scenarios and sensors, the estimators and their row families."""
    scenarios = sorted((models_directory() / "scenarios").glob("*.yaml"))
    parts = {
        "Scenarios": {file.stem: _first_sentence(file.read_text("utf-8")) for file in scenarios},
        f"Sensors (--sensors), files in {preset_folder()}": {
            name: load_sensors(name).description for name in sensor_presets()
        },
        "Estimators (--estimator)": {
            name: f"{record.label}: {record.good_for}" for name, record in ESTIMATORS.items()
        },
        "Rows of least_squares (--rows)": {
            name: family.good_for for name, family in ROW_FAMILIES.items()
        },
    }
    console = log_console(stderr=False)
    for title, part in parts.items():
        table = Table.grid(padding=(0, 2))
        for name, text in part.items():
            table.add_row(name, text)
        console.print(title, style="bold")
        console.print(table, soft_wrap=False)


def _first_sentence(text: str) -> str:
    """Return the first sentence of the comment that a YAML file begins with."""
    comment = re.match(r"(?:#[^\n]*\S[^\n]*\n)*", text)
    words = " ".join(comment[0].replace("#", "").split()) if comment else ""
    return re.split(r"\.(?= [A-Z])|\.$", words)[0]
