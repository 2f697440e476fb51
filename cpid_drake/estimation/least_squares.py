"""Least squares, with a measure of how well the data determine each unknown.

Any number of rows [A | b] in n unknowns is summarized by one upper triangular matrix
(n + 1, n + 1), the R factor of their QR decomposition:

    [R  z]      R x = z    the equations compressed to n rows,
    [0  ρ]      ρ²         the residual sum of squares at their solution.

New rows need one QR decomposition of this triangle with them below it. The method propagates no
covariance, which could lose its symmetry or definiteness. Source: Bierman 1977,
Factorization Methods for Discrete Sequential Estimation, ch. IV.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.special import chdtri, fdtri, ndtri, stdtrit

from cpid_drake.array import Array

DEFAULT_RANK_TOLERANCE = 1e-9
"""Singular values of column-scaled rows are treated as zero below this share of the largest one.

If a simulation conserves momentum to 1e-10 of its size, the singular values of unidentifiable
directions are below this tolerance. Noisy rows nearly always have full rank: use the covariance
instead.
"""


FAR = 4.0
"""Rows that are off by more σ weigh less; see `loss_weight`."""

KNOWN = 1 / 3
"""Largest σ of what is known, as a share of its plausible size.

The samples reduce the variance of a size at least tenfold.
"""


INTEGRATION = 1e-5
"""Residuals below this share of the momentum contradict nothing: integration leaves as much."""

ROUNDING = 1e-8
"""Least size of the errors of rows, as a share of the rows: less is rounding."""


_PANEL = 16  # columns that are eliminated together: the fastest


IMPROBABLE = 1e-4
"""Probability of what the data show, if all is as assumed, below which the assumption is wrong."""


def improbable(count: float, freedom: int | None = None) -> float:
    """Return the χ² of `count` entries that the true ones exceed with probability `IMPROBABLE`.

    Degrees of freedom of the residuals are given if only these show the noise: it is then that of
    an F distribution.
    """
    if freedom is None:
        return float(chdtri(count, IMPROBABLE))
    return count * float(fdtri(count, freedom, 1 - IMPROBABLE))


def updated_information(information: Array, augmented_rows: Array) -> Array:
    """Return the square-root information (n + 1, n + 1) after adding the rows [A | b] (M, n + 1).

    That of no rows is zero.
    Rows are not checked: a row that is not finite makes the result not finite.
    """
    n = min(_PANEL, len(information))
    updated, _, _, _ = lapack.dtpqrt(0, n, information, augmented_rows)
    return np.asarray(updated)


def sum_of_triangles(some: Array, other: Array) -> Array:
    """Return the triangle (n, n) of the rows of two upper triangles."""
    n = min(_PANEL, len(some))
    return np.asarray(lapack.dtpqrt(len(some), n, some, other)[0])


def triangle(rows: Array) -> Array:
    """Return R (n, n) of the QR decomposition of rows (M, n); M may be smaller than n.

    Rows that weigh much more than others come first: below them, others would be rounded to theirs
    (Cox and Higham 1998).
    """
    m, n = rows.shape
    if not m:
        return np.zeros((n, n))
    work = int(lapack.dgeqrf_lwork(m, n)[0])
    R = np.where(_upper(min(m, n), n), lapack.dgeqrf(rows, lwork=work)[0][:n], 0.0)
    return R if m >= n else np.vstack([R, np.zeros((n - m, n))])


def triangles(rows: Array) -> Array:
    """Return those (..., n, n) of many matrices (..., M, n); see `triangle`."""
    m, n = rows.shape[-2:]
    if m < n:
        rows = np.concatenate([rows, np.zeros((*rows.shape[:-2], n - m, n))], axis=-2)
    factors, _ = np.linalg.qr(rows, mode="raw")  # mode "r" takes twice as long for small matrices
    return np.where(_upper(n, n), np.swapaxes(factors, -1, -2)[..., :n, :], 0.0)


@lru_cache(maxsize=64)
def _upper(m: int, n: int) -> NDArray[np.bool_]:
    """Return the entries (m, n) of an upper triangle."""
    return np.triu(np.ones((m, n), dtype=bool))


def residual_variance(squares: float, size: float, row_count: int, rank: int) -> float:
    """Return the variance of the error of a row that the residuals of rows of equal noise show.

    It is the mean square of the residuals. Residuals below `INTEGRATION` are errors of integration,
    which are alike in all samples and do not cancel: of these it is the sum of squares. The errors
    of the unknowns are then no larger than their σ, if rows hide as much as they show.

    Args:
        squares: sum of squares of the residuals.
        size: sum of squares of the rows' right-hand sides.
        row_count: number of the rows that are not zero.
        rank: number of combinations of unknowns that they determine.

    Returns:
        The variance; NaN without degrees of freedom.

    """
    freedom = row_count - rank
    if freedom < 1:
        return np.nan
    mean = max(squares, ROUNDING**2 * size) / freedom
    return mean * row_count if squares <= INTEGRATION**2 * size else mean


def describe_unidentifiable(directions: Array, names: Sequence[str]) -> str:
    """Return the unidentifiable directions in words; empty when there are none.

    Unknowns with a share below 0.1 in these directions are described as weakly affected.

    Args:
        directions: (k, n) orthonormal directions, in column-scaled unknowns.
        names: the n unknowns.

    """
    if len(directions) == 0:
        return ""
    open_share = np.linalg.norm(directions, axis=0)
    strongly = [name for name, part in zip(names, open_share, strict=True) if part > 0.1]
    weakly = [name for name, part in zip(names, open_share, strict=True) if 1e-6 < part <= 0.1]
    noun = "combination" if len(directions) == 1 else "combinations"
    text = f"{len(directions)} {noun} of {', '.join(strongly)} with the motion so far"
    return text + (f"; {', '.join(weakly)} weakly affected" if weakly else "")


def loss_weight(size: Array) -> Array:
    """Return the factor of a row that is off by `size` σ; rows that are far off weigh less.

    With c = `FAR` it is min(1, (c/|r|)²), that of the loss r² up to c and 2c² − c⁴/r² beyond it:
    no row, however far off, adds more than 2c² to χ². Source: Hampel et al. 1986, Robust
    Statistics, ch. 2.6 (redescending M-estimates).
    """
    return np.asarray(np.minimum(1.0, FAR / np.maximum(np.abs(size), 1e-12)) ** 2)


def quantile_95(degrees_of_freedom: int | None = None) -> float:
    """Return half the width of a two-sided 95 % interval, in standard deviations.

    Args:
        degrees_of_freedom: degrees of freedom of the residuals from which the standard deviation is
            estimated (Student's t distribution); None or 0 if it is known (normal distribution).

    """
    if degrees_of_freedom is not None and degrees_of_freedom > 0:
        return float(stdtrit(degrees_of_freedom, 0.975))
    return float(ndtri(0.975))
