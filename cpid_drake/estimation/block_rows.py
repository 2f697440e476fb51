"""The rows of one block, compressed to a triangle: what its samples and its joints tell."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.likelihood.model import SLOW, BlockModel
from cpid_drake.estimation.process import Innovations


@dataclass(frozen=True, eq=False)
class BlockRows:
    """All rows of a block, linear about the values of its prediction.

    The columns are first those of its start (12), then the g that end with the block, the joints
    and slow noise at its end, and what outlives it: those of `BlockModel.columns` in the order
    `order`. The link to the next block has its rows in `elimination.changed`.

    Attributes:
        T: (n + 1, n + 1) triangle of [A | b], with columns `order`.
        order: (n,) the columns of the block's model.
        gone: (g,) those that end with the block, but for its start.
        transition: (12, n) [E₀ | E] of its end x₁ = E₀ x₀ + E y, by the columns of its model.
        whiteners: what makes its residuals white, by sensor.
        slow: (2, s) present values of slow noise at both edges.
        samples: (m, n + 1) rows of its samples, then the links of slow noise; columns `order`.

    """

    T: Array
    order: NDArray[np.intp]
    gone: NDArray[np.intp]
    transition: Array
    whiteners: Mapping[str, Innovations]
    slow: Array
    samples: Array

    @classmethod
    def of(
        cls,
        block_model: BlockModel,
        jacobians: tuple[Array, Array],
        rest: Mapping[str, Array],
        whiteners: Mapping[str, Innovations],
        places: Mapping[str, slice],
        slow: Array,
    ) -> "BlockRows":
        """Return the rows of a block.

        Args:
            block_model: its model, with the columns of slow noise.
            jacobians: derivatives of samples and end without them.
            rest: (M, d) residuals in units of the declared σ, by sensor.
            whiteners: of each sensor with samples or slow noise.
            places: of sensors in `slow`.
            slow: (2, s) present values of slow noise at both edges.

        """
        J, end_jacobian = jacobians
        start, ends = np.split(block_model.at_end, [12])
        ends_here = np.ones(block_model.shared_start, dtype=bool)
        ends_here[block_model.at_end] = False
        gone = np.flatnonzero(ends_here)
        shared = np.arange(block_model.shared_start, block_model.width)
        order = np.concatenate([start, gone, ends, shared])
        at = np.argsort(order)
        own = block_model.without_slow
        transition = np.zeros((12, len(order)))
        transition[:, own] = end_jacobian
        rows = np.zeros((len(order) + 1, len(J) + block_model.slow)).T
        rows[: len(J), at[own]], first = J, 0
        edges = np.zeros((2, 0), np.intp)
        if block_model.slow:
            edges = at[block_model.columns[SLOW]].reshape(2, -1)
        for name, white in whiteners.items():
            each = rest.get(name, np.zeros((0, white.process.channels)))
            these = rows[first : first + each.size]
            these[:, -1] = each.ravel()
            z = white(these.reshape(*each.shape, len(order) + 1))
            if name in places:
                for i, j in enumerate(range(places[name].start, places[name].stop)):
                    z[:, i, edges[:, j]] -= white.edges
                z[:, :, -1] += white.edges @ slow[:, places[name]]
                rows[len(J) :][places[name]] = z[-1]
            these[:] = z[: len(each)].reshape(these.shape)
            first += each.size
        T = updated_information(block_model.joint_triangle(order), rows)
        return cls(T, order, gone, transition, whiteners, slow, rows)

    def is_for(self, whiteners: Mapping[str, Innovations], slow: Array) -> bool:
        """Return whether these are the rows with these whiteners."""
        return (
            whiteners.keys() == self.whiteners.keys()
            and all(each.is_same(self.whiteners[name]) for name, each in whiteners.items())
            and np.array_equal(slow, self.slow)
        )
