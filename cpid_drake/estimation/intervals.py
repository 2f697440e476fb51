"""The width of 95 % intervals, and whether an estimate is known well enough."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from cpid_drake.dynamics.parameterizations import parameter_scale


def quantile_95(degrees_of_freedom: int | None = None) -> float:
    """Return half the width of a two-sided 95 % interval, in standard deviations.

    Args:
        degrees_of_freedom: degrees of freedom of the residuals from which the standard deviation is
            estimated (Student's t distribution); None or 0 if it is known (normal distribution).

    """
    if degrees_of_freedom is not None and degrees_of_freedom > 0:
        return float(stdtrit(degrees_of_freedom, 0.975))
    return float(ndtri(0.975))


def is_within_tolerance(
    parameters: NDArray[np.float64], covariance: NDArray[np.float64], tolerance: float
) -> bool:
    """Return whether the σ of all ten parameters π are small enough.

    Args:
        parameters: (10,) π of a rigid body.
        covariance: (10, 10) its covariance; NaN where it is not known.
        tolerance: largest ratio of σ to the scale of the parameter, see
            `parameterizations.parameter_scale`.

    """
    sigma = np.sqrt(np.diag(covariance))
    return bool(np.all(sigma <= tolerance * parameter_scale(parameters)))
