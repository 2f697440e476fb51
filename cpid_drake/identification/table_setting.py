"""What an identification on a table can show: four numbers of the target, in C."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.dynamics.plane import parallel_axis
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.input_files.validation import Numbers

PLACES = {0: (0, 2, 3, 4), 1: (0, 1, 3, 5), 2: (0, 1, 2, 6)}
"""Places in π of what can be known, by the number of C's axis that is the table's normal."""

MORE_MOTION = "move the joints by larger angles and at higher rates, or log longer"
"""The advice on a table if less is known than its motion can show."""


@dataclass(frozen=True, eq=False)
class TableSetting:
    """The table that carries the spacecraft, as seen from the target.

    Attributes:
        normal_C: (3,) its normal in C; None if the joints turn C out of the plane, so that all
            ten parameters can act on the motion.
        axes_C: (3, 3) unit vectors in C, as rows: two in the plane, and the normal. None if the
            normal is an axis of C, or as `normal_C`.
        values, covariance: (4,) and (4, 4) with `axes_C`: mass, centre of mass along the two
            vectors in the plane, and moment of inertia about the normal through it; NaN where not
            known.

    """

    normal_C: Annotated[NDArray[np.float64], Numbers(3)] | None
    axes_C: Annotated[NDArray[np.float64], Numbers(3, 3)] | None = None
    values: Annotated[NDArray[np.float64], Numbers(4, unknown=True)] | None = None
    covariance: Annotated[NDArray[np.float64], Numbers(4, 4, unknown=True)] | None = None

    @property
    def size(self) -> int:
        """Number of combinations of the unknowns that act on the motion."""
        return 10 if self.normal_C is None else 4

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that act on the motion; empty if they are combinations."""
        if self.normal_C is None:
            return PARAMETER_NAMES
        axis = parallel_axis(self.normal_C)
        return () if axis < 0 else tuple(PARAMETER_NAMES[k] for k in PLACES[axis])

    def sentences(self) -> list[str]:
        """Return sentences on what the motion in the plane can show."""
        if self.normal_C is None:
            return ["A table carries the spacecraft; its joints turn the target out of the plane."]
        others = "the others have no effect on a motion in the plane"
        if self.names:
            text = f"On a table, {', '.join(self.names[:3])} and {self.names[3]} can be known"
            return [f"{text}; {others}."]
        lines = [f"On a table, four numbers can be known, here oblique to C's axes; {others}."]
        if self.axes_C is None or self.values is None or self.covariance is None:
            return lines
        half = quantile_95() * np.sqrt(np.diag(self.covariance))
        what = ("centre of mass along", "centre of mass along", "moment of inertia about")
        for k, (kind, axis) in enumerate(zip(what, self.axes_C), start=1):
            direction = ", ".join(f"{entry + 0.0:.4g}" for entry in np.round(axis, 6))
            unit = PARAMETER_UNITS[1 if k < 3 else 6]
            known = np.isfinite(self.values[k])
            value = f"{self.values[k]:.5g} ± {half[k]:.2g} {unit}" if known else "not known"
            lines.append(f"{kind} ({direction}) in C: {value}".capitalize())
        return lines


def frame_of(normal_C: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R_CF (3, 3) of a frame F whose z axis is the table's normal."""
    first = np.cross(normal_C, np.eye(3)[np.abs(normal_C).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal_C, first), normal_C], axis=1)


def is_oblique(normal_C: NDArray[np.float64] | None) -> bool:
    """Return whether the table's normal is known in C and no axis of C."""
    return normal_C is not None and parallel_axis(normal_C) < 0
