"""An identification as a result file and in words."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.result import ADVICE, Identification
from cpid_drake.identification.result_files import (
    FeasibleEstimate,
    IdentificationResult,
    Source,
    SpacecraftReference,
    WhitenessRecord,
)


def result_of(
    found: Identification, reference: SpacecraftReference, source: Source
) -> IdentificationResult:
    """Return an identification in the form of a result file.

    Args:
        found: the identification.
        reference: the spacecraft that was used.
        source: the data and options of the identification.

    """
    solution, white = found.solution, found.whiteness
    feasible = moments = axes = record = None
    if found.is_observable:
        target = found.feasible()
        feasible = FeasibleEstimate(target.mass, *np.split(target.to_vector()[1:], [3]))
        moments, axes = principal_axes(target)
    if white is not None:
        record = WhitenessRecord(white.lag_one, white.is_white, white.correlation_time)
    condition, mass = solution.condition_number, found.parameters[0]
    return IdentificationResult(
        mass=float(mass) if np.isfinite(mass) else None,
        com=found.parameters[1:4],
        inertia=found.parameters[4:],
        covariance=found.covariance,
        feasible=feasible,
        rank=solution.rank,
        condition=float(condition) if np.isfinite(condition) else None,
        samples_used=found.sample_count,
        samples_rejected=sum(found.rejected.values()),
        warnings=list(found.warnings),
        estimator=found.estimator,
        rows=found.rows,
        spacecraft=reference,
        interval_95=found.intervals,
        infeasibilities=list(found.raw().infeasibilities()) if found.is_observable else [],
        principal_moments=moments,
        principal_axes=axes,
        not_observable=found.describe_gap(),
        singular_values=solution.singular_values,
        residual_whiteness=record,
        samples_rejected_by_sensor=found.rejected,
        source=source,
    )


def principal_axes(target: InertialParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the principal moments (3,), ascending, and their axes: columns (3, 3), in C.

    The largest entry of the first two axes is positive; the third makes the axes right-handed.
    """
    moments, axes = np.linalg.eigh(target.I_TTcm_C)
    for k in range(2):
        axes[:, k] *= np.sign(axes[np.abs(axes[:, k]).argmax(), k])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def describe(found: Identification, result: IdentificationResult) -> list[str]:
    """Return a result as lines of text: parameters, their uncertainty, and advice."""
    how = found.estimator + (f" with {found.rows} rows" if found.rows else "")
    source = result.source
    window = f" in {source.start:.6g} to {source.end:.6g} s" if source else ""
    lines = [
        f"Target in {result.spacecraft.capture_frame}, by {how}, from {result.samples_used} "
        f"samples{window}",
        "",
        f"  {'':4}{'estimate':>16}{'95 % interval':>34}   {'':6}{'consistent':>16}",
    ]
    target = result.target
    consistent = np.full(10, np.nan) if target is None else target.to_vector()
    rows = zip(PARAMETER_NAMES, PARAMETER_UNITS, result.parameters, found.intervals, consistent)
    for name, unit, value, (low, high), nearest in rows:
        places = decimals(high - low)
        known = f"{value:.{places}f}" if np.isfinite(value) else "not known"
        spread = f"[{low:.{places}f}, {high:.{places}f}]" if np.isfinite(low) else ""
        last = f"{nearest:.{places}f}" if np.isfinite(nearest) else ""
        lines.append(f"  {name:4}{known:>16}{spread:>34}   {unit:6}{last:>16}".rstrip())
    lines.append("")
    if result.principal_moments is not None and result.principal_axes is not None:
        lines.append("  principal moments [kg·m²] and axes in C")
        for moment, column in zip(result.principal_moments, result.principal_axes.T):
            axis = ", ".join(f"{round(entry, 5) + 0.0:8.5f}" for entry in column)
            lines.append(f"      {moment:16.8g}   ({axis})")
        lines.append("")
    lines.append(f"  rank         {result.rank} of 10")
    if result.condition is not None:
        lines.append(f"  condition    {result.condition:.4g}")
    lines.append(f"  residuals    {_residuals(found)}")
    lines.append(f"  consistency  {_consistency(result)}")
    if result.samples_rejected:
        by_sensor = ", ".join(f"{count} of {name}" for name, count in found.rejected.items())
        lines.append(f"  not used     {by_sensor}")
    if not found.is_observable:
        lines += [
            "",
            f"Not all ten are known: {result.not_observable}.",
            f"To see the rest: {ADVICE}.",
        ]
    return lines


def decimals(width: float) -> int:
    """Return the number of decimals that shows this half-width with two or three digits."""
    if not (np.isfinite(width) and width > 0):
        return 6
    return int(np.clip(2 - np.floor(np.log10(width)), 0, 11))


def _residuals(found: Identification) -> str:
    white = found.whiteness
    if white is None:
        return "not tested for whiteness"
    text = f"correlation of neighbours {white.lag_one:+.3f}"
    if white.is_white:
        return f"{text}: white"
    if found.sensors is None:
        time = white.correlation_time
        return f"{text}: not white; {time:.3g} samples count as one in the intervals"
    return f"{text}: not white"


def _consistency(result: IdentificationResult) -> str:
    if result.feasible is None:
        return "not known before all ten parameters are"
    if not result.infeasibilities:
        return "the estimate is physically consistent"
    problems = "; ".join(result.infeasibilities)
    return f"no rigid body has the estimate ({problems}); the nearest consistent one is given"
