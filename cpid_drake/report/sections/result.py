"""The section with the ten parameters."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.identification.description import decimals, shown_interval
from cpid_drake.identification.result_files import IdentificationResult
from cpid_drake.report.figures import ellipsoid_pictures
from cpid_drake.report.page import Cell, Section, Table, value_cell

_KEYS = ("mass", *(f"com.{i}" for i in range(3)), *(f"inertia.{i}" for i in range(6)))


def result_section(result: IdentificationResult, truth: InertialParameters | None) -> Section:
    """Return the section with the estimate, its 95 % intervals and, if it is known, the truth."""
    tables = [_parameters(result, truth)]
    if result.principal_moments is not None and result.principal_axes is not None:
        tables.append(_principal(result.principal_moments, result.principal_axes))
    feasible = result.target
    return Section(
        "Result",
        texts=[_summary(result)],
        warnings=[f"Not trustworthy: {doubt}." for doubt in result.doubts],
        tables=tables,
        pictures_title="Solid ellipsoid of the same mass and inertia, seen along three axes",
        # A body of zero mass has no ellipsoid.
        pictures=ellipsoid_pictures(feasible, truth) if feasible and feasible.mass > 0 else (),
    )


def _summary(result: IdentificationResult) -> str:
    if result.feasible is None and result.infeasibilities:
        return f"No rigid body is near the estimate ({'; '.join(result.infeasibilities)})."
    if result.feasible is None:
        known = int(np.isfinite(result.parameters).sum())
        return f"The log determines {known} of the ten parameters, but not the others."
    if result.infeasibilities:
        return (
            f"The estimate is physically inconsistent ({'; '.join(result.infeasibilities)}). Use "
            "the nearest consistent values."
        )
    return "All ten parameters are known, and they are physically consistent."


def _parameters(result: IdentificationResult, truth: InertialParameters | None) -> Table:
    note = (
        f"m: mass. c: centre of mass, from the origin of {result.spacecraft.capture_frame}, in its "
        "axes. I: inertia about the centre of mass, in the same axes; Ixy = −∫xy dm. ± 95 %: "
        "half-width of the 95 % interval. Consistent: the nearest values of a rigid body."
    )
    heads = ["", "estimate", "± 95 %", "consistent", "unit"]
    if result.bodies is not None:
        heads.insert(4, "rigid bodies")
        note += (
            " Rigid bodies: the part of the 95 % interval that a rigid body can have; of what is "
            "not known, its extreme values over all rigid bodies no part of which is farther than "
            f"{result.bodies.size:.2g} m from C."
        )
    if truth is not None:
        heads += ["truth", "error", "error / σ"]
        note += " Error: estimate minus truth. σ: standard deviation of the estimate."
    sigma, pairs = np.sqrt(np.diag(result.covariance)), result.interval_95
    half_widths = quantile_95() * sigma if pairs is None else (pairs[:, 1] - pairs[:, 0]) / 2
    true = None if truth is None else truth.to_vector()
    consistent = None if result.target is None else result.target.to_vector()
    rows = []
    for i, (name, key) in enumerate(zip(PARAMETER_NAMES, _KEYS)):
        value, half = result.parameters[i], half_widths[i]
        if result.bodies is not None and not result.bodies.possible:
            half = np.nan  # no rigid body agrees with the estimate
        places = decimals(2 * half)
        spread = f"{half:.{places}f}" if half >= 0.5 * 10.0**-places else f"{half:.1e}"
        row: list[Cell | str] = [name, value_cell(value, key, places, "not known")]
        if pairs is None:
            row.append(Cell(spread if np.isfinite(half) else ""))
        else:
            ends = [float(end) if np.isfinite(end) else None for end in pairs[i]]
            row.append(Cell(spread if np.isfinite(half) else "", ends, f"interval_95.{i}"))
        row += [
            "" if consistent is None else value_cell(consistent[i], f"feasible.{key}", places),
            *([] if result.bodies is None else [_possible(result, i)]),
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


def _possible(result: IdentificationResult, place: int) -> Cell:
    """Return the cell with what a rigid body can have of a parameter."""
    low, high = shown_interval(result, place)
    if np.isnan(low) and np.isnan(high):
        return Cell("")
    places = decimals(high - low)
    ends = [f"{end:.{places}f}" if np.isfinite(end) else "?" for end in (low, high)]
    return Cell(" to ".join(ends))


def _principal(moments: NDArray[np.float64], axes: NDArray[np.float64]) -> Table:
    rows = [
        [
            Cell(f"{moments[k]:.6g}", float(moments[k]), f"principal_moments.{k}"),
            *(
                Cell(f"{axes[i, k]:+.4f}", float(axes[i, k]), f"principal_axes.{i}.{k}")
                for i in range(3)
            ),
        ]
        for k in range(3)
    ]
    heads = ["moment [kg·m²]", "axis x", "axis y", "axis z"]
    return Table(heads, rows, "Principal moments and axes of the consistent values")
