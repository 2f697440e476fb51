"""What an identification tells about its unknowns, as rows for a joint estimate."""

from typing import TYPE_CHECKING

from cpid_drake.estimation.combination import SourceRows

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification


def rows_of(found: "Identification") -> SourceRows:
    """Return the combinations of unknowns that an identification determines.

    Rows without given sensors have the variance of their residuals.
    """
    solution = found.solution
    variance = 1.0 if found.whiteness is None else found.whiteness.correlation_time
    if found.sensors is None and solution.row_count > solution.rank:
        freedom = solution.row_count - solution.rank
        variance *= solution.residual_rms**2 * solution.row_count / freedom
    return SourceRows.of_solution(solution, variance)
