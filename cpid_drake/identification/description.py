"""An identification in words."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.checks import AGREEMENT
from cpid_drake.identification.consistency import REACH
from cpid_drake.identification.leaning import ALL, LINK
from cpid_drake.identification.result import Identification


def principal_axes(target: InertialParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the principal moments (3,), ascending, and their axes: columns (3, 3), in C.

    The largest entry of the first two axes is positive; the third makes the axes right-handed.
    """
    moments, axes = np.linalg.eigh(target.I_TTcm_C)
    for k in range(2):
        axes[:, k] *= np.sign(axes[np.abs(axes[:, k]).argmax(), k])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def describe(result: Identification) -> list[str]:
    """Return a result as lines of text: parameters, their uncertainty, and advice."""
    how = result.estimator + (f" with {result.rows} rows" if result.rows else "")
    source = result.sources[0] if len(result.sources) == 1 else None
    frame = "" if result.spacecraft is None else f" in {result.spacecraft.capture_frame}"
    failures = [f"failed check: {failure}" for failure in result.failures]
    window = f" in {source.start:.6g} to {source.end:.6g} s" if source else ""
    lines = [
        *failures,
        f"Target{frame}, by {how}, from {result.sample_count} samples{window}",
        "",
    ]
    cells = [("", "estimate", "95 % interval", "", "consistent", "by 1 % of a body")]
    leans = np.abs(np.array([np.full(10, np.nan), *result.leaning.values()]))
    nearest = np.full(10, np.nan) if result.nearest is None else result.nearest
    for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        value, (low, high) = result.parameters[k], result.shown_intervals[k]
        places = decimals(high - low)
        known = f"{value:.{places}f}" if np.isfinite(value) else "not known"
        spread = _spread(low, high, places)
        last = f"{nearest[k]:.{places}f}" if np.isfinite(nearest[k]) else ""
        change = np.fmax.reduce(leans[:, k])
        by_bodies = f"±{change:.2g}" if np.isfinite(change) else ""
        cells.append((name, known, spread, unit, last, by_bodies))
    lines += [*_table(cells), ""]
    if result.consistent is not None:
        moments, axes = principal_axes(result.consistent)
        lines.append("  principal moments [kg·m²] and axes in C")
        for moment, column in zip(moments, axes.T):
            axis = ", ".join(f"{round(entry, 5) + 0.0:8.5f}" for entry in column)
            lines.append(f"      {moment:16.8g}   ({axis})")
        lines.append("")
    lines.append(f"  rank         {result.rank} of {result.most}")
    if result.condition is not None:
        lines.append(f"  condition    {result.condition:.4g}")
    lines.append(f"  consistency  {consistency_words(result)}")
    if source and source.request.known_bodies is None:
        lines.append("  assumed      an exact spacecraft model; --known-bodies includes its errors")
    if result.rejected:
        by_sensor = ", ".join(f"{count} of {name}" for name, count in result.rejected.items())
        lines.append(f"  not used     {by_sensor}")
    for effect in result.effects:
        state = effect.describe() if effect.is_learned else "not determined by these samples"
        lines.append(f"  estimated    {effect.name}: {state}")
    lines += _leaning(result)
    if result.logs:
        lines += ["", *_of_logs(result)]
    lines += ["", *_of_bodies(result)] if result.consistent_intervals is not None else []
    if not result.is_observable:
        lines += ["", *result.gap()]
    return lines


def _leaning(result: Identification) -> Iterator[str]:
    """Yield by how much errors of what is held would move the estimate, at most in σ."""
    sigma = np.sqrt(np.diag(result.covariance))
    for name, change in result.leaning.items():
        known = np.isfinite(change) & (sigma > 0)
        if known.any():
            k = int(np.argmax(np.where(known, np.abs(change) / sigma, -1.0)))
            largest = f"{change[k] / sigma[k]:+.2g} σ"
            text = f"{PARAMETER_NAMES[k]} by {largest}"
            if known[0]:
                share = f"m by {100 * change[0] / result.parameters[0]:+.2g} %"
                text = f"{share}, {text}" if k else f"{share}, which is {largest}"
            what = name if name in (LINK, ALL) else f"the base's {name}"
            yield f"  leans on     1 % of {what} changes {text}"


def _spread(low: float, high: float, places: int) -> str:
    if np.isfinite(low) and np.isfinite(high):
        return f"[{low:.{places}f}, {high:.{places}f}]"
    if np.isfinite(low):
        return f"above {low:.{places}f}"
    return f"below {high:.{places}f}" if np.isfinite(high) else ""


def _of_bodies(result: Identification) -> Iterator[str]:
    """Yield the lines about the physically consistent part of the intervals."""
    if not result.is_possible:
        yield "No interval is given, because no rigid body agrees with the estimate."
        return
    if not np.isfinite(result.parameters).all():
        yield (
            "Intervals of what is not known: bounds over all rigid bodies no part of which is "
            f"farther than {result.size:.2g} m from C ({REACH:g} times the spacecraft's "
            "radius of gyration)."
        )


def _of_logs(result: Identification) -> Iterator[str]:
    """Yield the lines about the separate estimates of logs and prior."""
    width = max(map(len, result.logs))
    yield f"  The sources {agreement_words(result)}. Each on its own:"
    for name, part in result.logs.items():
        low, high = part.intervals[0]
        places = decimals(high - low)
        mass = "m not known"
        if np.isfinite(high - low):
            mass = f"m = {part.parameters[0]:.{places}f} ± {(high - low) / 2:.{places}f} kg"
        yield (
            f"      {name:{width}}  rank {part.rank:2}  {part.sample_count:7} samples  "
            f"{agreement_words(part):18}  {mass}"
        )


def agreement_words(result: Identification) -> str:
    """Return whether an estimate agrees with others, or its parts with one another, in words."""
    check = result.check(AGREEMENT)
    if check is None or check.statistic is None or check.limit is None:
        return "have nothing in common" if result.logs else "nothing to compare"
    verb = "agree" if check.passed else "differ"
    if result.logs:
        return f"{verb} (χ² {check.statistic:.3g}; the check fails above {check.limit:.3g})"
    return f"{verb}s (χ² {check.statistic:.3g})"


def _table(cells: list[tuple[str, str, str, str, str, str]]) -> list[str]:
    """Return the table of the parameters, as narrow as its columns are."""
    sizes = [max(map(len, column)) for column in zip(*cells)]
    return [
        f"  {name:4}{known:>{sizes[1]}}  {spread:>{sizes[2]}}  {unit:{sizes[3]}}"
        f"  {last:>{sizes[4]}}  {by_bodies:>{sizes[5]}}".rstrip()
        for name, known, spread, unit, last, by_bodies in cells
    ]


def decimals(width: float) -> int:
    """Return the number of decimals that shows this half-width with two or three digits."""
    if not (np.isfinite(width) and width > 0):
        return 6
    return int(np.clip(2 - np.floor(np.log10(width)), 0, 11))


def consistency_words(result: Identification) -> str:
    """Return whether a rigid body has the estimate, in words."""
    problems = "; ".join(result.infeasibilities)
    if result.consistent is not None and problems:
        return f"no rigid body has the estimate ({problems}); the nearest consistent one is given"
    if result.consistent is not None:
        return "the estimate is physically consistent"
    if problems:
        return f"no rigid body is near the estimate ({problems})"
    if result.consistent_intervals is None:
        return "not known before all ten parameters are"
    return f"{'some' if result.is_possible else 'no'} rigid body agrees with the estimate"
