"""Statistics of an estimator over Monte Carlo trials."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.studies.trials import Case, Outcome


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Statistics of one estimator over the trials of one preset; arrays are (10,) each.

    Attributes:
        preset, estimator: their names.
        trials: number of trials; `failed` of them gave no estimate.
        problem: the reason of the first failure.
        bias, bias_halfwidth: mean error and half its 95 % interval.
        rmse: root mean square error.
        crlb: Cramér-Rao bound on the root mean square error.
        ratio_interval: (2, 10) 95 % interval of rmse / crlb.
        nees_mean: mean normalized error squared, 10 for a consistent estimator.
        nees_band: the interval that contains that mean with 95 % probability if the estimator is
            consistent.
        coverage: share of trials whose 95 % interval contains the truth.
        coverage_interval: (2, 10) 95 % interval of that share.
        coverage_all: the share over all ten parameters together.
        within_one_percent: share of trials with an error below 1 % (of m, 0.5 m, trace of I).
        infeasible: number of trials whose spatial inertia is not physically consistent.
        detected: share of trials in which the estimator detected the change of momentum, and its
            largest delay [s]; None for estimators that look for none.

    """

    preset: str
    estimator: str
    trials: int
    failed: int
    problem: str
    bias: NDArray[np.float64]
    bias_halfwidth: NDArray[np.float64]
    rmse: NDArray[np.float64]
    crlb: NDArray[np.float64]
    ratio_interval: NDArray[np.float64]
    nees_mean: float
    nees_band: tuple[float, float]
    coverage: NDArray[np.float64]
    coverage_interval: NDArray[np.float64]
    coverage_all: float
    within_one_percent: NDArray[np.float64]
    infeasible: int
    detected: tuple[float, float] | None

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Rmse / crlb."""
        return self.rmse / self.crlb


def statistics_of(
    case: Case, preset: str, estimator: str, bound: NDArray[np.float64], outcomes: list[Outcome]
) -> Accuracy:
    """Return the statistics of one estimator over its outcomes.

    Args:
        case: inputs of the trials.
        preset: name of the sensors.
        estimator: name of the estimator.
        bound: (10,) Cramér-Rao bound on the standard deviations.
        outcomes: one per trial.

    """
    good = [outcome for outcome in outcomes if not outcome.problem]
    failed = len(outcomes) - len(good)
    problem = next((outcome.problem for outcome in outcomes if outcome.problem), "")
    if not good:
        nothing = np.full(10, np.nan)
        return Accuracy(
            preset, estimator, len(outcomes), failed, problem, nothing, nothing, nothing, bound,
            np.full((2, 10), np.nan), np.nan, (np.nan, np.nan), nothing, np.full((2, 10), np.nan),
            np.nan, nothing, 0, None,
        )  # fmt: skip
    n = len(good)
    errors = np.array([outcome.parameters for outcome in good]) - case.truth.to_vector()
    covariances = np.array([outcome.covariance for outcome in good])
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    rmse = np.sqrt(np.mean(errors**2, axis=0))
    draws = np.random.default_rng(case.seed).integers(n, size=(1000, n))
    resampled = np.sqrt(np.mean(errors[draws] ** 2, axis=1))
    nees = [_normalized_square(e, P) for e, P in zip(errors, covariances)]
    inside = np.abs(errors) <= quantile_95() * sigmas
    intervals = [
        binomtest(int(count), n).proportion_ci(0.95, method="wilson")
        for count in inside.sum(axis=0)
    ]
    small = np.abs(errors) <= 0.01 * parameter_scale(case.truth.to_vector(), SCALE_LENGTH)
    return Accuracy(
        preset=preset,
        estimator=estimator,
        trials=len(outcomes),
        failed=failed,
        problem=problem,
        bias=errors.mean(axis=0),
        bias_halfwidth=quantile_95() * errors.std(axis=0, ddof=min(1, n - 1)) / np.sqrt(n),
        rmse=rmse,
        crlb=bound,
        ratio_interval=np.percentile(resampled, [2.5, 97.5], axis=0) / bound,
        nees_mean=float(np.mean(nees)),
        nees_band=tuple(chi2.ppf([0.025, 0.975], 10 * n) / n),
        coverage=inside.mean(axis=0),
        coverage_interval=np.array([[i.low, i.high] for i in intervals]).T,
        coverage_all=float(inside.mean()),
        within_one_percent=small.mean(axis=0),
        infeasible=sum(not outcome.feasible for outcome in good),
        detected=_detection(case, good),
    )


def _normalized_square(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    sigma = np.sqrt(np.diag(covariance))
    unit = covariance / sigma / sigma[:, None]
    return float(error / sigma @ np.linalg.lstsq(unit, error / sigma, rcond=None)[0])


def _detection(case: Case, outcomes: list[Outcome]) -> tuple[float, float] | None:
    """Return the share of trials in which the change was detected, and the largest delay [s]."""
    changes = [o.momentum_changes for o in outcomes if o.momentum_changes is not None]
    if len(changes) < len(outcomes):
        return None
    seen = [max(times) for times in changes if times]
    delay = np.nan
    changed = [event.time for event in case.firings]
    if not case.logs_thrust:
        changed += [burn.time for burn in case.burns]
    if seen and changed:
        delay = max(time - max(changed) for time in seen)
    return len(seen) / len(changes), float(delay)
