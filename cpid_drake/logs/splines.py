"""Regression splines: least squares in a B-spline basis, with as many pieces as Akaike says.

Each piece holds about the same number of samples.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import splu

from cpid_drake.array import Array
from cpid_drake.logs.log import Samples

PIECES = tuple(round(2 ** (k / 2)) for k in range(2, 29))
"""Numbers of pieces that are tried; each is the one before times about √2."""

DEGREE = 5
"""Degree of the splines: their second derivatives are smooth."""

GAP = 3.0
"""Usual steps of samples above which a step is a gap, which no spline bridges."""

Fit = TypeVar("Fit")


def regression_spline(samples: Samples, first: int = 0) -> BSpline:
    """Return the spline through samples whose noise is not known; it is kept for the same again.

    Args:
        samples: (N, width).
        first: see `best`.

    """
    return _regression_spline(samples.time.tobytes(), samples.value.tobytes(), first)


@lru_cache(maxsize=32)
def _regression_spline(times: bytes, values: bytes, first: int) -> BSpline:
    """Return the spline through values (N, width) at times (N,)."""
    time = np.frombuffer(times)
    value = np.frombuffer(values).reshape(len(time), -1)
    tiny = (1e-12 * np.abs(value).max(axis=0, initial=0.0)) ** 2 + 1e-300

    def fit(pieces: int) -> tuple[float, BSpline]:
        knots = knots_of(time, pieces)
        if not value.shape[1]:  # a spacecraft without joints
            return 0.0, BSpline(knots, np.zeros((len(knots) - DEGREE - 1, 0)), DEGREE)
        spline = make_lsq_spline(time, value, knots, DEGREE)
        variance = np.mean((value - spline(time)) ** 2, axis=0)
        # −2 log(likelihood) of white noise of this variance: N log σ²
        return len(value) * float(np.log(variance + tiny).sum()), spline

    return best(fit, len(value), value.shape[1], first=first)[1]


def in_gap(time: Array, at: Array) -> NDArray[np.bool_]:
    """Return whether some times are between samples that are farther apart than most."""
    steps = np.diff(time)
    return np.asarray(steps > GAP * np.median(steps))[np.searchsorted(time[1:-1], at, side="right")]


def knots_of(times: Array, pieces: int) -> Array:
    """Return knots of pieces with about the same number of sample times (N,)."""
    breaks = np.quantile(times, np.linspace(0.0, 1.0, pieces + 1))
    return np.concatenate([DEGREE * [breaks[0]], breaks, DEGREE * [breaks[-1]]])


def basis(knots: Array, times: Array, derivative: int = 0) -> csr_array:
    """Return the values (N, n) of all basis functions, or of their derivatives, at times (N,)."""
    functions = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
    return csr_array(functions(times, nu=derivative))


def best(
    fit: Callable[[int], tuple[float, Fit]],
    samples: int,
    width: float,
    *,
    first: int = 0,
    finer: bool = False,
) -> tuple[int, Fit]:
    """Return the number of pieces and the fit of the smallest χ² + 2 parameters (Akaike 1974).

    Args:
        fit: returns χ² and the fit with a number of pieces.
        samples: number of samples.
        width: number of parameters of one function.
        first: smallest number of pieces to try.
        finer: return the next larger fit. It has less misfit, which the covariance does not
            include, and more noise, which the covariance includes.

    """
    fits: list[tuple[float, float, int, Fit]] = []
    for pieces in PIECES:
        if pieces < first and pieces < PIECES[-1]:
            continue
        if fits and pieces + DEGREE > samples / 2:
            break
        chi, fitted = fit(pieces)
        # AIC = χ² + 2 k, with k coefficients of all functions
        fits.append((chi + 2 * width * (pieces + DEGREE), chi, pieces, fitted))
        best = min(range(len(fits)), key=lambda k: fits[k][0])
        if len(fits) > best + 3:
            break
    # Knots of different fits are not nested, so a larger fit can be worse.
    better = [each for each in fits[best + 1 :] if each[1] < fits[best][1]]
    chosen = better[0] if finer and better else fits[best]
    return chosen[2], chosen[3]


def solve(A: csr_array, b: Array) -> tuple[Array, float]:
    """Return the solution (n, channels) of rows in units of σ by normal equations, and χ²."""
    normal = (A.T @ A).tocsc()
    scale = normal.diagonal().max()
    try:  # without another order, the factors of a banded matrix have its bandwidth
        factors = splu(
            (normal + 1e-13 * scale * eye_array(normal.shape[0])).tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
        )
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from error
    x = factors.solve(A.T @ b)
    return x, float(np.sum((A @ x - b) ** 2))


def covariance(A: csr_array, chi: float, numbers: float) -> Array:
    """Return the covariance of a solution, with the misfit if χ² is larger than the noise says."""
    # s² (AᵀA)⁻¹ with s² = max(χ² / (numbers), 1)
    normal = (A.T @ A).toarray()
    normal += 1e-13 * normal.diagonal().max() * np.eye(len(normal))
    covariance = cho_solve(cho_factor(normal), np.eye(len(normal)))
    return np.asarray(max(chi / max(numbers, 1.0), 1.0) * covariance)
