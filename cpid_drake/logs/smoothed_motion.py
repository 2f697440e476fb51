"""Smoothed motion with the covariance of its errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry


@dataclass(frozen=True, eq=False)
class ErrorBlock:
    """Effect of the errors of one spline's coefficients on the motion at N times.

    Attributes:
        columns: indices of the affected quantities of the motion (see `SmoothedMotion`).
        support: (N, m) indices of the coefficients on which the motion depends at each time.
        basis: (N, columns, m) derivatives of these quantities with respect to these coefficients.
        covariance: (n, n) covariance of all coefficients.

    """

    columns: NDArray[np.intp]
    support: NDArray[np.intp]
    basis: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothedMotion:
    """Motion at N common times, and its errors.

    The quantities with errors are, in order: attitude (3, right perturbation, in B), angular
    velocity (3, in B), position (3) and velocity (3) in W, joint positions (J), joint rates (J).

    Attributes:
        telemetry: the motion.
        errors: independent parts of its error.
        gyro_bias: (3,) estimated gyro bias, in B [rad/s].

    """

    telemetry: Telemetry
    errors: tuple[ErrorBlock, ...]
    gyro_bias: NDArray[np.float64]

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariance (N, n, n) of the quantities at each time."""
        N, n = len(self.telemetry), 12 + 2 * len(self.telemetry.joint_names)
        result = np.zeros((N, n, n))
        for block in self.errors:
            covariance = block.covariance[block.support[:, :, None], block.support[:, None]]
            part = block.basis @ covariance @ np.swapaxes(block.basis, -1, -2)
            result[:, block.columns[:, None], block.columns] += part
        return result
