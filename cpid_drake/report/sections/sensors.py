"""The section with a row for every sensor."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cpid_drake.identification.requests import Evidence
from cpid_drake.report.page import Cell, Section, Table
from cpid_drake.sensing.sensors import SENSORS


@dataclass(frozen=True, eq=False)
class Sensors(Section):
    """How the samples fit the sensors."""

    evidence: Evidence
    title: ClassVar[str] = "Sensors"
    template: ClassVar[str] = "pictures.html.j2"
    pictures: ClassVar[tuple] = ()

    @property
    def texts(self) -> list[str]:
        """Where the noise is from."""
        found = self.evidence.found
        if found.sensors is None:
            return ["All complete samples weighed alike: no noise was assumed of any sensor."]
        whose = "given" if self.evidence.sensors is not None else "estimated from the log"
        texts = [f"The sensors' noise was {whose}."]
        if any(name in found.residuals for name in SENSORS):
            texts.append("χ² per reading is 1 where samples scatter as much as assumed.")
        return texts

    @property
    def table(self) -> Table:
        """A row a sensor."""
        found = self.evidence.found
        heads = ["", "samples", "every [ms]", "not used", "σ assumed", "unit", "χ² per reading"]
        rows = []
        for name, samples in self.evidence.measurements.items():
            if not len(samples):
                continue
            step = np.median(np.diff(samples.time)) if len(samples) > 1 else np.nan
            sigma = ""
            if found.sensors is not None and name in found.sensors.present():
                values = np.unique(found.sensors.sigmas(name))
                sigma = ", ".join(f"{value:.2g}" for value in values)
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
        if not any(name in found.residuals for name in SENSORS):
            heads, rows = heads[:6], [row[:6] for row in rows]
        if found.sensors is None:
            heads, rows = heads[:4], [row[:4] for row in rows]
        return Table(heads, rows)
