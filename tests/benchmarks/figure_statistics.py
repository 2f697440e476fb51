"""Statistics over the trials of one case and one estimator."""

from dataclasses import dataclass

import numpy as np
from figure_trials import Trial
from numpy.typing import NDArray
from scipy.stats import chi2

from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.studies.trials import Case

TOLERANCE = 1.0
"""A change that is found this long before or after a firing belongs to it [s]."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of one estimator; arrays are (10,), and NaN where no trial calls an entry known.

    Attributes:
        trials, failed, problem: numbers of trials, and the reason of the first failure.
        known: smallest and largest number of entries that a trial calls known.
        known_by_bound: number of entries that the Cramér-Rao bound calls known.
        not_observed: number of entries of all trials that are called known, but not by the bound.
        rmse, bound: root mean square error, and the Cramér-Rao bound on it.
        coverage: share of all known entries of all trials whose 95 % interval contains the truth.
        worst: largest |error| / σ.
        nees: mean normalized error squared of the known entries of a trial.
        nees_band: the interval that contains `nees` with 95 % probability if the estimator is
            consistent.
        false_alarms: number of trials with changes of momentum that did not happen, and the number
            of these changes; None for an estimator that detects none.
        found: share of trials that found all firings, and the largest delay [s]; None without
            firings.
        difference: RMS difference from the batch estimate on the same samples, in units of the
            bound; NaN without a batch estimate.
        seconds: mean processor time of a trial.

    """

    trials: int
    failed: int
    problem: str
    known: tuple[int, int]
    known_by_bound: int
    not_observed: int
    rmse: NDArray[np.float64]
    bound: NDArray[np.float64]
    coverage: float
    worst: float
    nees: float
    nees_band: tuple[float, float]
    false_alarms: tuple[int, int] | None
    found: tuple[float, float] | None
    difference: float
    seconds: float

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Rmse / bound of the entries that are known to both."""
        ratio = self.rmse / self.bound
        return ratio[np.isfinite(ratio)]


def statistics_of(
    case: Case, bound: NDArray[np.float64], trials: list[Trial], batch: list[Trial] | None
) -> Statistics:
    """Return the statistics of one estimator.

    Args:
        case: the case.
        bound: (10,) Cramér-Rao bound on the standard deviations.
        trials: the trials.
        batch: the trials of the batch estimator on the same samples, if it ran.

    """
    good = [trial for trial in trials if not trial.problem]
    n = max(len(good), 1)
    error = np.array([trial.error for trial in good]).reshape(-1, 10)
    known = np.array([trial.known for trial in good], dtype=bool).reshape(-1, 10)
    sigma = np.array([trial.sigma for trial in good]).reshape(-1, 10)
    normalized = np.abs(error / sigma)[known]
    count = known.sum(axis=0)
    sums = np.where(known, error**2, 0.0).sum(axis=0)
    freedom = int(known.sum())
    band = chi2.ppf([0.025, 0.975], freedom) / n if freedom else (np.nan, np.nan)
    difference = np.nan
    if batch is not None:
        pairs = [(t.error - b.error) / bound for t, b in zip(trials, batch, strict=True)]
        finite = np.isfinite(pairs)
        difference = _rms(np.array(pairs)[finite])
    return Statistics(
        trials=len(trials),
        failed=len(trials) - len(good),
        problem=next((trial.problem for trial in trials if trial.problem), ""),
        known=_range(known.sum(axis=1)),
        known_by_bound=int(np.isfinite(bound).sum()),
        not_observed=int((known & ~np.isfinite(bound)).sum()),
        rmse=np.sqrt(np.divide(sums, count, where=count > 0, out=np.full(10, np.nan))),
        bound=bound,
        coverage=float(np.mean(normalized <= quantile_95())) if freedom else np.nan,
        worst=float(normalized.max(initial=0.0)) if freedom else np.nan,
        nees=float(np.mean([_nees(trial) for trial in good])) if freedom else np.nan,
        nees_band=(float(band[0]), float(band[1])),
        false_alarms=_false_alarms(case, good),
        found=_found(case, good),
        difference=difference,
        seconds=float(np.mean([trial.seconds for trial in good])) if good else np.nan,
    )


def relative_rmse(this: Statistics, reference: Statistics) -> float:
    """Return the RMSE relative to that of another case: RMS over the entries of the ratios."""
    ratio = this.rmse / reference.rmse
    return _rms(ratio[np.isfinite(ratio)])


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan


def _range(counts: NDArray[np.int64]) -> tuple[int, int]:
    return (int(counts.min()), int(counts.max())) if counts.size else (0, 0)


def _nees(trial: Trial) -> float:
    """Return eᵀ P⁻¹ e of the known entries; 0 without any."""
    k = trial.known
    normalized = trial.error[k] / trial.sigma[k]
    correlation = trial.covariance[np.ix_(k, k)] / np.outer(trial.sigma[k], trial.sigma[k])
    return float(normalized @ np.linalg.lstsq(correlation, normalized, rcond=None)[0])


def _false_alarms(case: Case, trials: list[Trial]) -> tuple[int, int] | None:
    """Return the number of trials with more changes than firings, and the number of these.

    A burn of finite length may be found as several changes, the last soon after its end.
    """
    changes = [trial.changes for trial in trials if trial.changes is not None]
    if not changes:
        return None
    burns = [firing for firing in case.firings if firing.duration]
    false = [
        0
        if burns and change.last_time <= case.firings[-1].end + TOLERANCE
        else max(change.count - len(case.firings), 0)
        for change in changes
    ]
    return sum(count > 0 for count in false), sum(false)


def _found(case: Case, trials: list[Trial]) -> tuple[float, float] | None:
    """Return the share of trials that found all firings, and the largest delay of the last [s]."""
    changes = [trial.changes for trial in trials if trial.changes is not None]
    if not changes or not case.firings:
        return None
    delays = [
        change.last_time - case.firings[-1].time
        for change in changes
        if change.count >= len(case.firings)
    ]
    delays = [delay for delay in delays if delay >= -TOLERANCE]
    return len(delays) / len(trials), max(delays, default=np.nan)
