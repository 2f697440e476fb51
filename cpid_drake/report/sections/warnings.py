"""The section with the warnings and the checks."""

import numpy as np

from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section, Table


def warnings_section(result: Identification, again: Identification | None) -> Section:
    """Return the section with the warnings of a result.

    Args:
        result: the result that is reported.
        again: the result of the same log, identified again for the report; None if the log was not
            identified again.

    """
    texts = list(result.warnings)
    if again is not None:
        sigma, values = np.sqrt(np.nan_to_num(np.diag(result.covariance))), again.parameters
        close = np.abs(values - result.parameters) <= 1e-3 * sigma + 1e-9 * np.abs(values)
        if not np.all(close | (np.isnan(values) & np.isnan(result.parameters))):
            texts.append(
                "For this report the log was identified again; the values differ from those of "
                "the result file, and the figures below show the new ones. The model, the "
                "sensors or the software have changed since the result file was written."
            )
    tables = [_checks(result)] if result.checks else []
    return Section("Warnings", warnings=texts, texts=[] if texts else ["None."], tables=tables)


def _checks(result: Identification) -> Table:
    rows: list[list[Cell | str]] = []
    for k, check in enumerate(result.checks):
        numbers = {"statistic": check.statistic, "limit": check.limit}
        cells = [
            Cell("" if number is None else f"{number:.3g}", number, f"checks.{k}.{key}")
            for key, number in numbers.items()
        ]
        rows.append([check.name, *cells, "passed" if check.passed else "failed"])
    return Table(["", "statistic", "limit", ""], rows, "Checks of the assumptions of the estimate")
