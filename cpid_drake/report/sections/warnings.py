"""The section with the warnings."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class Warnings(Section):
    """The warnings of the identification, and of differences to a result file."""

    findings: Findings
    title = "Warnings"
    template = "warnings.html.j2"

    @property
    def texts(self) -> list[str]:
        """One sentence for each warning."""
        result, evidence = self.findings.result, self.findings.evidence
        texts = list(result.warnings)
        if evidence is not None:
            sigma = np.sqrt(np.nan_to_num(np.diag(result.covariance)))
            again = evidence.result.parameters
            close = np.abs(again - result.parameters) <= 1e-3 * sigma + 1e-9 * np.abs(again)
            if not np.all(close | (np.isnan(again) & np.isnan(result.parameters))):
                texts.append(
                    "For this report the log was identified again; the values differ from those of "
                    "the result file, and the figures below show the new ones. The model, the "
                    "sensors or the software have changed since the result file was written."
                )
        return texts
