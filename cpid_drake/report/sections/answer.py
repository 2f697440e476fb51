"""The section with the ten parameters."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.identification.description import decimals
from cpid_drake.report.figures import (
    Picture,
    ellipsoid_pictures,
)
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Cell, Section, Table
from cpid_drake.report.sections.cells import PARAMETER_KEYS, value_cell


@dataclass(frozen=True, eq=False)
class Answer(Section):
    """The ten parameters."""

    findings: Findings
    title: ClassVar[str] = "The answer"
    template: ClassVar[str] = "answer.html.j2"

    @property
    def verdict(self) -> str:
        """The answer in a sentence."""
        result = self.findings.result
        if result.feasible is None:
            known = int(np.isfinite(result.parameters).sum())
            return f"The log determines {known} of the ten parameters; the others stay open."
        if result.infeasibilities:
            return (
                f"No rigid body has the estimate as it is ({'; '.join(result.infeasibilities)}): "
                "use the nearest physically consistent values."
            )
        return "All ten parameters are known, and they are physically consistent."

    @property
    def meaning(self) -> str:
        """What the rows mean."""
        frame = self.findings.result.spacecraft.capture_frame
        text = (
            f"m: mass. c: centre of mass, from the origin of {frame}, in its axes. I: inertia "
            "about the centre of mass, in the same axes; Ixy = −∫xy dm. ± is half of the 95 % "
            "interval. Consistent: the nearest values that a rigid body can have."
        )
        if self.findings.truth is not None:
            text += " Error: estimate minus truth, and the same in standard deviations."
        return text

    @property
    def parameters(self) -> Table:
        """The ten parameters."""
        result, truth = self.findings.result, self.findings.truth
        heads = ["", "estimate", "± 95 %", "consistent", "unit"]
        heads += [] if truth is None else ["truth", "error", "error / σ"]
        sigma = np.sqrt(np.diag(result.covariance))
        pairs = result.intervals
        half_widths = quantile_95() * sigma if pairs is None else (pairs[:, 1] - pairs[:, 0]) / 2
        true = np.full(10, np.nan) if truth is None else truth.to_vector()
        consistent = np.full(10, np.nan) if result.feasible is None else result.feasible.to_vector()
        rows = []
        for i, (name, key) in enumerate(zip(PARAMETER_NAMES, PARAMETER_KEYS)):
            value, half = result.parameters[i], half_widths[i]
            digits = decimals(2 * half)
            spread = f"{half:.{digits}f}" if half >= 0.5 * 10.0**-digits else f"{half:.1e}"
            spread = spread if np.isfinite(half) else ""
            row: list[Cell | str] = [
                name,
                value_cell(value, key, digits, "not known"),
                Cell(spread)
                if pairs is None
                else Cell(spread, _plain(pairs[i]), f"interval_95.{i}"),
                ""
                if result.feasible is None
                else value_cell(consistent[i], f"feasible.{key}", digits),
                PARAMETER_UNITS[i],
            ]
            if truth is not None:
                error = value - true[i]
                row += [
                    value_cell(true[i], key, digits, data="truth"),
                    Cell(f"{error:+.2g}" if np.isfinite(error) else ""),
                    Cell(f"{error / sigma[i]:+.1f}" if np.isfinite(error / sigma[i]) else ""),
                ]
            rows.append(row)
        return Table(heads, rows)

    @property
    def principal(self) -> Table | None:
        """Principal moments and axes."""
        result = self.findings.result
        moments, axes = result.principal_moments, result.principal_axes
        if moments is None or axes is None:
            return None
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
        return Table(["moment [kg·m²]", "axis x", "axis y", "axis z"], rows)

    @property
    def pictures(self) -> list[Picture]:
        """The ellipsoid, if a rigid body is known that has a mass."""
        feasible = self.findings.result.feasible
        if feasible is None or not feasible.mass > 0:
            return []
        return ellipsoid_pictures(feasible, self.findings.truth)


def _plain(pair: NDArray[np.float64]) -> list[float | None]:
    """Return an interval as the result file has it."""
    return [float(end) if np.isfinite(end) else None for end in pair]
