"""An identification as a result file and in words."""

from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.observability import describe_unobservable
from cpid_drake.identification.result_files import IdentificationResult, SpacecraftReference
from cpid_drake.identification.telemetry_identification import LogIdentification

ADVICE = (
    "turn the target about three axes (joints with different axes moving at different "
    "times), with larger angles and rates, or log longer"
)


def intervals(found: LogIdentification) -> NDArray[np.float64]:
    """Return the 95 % intervals (10, 2) of the parameters; NaN where a parameter is not known."""
    identification, solution = found.identification, found.identification.solution
    freedom = solution.row_count - solution.rank
    by_residuals = found.estimator == "least_squares" and found.suite is None
    quantile = stdtrit(freedom, 0.975) if by_residuals and freedom > 0 else ndtri(0.975)
    half = quantile * np.sqrt(np.diag(identification.covariance))
    return identification.parameters[:, None] + half[:, None] * [-1.0, 1.0]


def result_of(
    found: LogIdentification, reference: SpacecraftReference, source: dict[str, Any]
) -> IdentificationResult:
    """Return an identification as what is written to a result file.

    Args:
        found: the identification.
        reference: the spacecraft that it was made with.
        source: what it was made from, for the file: names, times, hashes.

    """
    identification = found.identification
    solution, residuals = identification.solution, found.residuals
    feasible = identification.feasible() if identification.is_observable else None
    details: dict[str, Any] = {
        "names": list(PARAMETER_NAMES),
        "units": list(PARAMETER_UNITS),
        "interval_95": [_numbers(pair) for pair in intervals(found)],
        "infeasibilities": [],
        "principal_moments": None,
        "principal_axes": None,
        "not_observable": describe_unobservable(
            solution.unobservable, identification.parameterization.entries
        ),
        "singular_values": _numbers(solution.singular_values),
        "residual_whiteness": None,
        "samples_rejected_by_sensor": found.rejected,
        "source": source | {"cpid_drake": version("cpid-drake")},
    }
    if feasible is not None:
        details["infeasibilities"] = list(identification.raw().infeasibilities())
        moments, axes = principal_axes(feasible)
        details["principal_moments"], details["principal_axes"] = moments.tolist(), axes.tolist()
    if residuals is not None:
        details["residual_whiteness"] = {
            "lag_one_correlation": residuals.lag_one,
            "white": residuals.is_white,
            "correlation_time_samples": residuals.correlation_time,
        }
    condition = solution.condition_number
    return IdentificationResult(
        parameters=identification.parameters,
        covariance=identification.covariance,
        feasible=feasible,
        rank=solution.rank,
        condition=condition if np.isfinite(condition) else np.nan,
        samples_used=identification.sample_count,
        samples_rejected=sum(found.rejected.values()),
        warnings=found.warnings,
        estimator=found.estimator,
        rows=found.rows,
        spacecraft=reference,
        details=details,
    )


def principal_axes(
    target: InertialParameters,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the principal moments (3,), rising, and their axes: columns (3, 3), in C.

    The first two axes point the way of their largest entry, the third makes them right-handed.
    """
    moments, axes = np.linalg.eigh(target.I_TTcm_C)
    for k in range(2):
        axes[:, k] *= np.sign(axes[np.abs(axes[:, k]).argmax(), k])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def describe(found: LogIdentification, result: IdentificationResult) -> list[str]:
    """Return a result as lines of text: parameters, how well they are known, what to do."""
    details, identification = result.details, found.identification
    how = found.estimator + (f" with {found.rows} rows" if found.rows else "")
    source = details["source"]
    lines = [
        f"Target in {result.spacecraft.capture_frame}, by {how}, from {result.samples_used} "
        f"samples in {source['from']:.6g} to {source['to']:.6g} s",
        "",
        f"  {'':4}{'estimate':>16}{'95 % interval':>34}   {'':6}{'possible':>16}",
    ]
    possible = np.full(10, np.nan) if result.feasible is None else result.feasible.to_vector()
    rows = zip(PARAMETER_NAMES, PARAMETER_UNITS, result.parameters, intervals(found), possible)
    for name, unit, value, (low, high), nearest in rows:
        digits = decimals(high - low)
        known = f"{value:.{digits}f}" if np.isfinite(value) else "not known"
        spread = f"[{low:.{digits}f}, {high:.{digits}f}]" if np.isfinite(low) else ""
        last = f"{nearest:.{digits}f}" if np.isfinite(nearest) else ""
        lines.append(f"  {name:4}{known:>16}{spread:>34}   {unit:6}{last:>16}".rstrip())
    lines.append("")
    if result.feasible is not None:
        moments, axes = details["principal_moments"], details["principal_axes"]
        lines.append("  principal moments [kg·m²] and axes in C")
        for k, moment in enumerate(moments):
            axis = ", ".join(f"{round(axes[i][k], 5) + 0.0:8.5f}" for i in range(3))
            lines.append(f"      {moment:16.8g}   ({axis})")
        lines.append("")
    lines.append(f"  rank         {result.rank} of 10")
    if np.isfinite(result.condition):
        lines.append(f"  condition    {result.condition:.4g}")
    lines.append(f"  residuals    {_residuals(found)}")
    lines.append(f"  feasibility  {_feasibility(result)}")
    if result.samples_rejected:
        by_sensor = ", ".join(f"{count} of {name}" for name, count in found.rejected.items())
        lines.append(f"  not used     {by_sensor}")
    if not identification.is_observable:
        lines += [
            "",
            f"Not all ten are known: {details['not_observable'] or 'no motion was seen'}.",
            f"To see the rest: {ADVICE}.",
        ]
    return lines


def decimals(width: float) -> int:
    """Return how many decimals show an interval of this width with two or three digits."""
    if not (np.isfinite(width) and width > 0):
        return 6
    return int(np.clip(2 - np.floor(np.log10(width)), 0, 11))


def _residuals(found: LogIdentification) -> str:
    residuals = found.residuals
    if residuals is None:
        return "no statement about their whiteness with this estimator"
    text = f"correlation of neighbours {residuals.lag_one:+.3f}"
    if residuals.is_white:
        return f"{text}: white"
    if found.suite is None:
        time = residuals.correlation_time
        return f"{text}: not white; {time:.3g} samples count as one in the intervals"
    return f"{text}: not white"


def _feasibility(result: IdentificationResult) -> str:
    if result.feasible is None:
        return "not known before all ten are"
    problems = result.details["infeasibilities"]
    if not problems:
        return "a rigid body can have these values"
    return f"no rigid body has the estimate ({'; '.join(problems)}); the nearest possible is given"


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
