"""Test for a change of the base's motion that is too weak to be seen in one block.

At some boundaries between blocks, a change δ of attitude, centre of mass, angular momentum and
velocity is assumed. It is not estimated, but its effect on everything after that boundary is
computed along with the solution, as additional columns. The rows that a block leaves over then say
how much χ² decreases if δ is free (generalized likelihood ratio, Willsky & Jones 1976). If noise
does not explain the decrease, δ is made free from that boundary on, without a second look at the
samples.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.estimation.square_root import triangle

CHANGED = ("attitude", "p_Wcm", "L", "v_Wcm")
"""The quantities that may have changed, three entries each."""

SIZE = 3 * len(CHANGED)

LONGEST = 6
"""Number of blocks after which an assumed change is given up."""

SPACING = 2
"""Number of blocks between two assumed changes."""


@dataclass(frozen=True, eq=False)
class Jump:
    """A change δ that is assumed at one boundary.

    Attributes:
        time: of the boundary [s].
        blocks: number of blocks since.
        columns: (n, 12) the effect of δ on the equations of what is known now.
        found: (b + 13, b + 13) triangle of the rows by the b errors of the known bodies and by δ,
            and their right-hand side, from all samples since.

    """

    time: float
    blocks: int
    columns: NDArray[np.float64]
    found: NDArray[np.float64]

    @classmethod
    def at(
        cls, time: float, root: NDArray[np.float64], places: dict[str, slice], bodies: int
    ) -> "Jump":
        """Return a change at the present: what is known holds for the quantities minus δ."""
        columns = -np.hstack([root[:, places[name]] for name in CHANGED])
        size = bodies + SIZE + 1
        return cls(time, 0, columns, np.zeros((size, size)))

    def after(self, columns: NDArray[np.float64], left: NDArray[np.float64]) -> "Jump":
        """Return the change after a block.

        Args:
            columns: (n, 12) its effect on the equations at the end of the block.
            left: rows (m, b + 13) that the block leaves over.

        """
        found = triangle(np.vstack([self.found, left]))
        return replace(self, blocks=self.blocks + 1, columns=columns, found=found)

    @property
    def gain(self) -> float:
        """Decrease of χ² if δ is free, with the known bodies' errors as unlikely as their prior."""
        bodies = len(self.found) - SIZE - 1
        rows = np.vstack([np.eye(bodies, len(self.found)), self.found])
        return float(np.sum(triangle(rows)[bodies:-1, -1] ** 2))

    def exceeds_noise(self, misfit: float, probability: float) -> bool:
        """Return whether noise alone has so large a gain with less than this probability."""
        return self.gain > misfit * chdtri(SIZE, probability)
