"""The section that shows how the estimate converged."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.report.figures import (
    Picture,
    convergence_pictures,
)
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class ConvergenceSection(Section):
    """The estimates from the first part of the log, for ever longer parts."""

    findings: Findings
    title = "Convergence"
    template = "pictures.html.j2"
    table = None

    @property
    def texts(self) -> list[str]:
        """An explanation of the pictures."""
        if not self.pictures:
            return ["No part of the log determines any parameter."]
        text = (
            "Estimates from the samples up to each time, with their 95 % intervals as a band. The "
            "axes are scaled for the later estimates; earlier ones may lie outside. At times "
            "without a point the samples do not determine the parameter yet."
        )
        dashed = " Dashed line: true value." if self.findings.truth is not None else ""
        return [text + dashed]

    @property
    def pictures(self) -> list[Picture]:
        """One picture for each parameter."""
        if np.isnan(self.findings.convergence.parameters).all():
            return []
        return convergence_pictures(self.findings.convergence, self.findings.truth)
