"""The section with the warnings."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class Warnings(Section):
    """What a reader is warned of."""

    findings: Findings
    title: ClassVar[str] = "Warnings"
    template: ClassVar[str] = "warnings.html.j2"

    @property
    def texts(self) -> list[str]:
        """Sentences."""
        result, evidence = self.findings.result, self.findings.evidence
        texts = list(result.warnings)
        if evidence is not None:
            sigma = np.sqrt(np.nan_to_num(np.diag(result.covariance)))
            again = evidence.result.parameters
            close = np.abs(again - result.parameters) <= 1e-3 * sigma + 1e-9 * np.abs(again)
            if not np.all(close | (np.isnan(again) & np.isnan(result.parameters))):
                texts.append(
                    "Identified again for this report, the log gave other values than the result "
                    "holds: the figures below are not of this result. Model, sensors or versions "
                    "have changed since."
                )
        return texts
