"""The section that shows how the estimate converged."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cpid_drake.report.figures import (
    Picture,
    convergence_pictures,
)
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class ConvergenceSection(Section):
    """Convergence."""

    findings: Findings
    title: ClassVar[str] = "Convergence"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        if not self.pictures:
            return ["No parameter was known at any time."]
        text = (
            "The estimate from the samples up to each time, with its 95 % band. The scale is that "
            "of the later estimates: earlier ones and wider bands leave the picture. Where nothing "
            "is drawn the parameter was not known yet."
        )
        dashed = " Dashed: the truth." if self.findings.truth is not None else ""
        return [text + dashed]

    @property
    def pictures(self) -> list[Picture]:
        """One a parameter."""
        if np.isnan(self.findings.convergence.parameters).all():
            return []
        return convergence_pictures(self.findings.convergence, self.findings.truth)
