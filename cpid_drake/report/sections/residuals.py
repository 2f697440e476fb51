"""The section with the residuals."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.requests import Evidence
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import (
    Picture,
    residual_pictures,
)
from cpid_drake.report.page import Cell, Section, Table


@dataclass(frozen=True, eq=False)
class Residuals(Section):
    """What the estimate leaves of the samples."""

    evidence: Evidence
    title: ClassVar[str] = "Residuals"
    template: ClassVar[str] = "pictures.html.j2"

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        found = self.evidence.found
        if not found.residuals:
            return ["This estimator gives none, or not all ten parameters are known."]
        if _of_sensors(found):
            text = (
                "Measured minus predicted samples of each sensor, in units of the assumed noise; "
                "the band is ±2σ."
            )
        else:
            text = "Residuals of the momentum balance, in the capture frame."
        whole = found.whiteness
        if whole is None:
            text += " The samples were smoothed, so neighbours are correlated."
        elif whole.is_white:
            text += " Neighbours are not correlated: the residuals are noise."
        else:
            text += (
                f" Neighbours are correlated ({whole.lag_one:+.2f}): the residuals hold more than "
                "noise, such as an error of the model, or the integration error of a simulation."
            )
        return [text]

    @property
    def table(self) -> Table | None:
        """Size and whiteness, kind by kind."""
        found = self.evidence.found
        if not found.residuals:
            return None
        rows = []
        for name, samples in found.residuals.items():
            white = whiteness(samples.value)
            size = np.sqrt(np.mean(samples.value**2, axis=0))
            rows.append(
                [
                    name,
                    Cell(str(len(samples))),
                    *(Cell(f"{value:.3g}") for value in size),
                    samples.unit,
                    Cell(f"{white.lag_one:+.3f} ± {white.band:.3f}"),
                    "yes" if white.is_white else "no",
                ]
            )
        heads = ["", "samples", "rms x", "rms y", "rms z", "unit", "lag-one correlation", "white"]
        if found.whiteness is None:  # smoothed samples are not expected to be white
            heads, rows = heads[:-1], [row[:-1] for row in rows]
        return Table(heads, rows)

    @property
    def pictures(self) -> list[Picture]:
        """Against time, and autocorrelation."""
        return residual_pictures(self.evidence.found)


def _of_sensors(found: Identification) -> bool:
    return all(series.unit == "σ" for series in found.residuals.values())
