"""An identification as a result file and in words."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.source_rows import SourceRows
from cpid_drake.identification.consistency import Consistency
from cpid_drake.identification.effects import EffectEstimate, UndeclaredErrors
from cpid_drake.identification.result import (
    ADVICE,
    Identification,
    JointEstimate,
    SeparateEstimate,
)
from cpid_drake.identification.result_files import (
    BodiesRecord,
    CombinationsRecord,
    EffectRecord,
    FeasibleEstimate,
    IdentificationResult,
    JointRecord,
    SeparateRecord,
    Source,
    SpacecraftReference,
    UndeclaredRecord,
    WhitenessRecord,
)
from cpid_drake.identification.table_setting import MORE_MOTION


def result_of(
    found: Identification,
    reference: SpacecraftReference,
    sources: Sequence[Source] = (),
    known_mass: float | None = None,
) -> IdentificationResult:
    """Return an identification in the form of a result file.

    Args:
        found: the identification.
        reference: the spacecraft that was used.
        sources: the data and options of each log.
        known_mass: mass of the spacecraft [kg]; None to leave out the combinations that a result
            of a rank below ten determines.

    """
    solution, white = found.solution, found.whiteness
    feasible = moments = axes = record = None
    target = found.consistent
    if target is not None:
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
        doubts=list(found.doubts),
        estimator=found.estimator,
        rows=found.rows,
        spacecraft=reference,
        interval_95=found.intervals,
        infeasibilities=list(found.raw().infeasibilities()) if found.is_observable else [],
        principal_moments=moments,
        principal_axes=axes,
        not_observable=found.describe_gap(),
        table=_on_table(found),
        bodies=_bodies(found.consistency),
        singular_values=solution.singular_values,
        residual_whiteness=record,
        samples_rejected_by_sensor=found.rejected,
        effects=_effect_records(found.effects),
        undeclared=None if found.undeclared is None else _undeclared_record(found.undeclared),
        source=sources[0] if len(sources) == 1 else None,
        joint=None if found.joint is None else _joint_record(found.joint, sources),
        combinations=_combinations_of(found, known_mass),
    )


def _effect_records(effects: Iterable[EffectEstimate]) -> list[EffectRecord]:
    return [
        EffectRecord(e.name, e.unit, e.value, e.sigma, e.prior_sigma, e.describe()) for e in effects
    ]


def _undeclared_record(undeclared: UndeclaredErrors) -> UndeclaredRecord:
    return UndeclaredRecord(
        _effect_records(undeclared.effects),
        undeclared.suspected,
        dict(undeclared.alone),
        undeclared.held_out,
        undeclared.is_proposed,
        undeclared.declaration,
    )


def _bodies(consistency: Consistency | None) -> BodiesRecord | None:
    if consistency is None:
        return None
    low, high = np.where(np.isfinite(consistency.intervals), consistency.intervals, np.nan).T
    return BodiesRecord(
        consistency.parameters, low, high, consistency.size, consistency.is_possible
    )


def _joint_record(joint: JointEstimate, sources: Sequence[Source]) -> JointRecord:
    def record(one: SeparateEstimate, source: Source | None) -> SeparateRecord:
        return SeparateRecord(
            one.name,
            one.parameters,
            one.intervals,
            one.rank,
            one.sample_count,
            one.probability,
            list(one.doubts),
            source,
        )

    return JointRecord(
        [record(log, source) for log, source in zip(joint.logs, sources, strict=True)],
        None if joint.prior is None else record(joint.prior, None),
        max(joint.chi_squared, 0.0),
        joint.freedom,
        joint.probability,
        list(joint.dominated),
    )


def _combinations_of(found: Identification, known_mass: float | None) -> CombinationsRecord | None:
    if known_mass is None or found.is_observable or not found.solution.rank:
        return None
    rows = SourceRows.of_solution(found.solution)
    return CombinationsRecord(
        found.parameterization.name, known_mass, found.solution.values, rows.A.T @ rows.A
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


_WIDE = 81
"""Number of characters of the table with all columns."""


def describe(
    found: Identification, result: IdentificationResult, width: int | None = None
) -> list[str]:
    """Return a result as lines of text: parameters, their uncertainty, and advice.

    Args:
        found: the identification.
        result: the same in the form of a result file.
        width: number of characters of a line, at least 60; None for any number. Tables fit into it.

    """
    how = found.estimator + (f" with {found.rows} rows" if found.rows else "")
    source = result.source
    doubts = [f"not trustworthy: {doubt}" for doubt in result.doubts]
    window = f" in {source.start:.6g} to {source.end:.6g} s" if source else ""
    lines = [
        *doubts,
        f"Target in {result.spacecraft.capture_frame}, by {how}, from {result.samples_used} "
        f"samples{window}",
        "",
    ]
    cells = [("", "estimate", "95 % interval", "", "consistent")]
    nearest = _nearest(result)
    is_marked = False
    for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        value, (low, high) = result.parameters[k], shown_interval(result, k)
        places = decimals(high - low)
        known = f"{value:.{places}f}" if np.isfinite(value) else "not known"
        spread = _spread(low, high, places)
        if np.isfinite(value) and is_narrowed(result, k):
            spread, is_marked = f"{spread}*", True
        last = f"{nearest[k]:.{places}f}" if np.isfinite(nearest[k]) else ""
        cells.append((name, known, spread, unit, last))
    lines += [*_table(cells, is_wide=width is None or width >= _WIDE), ""]
    if result.principal_moments is not None and result.principal_axes is not None:
        lines.append("  principal moments [kg·m²] and axes in C")
        for moment, column in zip(result.principal_moments, result.principal_axes.T):
            axis = ", ".join(f"{round(entry, 5) + 0.0:8.5f}" for entry in column)
            lines.append(f"      {moment:16.8g}   ({axis})")
        lines.append("")
    lines.append(f"  rank         {result.rank} of {found.table.size if found.table else 10}")
    if result.condition is not None:
        lines.append(f"  condition    {result.condition:.4g}")
    lines.append(f"  residuals    {residual_words(found)}")
    lines.append(f"  consistency  {_consistency(result)}")
    if source and source.known_bodies is None and found.rows is None:
        lines.append("  assumed      an exact spacecraft model; --known-bodies includes its errors")
    if result.samples_rejected:
        by_sensor = ", ".join(f"{count} of {name}" for name, count in found.rejected.items())
        lines.append(f"  not used     {by_sensor}")
    for effect in found.effects:
        state = effect.describe() if effect.is_learned else "not determined by these samples"
        lines.append(f"  estimated    {effect.name}: {state}")
    if result.joint is not None:
        lines += ["", *_of_joint(result.joint)]
    lines += ["", *_of_bodies(found, is_marked)] if found.consistency is not None else []
    if not found.is_observable:
        lines += ["", *gap_sentences(result)]
    return lines


def shown_interval(result: IdentificationResult, k: int) -> tuple[float, float]:
    """Return the interval of a parameter to show: what a rigid body can have of it.

    NaN for an end that is not known, or if no rigid body agrees with the estimate.
    """
    if result.bodies is not None:
        return float(result.bodies.interval_low[k]), float(result.bodies.interval_high[k])
    if result.interval_95 is None:
        return np.nan, np.nan
    low, high = result.interval_95[k]
    return float(low), float(high)


def is_narrowed(result: IdentificationResult, k: int) -> bool:
    """Return whether no rigid body can have a part of a parameter's 95 % interval."""
    if result.bodies is None or result.interval_95 is None or not result.bodies.possible:
        return False
    free, shown = result.interval_95[k], shown_interval(result, k)
    return bool(np.isfinite(free).all() and (shown[0] > free[0] or shown[1] < free[1]))


def _nearest(result: IdentificationResult) -> NDArray[np.float64]:
    """Return the nearest rigid body (10,); NaN where nothing is determined."""
    if result.target is not None:
        return result.target.to_vector()
    return np.full(10, np.nan) if result.bodies is None else result.bodies.parameters


def _spread(low: float, high: float, places: int) -> str:
    if np.isfinite(low) and np.isfinite(high):
        return f"[{low:.{places}f}, {high:.{places}f}]"
    if np.isfinite(low):
        return f"above {low:.{places}f}"
    return f"below {high:.{places}f}" if np.isfinite(high) else ""


def _of_bodies(found: Identification, is_marked: bool) -> Iterator[str]:
    """Yield the lines about what rigid bodies can have of the estimate."""
    consistency = found.consistency
    assert consistency is not None
    if not consistency.is_possible:
        yield "No interval is given, because no rigid body agrees with the estimate."
        return
    if is_marked:
        yield "* the part of the interval that a rigid body can have"
    if not np.isfinite(found.parameters).all():
        yield f"Intervals of what is not known: {consistency.assumption()}."


def _of_joint(joint: JointRecord) -> Iterator[str]:
    """Yield the lines about the separate estimates of logs and prior."""
    parts = joint.logs if joint.prior is None else [*joint.logs, joint.prior]
    names = [part.name or "the log" for part in parts]
    width = max(map(len, names))
    if len(joint.logs) > 1:
        yield (
            f"  The logs agree with probability {joint.probability:.2g} (χ² "
            f"{joint.chi_squared:.3g} for {joint.freedom} combinations). Each on its own:"
        )
    else:
        yield "  The log and the prior on their own:"
    for name, part in zip(names, parts):
        low, high = part.interval_95[0]
        places = decimals(high - low)
        mass = "m not known"
        if np.isfinite(high - low):
            mass = f"m = {part.parameters[0]:.{places}f} ± {(high - low) / 2:.{places}f} kg"
        yield (
            f"      {name:{width}}  rank {part.rank:2}  {part.samples_used:7} samples  "
            f"agrees {part.probability:8.2g}  {mass}"
        )


def gap_sentences(result: IdentificationResult) -> list[str]:
    """Return sentences on what is not known, why, and how to see it."""
    if result.table:
        return result.table
    unknown = f"Not all ten are known: {result.not_observable}."
    if result.doubts:  # another motion would not help
        return [unknown]
    return [unknown, f"To see the rest: {ADVICE}."]


def _on_table(found: Identification) -> list[str]:
    if found.table is None or found.is_complete:
        return [] if found.table is None else found.table.sentences()
    unknown = f"Not all of them are known: {found.describe_gap()}."
    return [*found.table.sentences(), unknown, f"To see the rest: {MORE_MOTION}."]


def _table(cells: list[tuple[str, str, str, str, str]], is_wide: bool) -> list[str]:
    """Return the table of the parameters; in a narrow one the last column is a second table."""
    if is_wide:
        return [
            f"  {name:4}{known:>16}{spread:>34}   {unit:6}{last:>16}".rstrip()
            for name, known, spread, unit, last in cells
        ]
    sizes = [max(map(len, column)) for column in zip(*cells)]
    first = [
        f"  {name:4}{known:>{sizes[1]}}  {spread:>{sizes[2]}} {unit}".rstrip()
        for name, known, spread, unit, _ in cells
    ]
    second = [f"  {name:4}{last:>{sizes[4]}} {unit}".rstrip() for name, _, _, unit, last in cells]
    return [*first, "", *second]


def decimals(width: float) -> int:
    """Return the number of decimals that shows this half-width with two or three digits."""
    if not (np.isfinite(width) and width > 0):
        return 6
    return int(np.clip(2 - np.floor(np.log10(width)), 0, 11))


def residual_words(found: Identification) -> str:
    """Return whether the residuals are noise, and what follows from it for the intervals."""
    white = found.whiteness
    if white is None:
        return "not tested for whiteness"
    text = f"correlation of neighbours {white.lag_one:+.3f}"
    if white.is_white:
        return f"{text}: white"
    if found.rows is not None:
        return f"{text}: {white.correlation_time:.3g} samples count as one in the intervals"
    if white.is_negligible:
        return f"{text}, but they are much smaller than the noise"
    return f"{text}: {'a check failed' if found.doubts else 'the intervals include it'}"


def _consistency(result: IdentificationResult) -> str:
    if result.feasible is None and result.infeasibilities:
        return f"no rigid body is near the estimate ({'; '.join(result.infeasibilities)})"
    if result.feasible is None and result.bodies is not None:
        possible = result.bodies.possible
        return f"{'some' if possible else 'no'} rigid body agrees with the estimate"
    if result.feasible is None:
        return "not known before all ten parameters are"
    if not result.infeasibilities:
        return "the estimate is physically consistent"
    problems = "; ".join(result.infeasibilities)
    return f"no rigid body has the estimate ({problems}); the nearest consistent one is given"
