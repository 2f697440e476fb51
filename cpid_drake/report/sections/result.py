"""The section with the ten parameters."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.description import decimals, principal_axes
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import ellipsoid_pictures
from cpid_drake.report.page import Cell, Section, Table, value_cell

TRUTH_KEYS = ("mass", *(f"com.{i}" for i in range(3)), *(f"inertia.{i}" for i in range(6)))
"""Places of the ten parameters in the file of a true target."""


def result_section(result: Identification, truth: InertialParameters | None) -> Section:
    """Return the section with the estimate, its 95 % intervals and, if it is known, the truth."""
    tables = [_parameters(result, truth)]
    nearest = result.consistent
    if nearest is not None:
        tables.append(_principal(*principal_axes(nearest)))
    return Section(
        "Result",
        texts=[_summary(result)],
        warnings=[f"Failed check: {failure}." for failure in result.failures],
        tables=tables,
        pictures_title="Solid ellipsoid of the same mass and inertia, seen along three axes",
        # A body of zero mass has no ellipsoid.
        pictures=ellipsoid_pictures(nearest, truth) if nearest and nearest.mass > 0 else (),
    )


def _summary(result: Identification) -> str:
    if result.consistent is None and result.infeasibilities:
        return f"No rigid body is near the estimate ({'; '.join(result.infeasibilities)})."
    if result.consistent is None:
        known = int(np.isfinite(result.parameters).sum())
        return f"The log determines {known} of the ten parameters, but not the others."
    if result.infeasibilities:
        return (
            f"The estimate is physically inconsistent ({'; '.join(result.infeasibilities)}). Use "
            "the nearest consistent values."
        )
    return "All ten parameters are known, and they are physically consistent."


def _parameters(result: Identification, truth: InertialParameters | None) -> Table:
    frame = "C" if result.spacecraft is None else result.spacecraft.capture_frame
    note = (
        f"m: mass. c: centre of mass, from the origin of {frame}, in its "
        "axes. I: inertia about the centre of mass, in the same axes; Ixy = −∫xy dm. ± 95 %: "
        "half-width of the 95 % interval. Consistent: the nearest values of a rigid body."
    )
    heads = ["", "estimate", "± 95 %", "consistent", "unit"]
    if result.consistent_intervals is not None:
        heads.insert(4, "rigid bodies")
        note += (
            " Rigid bodies: the part of the 95 % interval that a rigid body can have; of what is "
            "not known, its extreme values over all rigid bodies no part of which is farther than "
            f"{result.size:.2g} m from C."
        )
    if truth is not None:
        heads += ["truth", "error", "error / σ"]
        note += " Error: estimate minus truth. σ: standard deviation of the estimate."
    sigma, pairs = np.sqrt(np.diag(result.covariance)), result.intervals
    half_widths = (pairs[:, 1] - pairs[:, 0]) / 2
    true = None if truth is None else truth.to_vector()
    is_known = result.consistent is not None
    rows = []
    for i, (name, key) in enumerate(zip(PARAMETER_NAMES, TRUTH_KEYS)):
        value, half = result.parameters[i], half_widths[i]
        if not result.is_possible:
            half = np.nan  # no rigid body agrees with the estimate
        places = decimals(2 * half)
        spread = f"{half:.{places}f}" if half >= 0.5 * 10.0**-places else f"{half:.1e}"
        row: list[Cell | str] = [name, value_cell(value, f"parameters.{i}", places, "not known")]
        ends = [float(end) if np.isfinite(end) else None for end in pairs[i]]
        row.append(Cell(spread if np.isfinite(half) else "", ends, f"intervals.{i}"))
        row += [
            value_cell(result.nearest[i], f"nearest.{i}", places)
            if is_known and result.nearest is not None
            else "",
            *([] if result.consistent_intervals is None else [_possible(result, i)]),
            PARAMETER_UNITS[i],
        ]
        if true is not None:
            error = value - true[i]
            row += [
                value_cell(true[i], key, places, data="truth"),
                Cell(f"{error:+.2g}" if np.isfinite(error) else ""),
                Cell(f"{error / sigma[i]:+z.1f}" if np.isfinite(error / sigma[i]) else ""),
            ]
        rows.append(row)
    return Table(heads, rows, note=note)


def _possible(result: Identification, place: int) -> Cell:
    """Return the cell with what a rigid body can have of a parameter."""
    low, high = result.shown_intervals[place]
    if np.isnan(low) and np.isnan(high):
        return Cell("")
    places = decimals(high - low)
    ends = [f"{end:.{places}f}" if np.isfinite(end) else "?" for end in (low, high)]
    return Cell(" to ".join(ends))


def _principal(moments: NDArray[np.float64], axes: NDArray[np.float64]) -> Table:
    rows = [
        [
            Cell(f"{moments[k]:.6g}"),
            *(Cell(f"{axes[i, k]:+.4f}") for i in range(3)),
        ]
        for k in range(3)
    ]
    heads = ["moment [kg·m²]", "axis x", "axis y", "axis z"]
    return Table(heads, rows, "Principal moments and axes of the consistent values")
