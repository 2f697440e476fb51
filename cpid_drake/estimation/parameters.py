"""The ten reported parameters that a solution determines."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.estimation.gaussian import LeastSquaresSolution


def determined_parameters(
    form: Parameterization, solution: LeastSquaresSolution, quantile: float
) -> tuple[Array, Array, Array]:
    """Return π (10,), its covariance (10, 10) and the interval (2,) of the mass.

    What is not identifiable is NaN: the mass if its interval passes its pole, and c and I if it
    contains zero.

    Args:
        form: the parameterization of the ten unknowns.
        solution: their estimate.
        quantile: half the width of an interval, in σ.

    """
    x, root = solution.estimate, solution.root if solution.has_noise else solution.root * np.nan
    if solution.is_open.any():  # a known parameter depends only on unknowns that are determined
        root = np.where(solution.is_open[:, None], 0.0, root)
    covariance = form.covariance(x, root)
    parameters, reach = form.to_parameters(x), quantile * float(root[0] @ root[0]) ** 0.5
    low, high = sorted(form.mass(float(x[0]) + side) for side in (-reach, reach))
    if not low <= parameters[0] <= high:
        low = high = np.nan
    is_open = ~np.isfinite(parameters)
    is_open[0] |= bool(np.isnan(low) and np.isfinite(covariance[0, 0]))
    is_open[1:] |= low <= 0.0 <= high
    if is_open.any():
        parameters[is_open] = covariance[is_open, :] = covariance[:, is_open] = np.nan
    return parameters, covariance, np.array([low, high])
