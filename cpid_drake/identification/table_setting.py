"""What an identification on a table can show: four numbers of the target, in C."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.dynamics.plane import parallel_axis
from cpid_drake.input_files.validation import Numbers

PLACES = {0: (0, 2, 3, 4), 1: (0, 1, 3, 5), 2: (0, 1, 2, 6)}
"""Places in π of what can be known, by the number of C's axis that is the table's normal."""


@dataclass(frozen=True, eq=False)
class TableSetting:
    """The table that carries the spacecraft, as seen from the target.

    Attributes:
        normal_C: (3,) its normal in C; None if the joints turn C out of the plane, so that all
            ten parameters can act on the motion.

    """

    normal_C: Annotated[NDArray[np.float64], Numbers(3)] | None

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
        return [
            f"On a table, four numbers can be known, here oblique to C's axes; {others}.",
            "A capture frame with an axis along the table's normal shows them.",
        ]
