"""Errors of ten parameters relative to their scale."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import parameter_scale


def error_scale(truth: InertialParameters) -> NDArray[np.float64]:
    """Return the scale (10,) of the errors: m, |c| for c, the trace of I for I."""
    return parameter_scale(truth.to_vector(), float(np.linalg.norm(truth.p_CTcm_C)))


def parameter_errors(
    parameters: NDArray[np.float64], truth: InertialParameters
) -> NDArray[np.float64]:
    """Return (10,) errors (π minus truth), relative to m, |c| and the trace of I."""
    return (parameters - truth.to_vector()) / error_scale(truth)


def max_relative_error(parameters: NDArray[np.float64], truth: InertialParameters) -> float:
    """Return the largest magnitude of `parameter_errors`; NaN if an entry is NaN."""
    return float(np.abs(parameter_errors(parameters, truth)).max())
