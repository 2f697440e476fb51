"""The blocks before a log's first one: they are behind a window, and marginalized."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.model import jump_between
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState


@dataclass(frozen=True, eq=False)
class Past:
    """A Gaussian of what is at the start of a log's first block, and of all unknowns.

    Its rows are linear about the values at which each block was marginalized. So are the
    derivatives of all later blocks by target and hardware: what no motion identifies, such as where
    C is in the target, would else seem to be known, since derivatives at other values contradict
    each other. Source: Huang, Mourikis and Roumeliotis 2010 (first-estimates Jacobians).

    Attributes:
        gaussian: of attitude, p, L, v and joints, then of the table of unknowns.
        start: the base's state about which it is.
        joints: (ORDER, J) the joints about which it is.
        table: (n,) the values of the table about which it is.
        first: values of target and hardware at which derivatives are taken.
        shown: what blocks show of the noise, by sensor; see `Whitening.sums`.
        noise: sum of squares of whitened residuals and degrees of freedom, by sensor.

    """

    gaussian: Gaussian
    start: TrajectoryState
    joints: Array
    table: Array
    first: Mapping[str, Array]
    shown: Mapping[str, Array]
    noise: Mapping[str, Array]

    def about(self, start: TrajectoryState, joints: Array, table: Array) -> Gaussian:
        """Return the Gaussian about other values."""
        jump, turned = jump_between(self.start, start), (joints - self.joints).T.ravel()
        return self.gaussian.moved(np.concatenate([jump, turned, table - self.table]))
