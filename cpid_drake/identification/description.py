"""An identification in words."""

from collections.abc import Iterator
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, UNIT_TENSORS
from cpid_drake.dynamics.plane import parallel_axis
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.files.digits import decimals, significant, with_half_width
from cpid_drake.identification.budget import ALL, BudgetRow
from cpid_drake.identification.checks import AGREEMENT

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification

SHOWN = 5
"""Number of rows of the budget that are shown."""

_Row = tuple[str, str, str, str, str]


def principal_axes(target: InertialParameters) -> tuple[Array, Array]:
    """Return the principal moments (3,), ascending, and their axes: columns (3, 3), in C.

    The largest entry of the first two axes is positive; the third makes the axes right-handed.
    """
    moments, axes = np.linalg.eigh(target.I_TTcm_C)
    for k in range(2):
        axes[:, k] *= np.sign(axes[np.abs(axes[:, k]).argmax(), k])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def describe(result: "Identification") -> list[str]:
    """Return a result as lines of text: parameters, their uncertainty, and advice."""
    return [
        *(f"failed check: {failure}" for failure in result.failures),
        origin(result),
        "",
        *_aligned(_cells(result)),
        "",
        *_notes(result),
    ]


def html(result: "Identification") -> str:
    """Return a result as a part of an HTML page, in the page's own colours."""
    heads, *rows = _cells(result)
    shown = [f"<b>Failed check: {escape(failure)}</b>" for failure in result.failures]
    shown += [f"Warning: {escape(warning)}" for warning in result.warnings]
    box = "border-left: 4px solid #D55E00; margin: 0.4em 0; padding-left: 0.6em; max-width: 70em"
    lines = [f'<div style="{box}">{text}</div>' for text in shown]
    lines += [f"<div>{escape(origin(result))}</div>", '<table style="border-collapse: collapse">']
    for tag, row in (("th", heads), *(("td", row) for row in rows)):
        cells = (
            f'<{tag} style="padding: 0.15em 0.7em; text-align: {side}">{escape(text)}</{tag}>'
            for text, side in zip(row, ("left", "right", "right", "left", "right", "right"))
        )
        lines.append(f"<tr>{''.join(cells)}</tr>")
    notes = escape("\n".join(_notes(result)))
    style = "background: none; color: inherit; white-space: pre-wrap"
    lines += ["</table>", f'<pre style="{style}">{notes}</pre>']
    return "\n".join(lines)


def summary(result: "Identification") -> str:
    """Return a result in one line: how it was found, rank, mass and failed checks."""
    failed = [check.name for check in result.checks if not check.passed]
    checks = f"failed checks: {', '.join(failed)}" if failed else "no check failed"
    mass = replace(result["m"], checks_passed=True)
    return f"Identification({_how(result)}; rank {result.rank} of {result.most}; {mass}; {checks})"


def verdict(result: "Identification") -> str:
    """Return the mass with its interval, and whether the checks passed, as a headline."""
    mass = result["m"]
    text = f"m {'= ' if mass.is_identifiable else ''}{mass.in_words()}"
    if result.rank < result.most:
        text += f"; {result.rank} of {result.most} combinations are determined"
    failed = [check.name for check in result.checks if not check.passed]
    if failed:
        more = f" and {len(failed) - 2} more" if len(failed) > 2 else ""
        return (
            f"{'A check' if len(failed) == 1 else 'Checks'} failed: {', '.join(failed[:2])}{more}"
        )
    return f"{text}; {'all checks passed' if result.checks else 'no check was made'}"


def _how(result: "Identification") -> str:
    how = result.estimator + (f" with {result.rows} rows" if result.rows else "")
    return f"by {how}, from {result.sample_count} samples"


def origin(result: "Identification") -> str:
    """Return the line that says where the result comes from."""
    frame = "" if result.spacecraft is None else f" in {result.spacecraft.capture_frame}"
    source = result.sources[0] if len(result.sources) == 1 else None
    window = f" in {source.start:.6g} to {source.end:.6g} s" if source else ""
    exact = f", for an exact {result.given[0]}" if result.given else ""
    return f"Target{frame}, {_how(result)}{window}{exact}"


def _cells(result: "Identification") -> list[_Row]:
    """Return the table of the parameters, its heads first."""
    nearest = np.full(10, np.nan) if result.nearest is None else result.nearest
    cells: list[_Row] = [("", "estimate", "95 % interval", "", "consistent")]
    for k, name in enumerate(PARAMETER_NAMES):
        each = result[name]
        last = f"{nearest[k]:.{each.decimals}f}" if np.isfinite(nearest[k]) else ""
        cells.append((name, each.shown(), each.shown_interval(), each.unit, last))
    return cells


def _aligned(cells: list[_Row]) -> list[str]:
    """Return the lines of a table, as narrow as its columns are."""
    sizes = [max(map(len, column)) for column in zip(*cells)]
    return [
        f"  {name:4}{estimate:>{sizes[1]}}  {spread:>{sizes[2]}}  {unit:{sizes[3]}}"
        f"  {last:>{sizes[4]}}".rstrip()
        for name, estimate, spread, unit, last in cells
    ]


def _notes(result: "Identification") -> list[str]:
    """Return the lines below the table."""
    lines = list(_of_axes(result))
    lines.append(f"  rank         {result.rank} of {result.most}")
    if result.condition is not None:
        lines.append(f"  condition    {significant(result.condition, 4)}")
    lines.append(f"  consistency  {consistency_words(result)}")
    if result.rejected:
        by_sensor = ", ".join(f"{count} of {name}" for name, count in result.rejected.items())
        lines.append(f"  not used     {by_sensor}")
    learned = (effect for effect in result.effects if effect.is_learned)
    lines += [f"  estimated    {effect.name}: {effect.describe()}" for effect in learned]
    lines += _budget(result)
    if result.logs:
        lines += ["", *_of_logs(result)]
    lines += ["", *_of_bodies(result)] if result.consistent_intervals is not None else []
    if not result.is_identifiable:
        lines += ["", *gap(result)]
    return lines


def _of_axes(result: "Identification") -> Iterator[str]:
    """Yield the lines about the principal axes, with the digits that the covariance allows."""
    if result.consistent is None:
        return
    moments, axes = principal_axes(result.consistent)
    # The change of the tensor by each of its six numbers, in the principal axes.
    turned = np.einsum("jk,pjl,lm->pkm", axes, UNIT_TENSORS, axes)
    P = result.covariance[4:, 4:]
    yield "  principal moments [kg·m²] and axes in C"
    for k, (moment, axis) in enumerate(zip(moments, axes.T)):
        apart = moment - np.delete(moments, k)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.delete(axes, k, axis=1) @ (np.delete(turned[:, k], k, axis=1) / apart).T
            sigma = np.sqrt(np.diag(slope @ P @ slope.T)).max()
        places = 5 if np.isnan(P).any() else decimals(4 * sigma) if np.isfinite(sigma) else 1
        entries = (f"{round(entry, places) + 0.0:8.{min(places, 5)}f}" for entry in axis)
        text = f"{moment:.{decimals(4 * np.sqrt(turned[:, k, k] @ P @ turned[:, k, k]))}f}"
        yield f"      {text:>16}   ({', '.join(entries)})"
    yield ""


def _budget(result: "Identification") -> Iterator[str]:
    """Yield what the variance comes from: the errors with the largest shares."""
    rows = [row for row in result.budget if row.name != ALL][:SHOWN]
    if not rows:
        return
    yield "  uncertainty  would be less by this share of the variance, if known (shares overlap):"
    width = max(len(row.name) for row in rows)
    for row in rows:
        line = f"      {row.name:{width}}  {', '.join(shares_in_words(row))}"
        if row.value is not None and row.sigma is not None and row.matters is not None:
            value = with_half_width(row.value, quantile_95() * row.sigma)
            line += f"; it is {value} {row.unit}, half of this goes if known to "
            line += f"{significant(row.matters)} (1 σ)"
        yield line
    for total in (row for row in result.budget if row.name == ALL):
        words = ", ".join(shares_in_words(total))
        yield f"      {ALL:{width}}  {words}"


def shares_in_words(row: BudgetRow) -> Iterator[str]:
    """Yield the shares of mass, centre of mass and inertia; of the last two the largest."""
    for part in (slice(0, 1), slice(1, 4), slice(4, 10)):
        own = row.shares[part]
        if np.isfinite(own).any():
            k = int(np.nanargmax(own))
            share = 100 * own[k]
            text = f"{share:.0f}" if share < 99.5 else significant(share, 4)
            yield f"{PARAMETER_NAMES[part][k]} {text} %"


def _of_bodies(result: "Identification") -> Iterator[str]:
    """Yield the lines about the physically consistent part of the intervals."""
    if not result.is_consistent:
        yield "No interval is given, because no rigid body agrees with the estimate."
        return
    if (np.isnan(result.parameters)[:, None] & np.isfinite(result.shown_intervals)).any():
        yield (
            "Intervals of what is not identifiable are bounds: of a target about as heavy and as "
            "large as the spacecraft (1 σ)."
        )


def _of_logs(result: "Identification") -> Iterator[str]:
    """Yield the lines about the separate estimates of logs and prior."""
    width = max(map(len, result.logs))
    own = [source.request.sensors for source in result.sources]
    sensors = dict(zip(result.logs, own)) if len(set(own)) > 1 else {}
    yield f"  The sources {agreement_words(result)}. Each on its own:"
    for name, part in result.logs.items():
        half = (part.intervals[0, 1] - part.intervals[0, 0]) / 2
        mass = "m not identifiable"
        if np.isfinite(half):
            mass = f"m = {with_half_width(part.parameters[0], half)} kg"
        yield (
            f"      {name:{width}}  rank {part.rank:2}  {part.sample_count:7} samples  "
            f"{agreement_words(part):18}  {mass}"
            + (f", sensors {sensors[name]}" if name in sensors else "")
        )


def agreement_words(result: "Identification") -> str:
    """Return whether an estimate agrees with others, or its parts with one another, in words."""
    check = result.check(AGREEMENT)
    if check is None or check.statistic is None or check.limit is None:
        return "have nothing in common" if result.logs else "nothing to compare"
    verb = "agree" if check.passed else "differ"
    if result.logs:
        return f"{verb} (χ² {check.statistic:.3g}; the check fails above {check.limit:.3g})"
    return f"{verb}s (χ² {check.statistic:.3g})"


def consistency_words(result: "Identification") -> str:
    """Return whether a rigid body has the estimate, in words."""
    problems = "; ".join(result.inconsistencies)
    if result.consistent is not None and problems:
        return f"no rigid body has the estimate ({problems}); the nearest consistent one is given"
    if result.consistent is not None:
        return "the estimate is physically consistent"
    if problems:
        return f"no rigid body is near the estimate ({problems})"
    if result.consistent_intervals is None:
        return "unknown until all ten parameters are identifiable"
    return f"{'some' if result.is_consistent else 'no'} rigid body agrees with the estimate"


def gap(result: "Identification") -> list[str]:
    """Return sentences on what is not identifiable, why, and how to see it; empty if all is."""
    lines = _table_words(result) if result.is_planar else []
    if not result.is_complete:
        if result.not_identifiable:
            lines.append(f"Not identifiable: {result.not_identifiable}.")
        if not result.failures:  # else another motion would not help
            lines.append(
                "To see the rest, move the joints by larger angles and at higher rates, joints "
                "with different axes at different times, or log longer."
            )
    return lines


def _table_words(result: "Identification") -> list[str]:
    """Return sentences on what a motion in the plane of a table can show."""
    if result.normal_C is None:
        return ["A table carries the spacecraft; its joints rotate the target out of the plane."]
    others = "the others have no effect on a motion in the plane"
    axis = parallel_axis(result.normal_C)
    if axis >= 0:
        m, *c = (PARAMETER_NAMES[k] for k in range(4) if k != axis + 1)
        moment = PARAMETER_NAMES[4 + axis]
        return [f"On a table, {m}, {', '.join(c)} and {moment} are identifiable; {others}."]
    return [
        f"On a table, four numbers are identifiable, here oblique to C's axes; {others}.",
        "A capture frame with an axis along the table's normal shows them.",
    ]
