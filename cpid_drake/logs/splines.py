"""Regression splines with known noise: joint motion from the samples of joint sensors.

The method is least squares in a B-spline basis. Each knot interval contains about the same number
of samples; Akaike's criterion chooses the number of intervals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_array, csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import splu

from cpid_drake.errors import InputError
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.sensors.sensors import JOINT_POSITIONS, JOINT_RATES, sensors_of
from cpid_drake.sensors.suite import SensorSuite

INTERVALS = (2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512)
"""Numbers of knot intervals that are tried."""

DerivativeSamples = tuple[Samples, int, float]
"""Samples of a function or of one of its derivatives, the order of the derivative, and σ."""


@dataclass(frozen=True, eq=False)
class Basis:
    """A B-spline basis: K functions of one degree, with K + degree + 1 knots [s]."""

    knots: NDArray[np.float64]
    degree: int

    @classmethod
    def through(cls, times: NDArray[np.float64], intervals: int, degree: int) -> "Basis":
        """Return a basis whose intervals contain about the same number of sample times (N,)."""
        breaks = np.quantile(times, np.linspace(0.0, 1.0, intervals + 1))
        knots = np.concatenate([degree * [breaks[0]], breaks, degree * [breaks[-1]]])
        return cls(knots, degree)

    def bridged(self) -> tuple["Basis", NDArray[np.float64]]:
        """Divide long intervals; return the basis and the midpoints of the new intervals [s].

        Gaps in the samples make long intervals.
        """
        breaks = np.unique(self.knots)
        usual = np.median(np.diff(breaks))
        new, middles = [], []
        for a, b in pairwise(breaks):
            count = round((b - a) / usual)
            if count > 1:
                pieces = np.linspace(a, b, count + 1)
                new.append(pieces[1:-1])
                middles.append((pieces[1:] + pieces[:-1]) / 2)
        return Basis(np.sort(np.concatenate([self.knots, *new])), self.degree), np.concatenate(
            [[], *middles]
        )

    @property
    def size(self) -> int:
        """Number of functions K."""
        return len(self.knots) - self.degree - 1

    def __call__(self, times: ArrayLike, derivative: int = 0) -> NDArray[np.float64]:
        """Return the basis functions, or their derivatives, at times (N,): (N, K)."""
        return BSpline(self.knots, np.eye(self.size), self.degree)(times, nu=derivative)

    def support(self, times: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the indices (N, degree + 1) of the functions that are not zero at times (N,)."""
        interval = np.searchsorted(self.knots, times, side="right") - 1
        first = np.clip(interval, self.degree, self.size - 1) - self.degree
        return first[:, None] + np.arange(self.degree + 1)

    def sparse(self, times: NDArray[np.float64], derivative: int = 0) -> csr_array:
        """Return the basis functions, or their derivatives, at times (N,) as a sparse (N, K)."""
        k = self.support(times)
        values = np.take_along_axis(self(times, derivative), k, axis=1)
        ends = np.arange(0, k.size + 1, k.shape[1])
        return csr_array((values.ravel(), k.ravel(), ends), shape=(len(times), self.size))


@dataclass(frozen=True, eq=False)
class SplineFit:
    """A spline that is fitted to samples: basis(t) @ coefficients.

    Attributes:
        basis: K functions.
        coefficients: (K, channels).
        covariance: (K, K) covariance of the coefficients of each channel.
        chi_squared: sum of squared residuals in units of σ.

    """

    basis: Basis
    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    chi_squared: float


Fit = TypeVar("Fit", bound=SplineFit)


@dataclass(frozen=True, eq=False)
class JointSpline(SplineFit):
    """A smoothed motion of J joints, one channel each.

    Attributes:
        freedom: degrees of freedom of χ²: numbers in the samples minus K J.

    """

    freedom: int

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.basis.knots[-1])

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        time = np.asarray(time, dtype=float)
        flat = np.stack([self.basis(time.ravel(), d) @ self.coefficients for d in range(3)], axis=1)
        return flat.reshape(*time.shape, 3, self.coefficients.shape[1])


def measured_by(suite: SensorSuite, measurements: Measurements) -> Measurements:
    """Return the measurements without the samples of sensors that a suite lacks."""
    present = suite.present()
    kept = {name: samples for name, samples in measurements.samples.items() if name in present}
    return Measurements(measurements.joint_names, kept)


def smooth_joints(measurements: Measurements, suite: SensorSuite) -> JointSpline:
    """Smooth the samples of all joint sensors by a quintic spline.

    In a gap of the encoder samples, the spline has as many pieces as elsewhere (`Basis.bridged`),
    and the prior that its jerk is zero with the σ of the jerk elsewhere. The covariance then
    includes the uncertainty in the gap.

    Raises:
        InputError: fewer than eight encoder samples.

    """
    measurements = measured_by(suite, measurements)
    positions = measurements.encoders
    if len(positions) < 8:
        raise InputError(f"joint motion needs at least 8 encoder samples, not {len(positions)}")
    start, end = positions.time[0], positions.time[-1]
    measurements = measurements.between(start, end)
    rows: list[DerivativeSamples] = [
        (measurements[sensor.name], derivative, float(suite.sigmas(sensor.name)[0]))
        for derivative, quantity in enumerate((JOINT_POSITIONS, JOINT_RATES))
        for sensor in sensors_of(quantity)
        if len(measurements[sensor.name])
    ]

    def spline(basis: Basis, bridges: list[DerivativeSamples]) -> JointSpline:
        known = sum(len(samples) for samples, _, _ in (*rows, *bridges))
        count = (known - basis.size) * positions.value.shape[1]
        return JointSpline(**vars(fit_samples(basis, [*rows, *bridges])), freedom=count)

    def fit(intervals: int) -> JointSpline:
        return spline(Basis.through(positions.time, intervals, degree=5), [])

    best = best_fit(fit, len(positions), finer=True)
    basis, bridges = bridge_gaps(best.basis, best.coefficients)
    return spline(basis, bridges) if bridges else best


def bridge_gaps(
    basis: Basis, coefficients: NDArray[np.float64]
) -> tuple[Basis, list[DerivativeSamples]]:
    """Divide the intervals in gaps of the samples; return the basis, and a prior for the gaps.

    The prior is a third derivative of zero, with the σ of that derivative outside the gaps.
    """
    bridged, middles = basis.bridged()
    if not len(middles):
        return basis, []
    width = coefficients.shape[1]
    elsewhere = np.setdiff1d((basis.knots[1:] + basis.knots[:-1]) / 2, basis.knots)
    jerk = float(np.sqrt(np.mean((basis(elsewhere, 3) @ coefficients) ** 2)))
    return bridged, [(Samples(middles, np.zeros((len(middles), width))), 3, max(jerk, 1e-9))]


def fit_samples(basis: Basis, rows: list[DerivativeSamples]) -> SplineFit:
    """Fit a spline by least squares to samples of a function and of its derivatives."""
    A = vstack([basis.sparse(s.time, derivative) / sigma for s, derivative, sigma in rows])
    b = np.vstack([s.value / sigma for s, _, sigma in rows])
    coefficients, covariance = solve_normal_equations(A, b)
    return SplineFit(basis, coefficients, covariance, float(np.sum((A @ coefficients - b) ** 2)))


def solve_normal_equations(
    A: NDArray[np.float64] | csr_array, b: NDArray[np.float64], with_covariance: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solve rows A (M, n), b (M, channels) in units of σ by their normal equations.

    B-spline bases are well conditioned, so the normal equations are accurate enough.

    Returns:
        The solution (n, channels), and its covariance (n, n), which is empty unless requested.

    """
    rows = csr_array(A)  # few functions differ from zero at one time
    normal = (rows.T @ rows).tocsc()
    scale = 1 / np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    right = scale[:, None] * (rows.T @ b)
    scaling, tiny = diags_array(scale), 1e-13 * eye_array(len(scale))
    scaled = scaling @ normal @ scaling + tiny
    if not with_covariance:
        try:  # without another order, the factors of a banded matrix have its bandwidth
            factors = splu(csc_array(scaled), permc_spec="NATURAL", diag_pivot_thresh=0.0)
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from error
        return scale[:, None] * factors.solve(right), np.empty((0, 0))
    factor = cho_factor(scaled.toarray())
    solution = scale[:, None] * cho_solve(factor, right)
    return solution, scale[:, None] * cho_solve(factor, np.diag(scale))


def best_fit(
    fit: Callable[[int], Fit],
    samples: int,
    *,
    first: int = 2,
    finer: bool = False,
    share: float = 1.0,
) -> Fit:
    """Return the fit with the smallest χ² + 2 K (Akaike 1974).

    Args:
        fit: returns the fit with a given number of intervals.
        samples: number of samples.
        first: number of intervals to try first; larger numbers follow.
        finer: return the next larger fit. It has less misfit, which the covariance does not
            include, and more noise, which the covariance includes. The noise also causes a larger
            bias in rows.
        share: share of the coefficients that count; the others are zero.

    """
    fits: list[Fit] = []
    best, least, worse = 0, np.inf, 0
    for intervals in INTERVALS[np.searchsorted(INTERVALS, first) :]:
        if fits and intervals + 5 > samples / 2:
            break
        fits.append(fit(intervals))
        criterion = fits[-1].chi_squared + 2 * share * fits[-1].coefficients.size
        if criterion < least:
            best, least, worse = len(fits) - 1, criterion, 0
        else:
            worse += 1
            if worse == 3:
                break
    # Knots of different fits are not nested, so a larger fit can be worse.
    better = [f for f in fits[best + 1 :] if f.chi_squared < fits[best].chi_squared]
    return better[0] if finer and better else fits[best]


def misfit_factor(fit: SplineFit, rows: int, share: float = 1.0) -> float:
    """Return χ² of a fit to `rows` numbers per degree of freedom, or 1 if that is larger.

    If the samples are too sparse for the motion, the residuals are larger than the noise; the
    covariance is then multiplied by this factor. A share of the numbers counts; the others are
    zero.
    """
    return max(fit.chi_squared / max(share * (rows - fit.coefficients.size), 1), 1.0)
