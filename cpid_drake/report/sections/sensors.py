"""The section with a row for every sensor."""

import numpy as np

from cpid_drake.identification.identify_files import Evidence
from cpid_drake.report.page import Cell, Section, Table
from cpid_drake.sensors.sensors import SENSORS


def sensors_section(evidence: Evidence) -> Section:
    """Return the section that compares the samples of every sensor with the assumed noise."""
    found = evidence.found
    has_residuals = any(name in found.residuals for name in SENSORS)
    if found.sensors is None:
        texts = ["No noise was assumed: all complete samples have the same weight."]
    else:
        whose = "given" if evidence.inputs.sensors is not None else "estimated from the log"
        texts = [f"The noise of the sensors was {whose}."]
        if has_residuals:
            texts.append("χ² per reading is 1 if the samples scatter as much as assumed.")
    heads = ["", "samples", "every [ms]", "not used", "σ assumed", "unit", "χ² per reading"]
    columns = 4 if found.sensors is None else 7 if has_residuals else 6
    rows: list[list[Cell | str]] = []
    for name, samples in evidence.log.data.items():
        if not len(samples):
            continue
        step = float(np.median(np.diff(samples.time))) if len(samples) > 1 else np.nan
        sigma = ""
        if found.sensors is not None and name in found.sensors.present():
            sigma = ", ".join(f"{value:.2g}" for value in np.unique(found.sensors.sigmas(name)))
        left = found.residuals.get(name)
        rows.append(
            [
                SENSORS[name].label,
                Cell(str(len(samples))),
                Cell(f"{1e3 * step:.4g}" if np.isfinite(step) else ""),
                Cell(str(found.rejected.get(name, 0))),
                Cell(sigma),
                SENSORS[name].quantity.unit if sigma else "",
                Cell("" if left is None else f"{np.mean(left.value**2):.3f}"),
            ]
        )
    table = Table(heads[:columns], [row[:columns] for row in rows])
    return Section("Sensors", texts=texts, tables=[table])
