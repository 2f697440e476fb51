"""Fits that share a number of linearizations: the work of a step online has an end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpid_drake.estimation.fit import MOST_SWEEPS, Fit, fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError

TOO_MANY = "the fits need more linearizations than they may have"


@dataclass
class BoundedFits:
    """Makes fits that have a number of linearizations of blocks together.

    Attributes:
        left: how many are left.
        progress: see `fit`.

    """

    left: float = np.inf
    progress: Callable[[str], object] = lambda step: None

    def fit(
        self, model: Model, logs: Sequence[LogState], *, most: int = MOST_SWEEPS, **options: Any
    ) -> Fit:
        """Return a fit; see `fit`.

        Raises:
            InputError: no motion can be predicted, or it needs more linearizations than are left.

        """
        blocks = sum(len(log.blocks) for log in logs)
        possible = int(min(most, self.left // blocks))
        solved = fit(model, logs, progress=self.progress, most=possible, **options)
        self.left -= solved.sweeps * blocks
        if possible < most and not solved.converged:
            raise InputError(TOO_MANY)
        return solved
