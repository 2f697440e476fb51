"""The rows of one block, compressed to a triangle: what its samples and its joints tell."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion_model import Trajectory
from cpid_drake.estimation.spectrum import Whitening
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
        whitening: of its residuals, by sensor.
        samples: (m, n + 1) the rows of its samples alone; None if they are not kept.

    """

    T: Array
    order: NDArray[np.intp]
    gone: NDArray[np.intp]
    end: Array
    whitening: Mapping[str, Whitening]
    samples: Array | None

    @classmethod
    def of(
        cls,
        part: BlockModel,
        trajectory: Trajectory,
        by_psi: Array,
        rest: Mapping[str, Array],
        whitening: Mapping[str, Whitening],
    ) -> "BlockRows":
        """Return the rows of a block.

        Args:
            part, trajectory: its prediction.
            by_psi: see `Rolled`.
            rest: (M, d) residuals in units of the declared σ, by sensor.
            whitening: of each sensor.

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
        rows[:, :-1], first = J[:, order], 0
        for name, each in rest.items():
            own = rows[first : first + each.size]
            own[:, -1] = each.ravel()
            own[:] = whitening[name](own.reshape(*each.shape, -1)).reshape(own.shape)
            first += each.size
        T = updated_information(part.joint_triangle(order), rows)
        return cls(T, order, gone, end, whitening, rows)

    def whitened(
        self, part: BlockModel, rest: Mapping[str, Array], whitening: Mapping[str, Whitening]
    ) -> "BlockRows | None":
        """Return the rows, whitened otherwise; None if no samples are kept."""
        changed = [n for n, each in whitening.items() if not each.is_same(self.whitening[n])]
        if not changed:
            return self
        if self.samples is None:
            return None
        rows, first = self.samples.copy(order="F"), 0
        for name, each in rest.items():
            own = rows[first : first + each.size]
            if name in changed:
                before = self.whitening[name].undone(own.reshape(*each.shape, -1))
                own[:] = whitening[name](before).reshape(own.shape)
            first += each.size
        T = updated_information(part.joint_triangle(self.order), rows)
        return replace(self, T=T, whitening=whitening, samples=rows)
