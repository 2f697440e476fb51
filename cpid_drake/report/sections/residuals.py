"""The section with the residuals."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.requests import Evidence
from cpid_drake.report.figures import (
    Picture,
    residual_pictures,
    residual_unit,
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
        if not found.leftovers:
            return ["There are none to look at with this estimator, or not all ten are known."]
        if found.estimator == "trajectory_fit":
            text = (
                "What the fit leaves of each sensor's samples, in units of the noise that was "
                "assumed; the band is ±2σ."
            )
        else:
            text = "What the estimate leaves of the momentum balance, in the capture frame."
        whole = found.residuals
        if whole is None:
            text += " The samples were smoothed, so neighbours hang together."
        elif whole.is_white:
            text += " Neighbours do not hang together: what is left is noise."
        else:
            text += (
                f" Neighbours hang together (correlation {whole.lag_one:+.2f}): something beside "
                "noise is left, such as a model that is not quite right, or of a simulation its "
                "integration error."
            )
        return [text]

    @property
    def table(self) -> Table | None:
        """Size and whiteness, kind by kind."""
        found = self.evidence.found
        if not found.leftovers:
            return None
        rows = []
        for name, samples in found.leftovers.items():
            white = whiteness(samples.value)
            size = np.sqrt(np.mean(samples.value**2, axis=0))
            rows.append(
                [
                    name,
                    Cell(str(len(samples))),
                    *(Cell(f"{value:.3g}") for value in size),
                    residual_unit(found, name),
                    Cell(f"{white.lag_one:+.3f} ± {white.band:.3f}"),
                    "yes" if white.is_white else "no",
                ]
            )
        heads = ["", "samples", "rms x", "rms y", "rms z", "unit", "lag-one correlation", "white"]
        if found.residuals is None:  # smoothed samples are not expected to be white
            heads, rows = heads[:-1], [row[:-1] for row in rows]
        return Table(heads, rows)

    @property
    def pictures(self) -> list[Picture]:
        """Against time, and autocorrelation."""
        return residual_pictures(self.evidence.found)
