"""The rows of one block, compressed to a triangle: what its samples and its joints tell."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion import Trajectory
from cpid_drake.estimation.unknowns import PSI


@dataclass(frozen=True, eq=False)
class BlockRows:
    """All rows of a block, linear about the values of its prediction.

    The columns are first those of its start (12), then the g that end with the block, the joints at
    its end, and what outlives it.

    Attributes:
        T: (n + 1, n + 1) triangle of [A | b], with columns `order`.
        order: (n,) the columns of the block's model.
        gone: (g,) those that end with the block, but for its start.
        end: (12, n) how its end depends on the columns of the block's model.
        scale: (m,) factors of its residuals.
        samples: (m, n + 1) the rows of its samples alone; None if they are not kept.

    """

    T: NDArray[np.float64]
    order: NDArray[np.intp]
    gone: NDArray[np.intp]
    end: NDArray[np.float64]
    scale: NDArray[np.float64]
    samples: NDArray[np.float64] | None

    @classmethod
    def of(
        cls,
        part: BlockModel,
        trajectory: Trajectory,
        by_psi: NDArray[np.float64],
        rest: NDArray[np.float64],
        scale: NDArray[np.float64],
    ) -> "BlockRows":
        """Return the rows of a block.

        Args:
            part, trajectory: its prediction.
            by_psi: see `Rolled`.
            rest: (m,) residuals in units of the declared σ.
            scale: (m,) their factors.

        """
        J, end = part.jacobian(trajectory)
        psi = part.columns[PSI]
        J[:, psi], end[:, psi] = J[:, psi] @ by_psi, end[:, psi] @ by_psi
        start, ends = np.split(part.at_end, [12])
        ends_here = np.ones(part.kept[0], dtype=bool)
        ends_here[part.at_end] = False
        gone = np.flatnonzero(ends_here)
        order = np.concatenate([start, gone, ends, part.kept])
        rows = np.empty((len(order) + 1, len(J))).T
        np.multiply(J.T[order], scale, out=rows.T[:-1])
        np.multiply(rest, scale, out=rows.T[-1])
        T = updated_information(part.joint_triangle(order), rows)
        return cls(T, order, gone, end, scale, rows)

    def scaled(self, part: BlockModel, scale: NDArray[np.float64]) -> "BlockRows | None":
        """Return the rows with other factors (m,) of the residuals; None if no samples are kept."""
        if np.array_equal(self.scale, scale):
            return self
        if self.samples is None:
            return None
        rows = (self.samples.T * (scale / self.scale)).T
        T = updated_information(part.joint_triangle(self.order), rows)
        return replace(self, T=T, scale=scale, samples=rows)
