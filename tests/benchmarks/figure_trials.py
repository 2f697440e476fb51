"""Trials of one case: the draws, the estimates and the check of the truth."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from figure_faults import Fault
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification, MomentumChanges
from cpid_drake.processes import shared_work
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.statistics import SCALE_LENGTH
from cpid_drake.studies.trials import Case, base_trajectory, draw


@dataclass(frozen=True, eq=False)
class Trial:
    """One estimator's result in one trial; entries that it does not call known are NaN.

    Attributes:
        error: (10,) estimate minus truth.
        covariance: (10, 10) that the estimator reports.
        problem: the reason of a failure; empty without one.
        changes: changes of momentum that it detected; None if it detects none.
        seconds: processor time.

    """

    error: NDArray[np.float64] = field(default_factory=lambda: np.full(10, np.nan))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((10, 10), np.nan))
    problem: str = ""
    changes: MomentumChanges | None = None
    seconds: float = 0.0

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(10,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def known(self) -> NDArray[np.bool_]:
        """(10,) whether the estimator calls the entry known."""
        return np.isfinite(self.error) & np.isfinite(self.sigma)


@dataclass(frozen=True, eq=False)
class Job:
    """Inputs of all trials of a case; `noiseless` trials use the ideal samples."""

    case: Case
    faults: tuple[Fault, ...]
    estimators: tuple[str, ...]
    ideal: Measurements
    noiseless: bool = False


def run(
    job: Job, trials: int, jobs: int, progress: Callable[[int], None]
) -> dict[str, list[Trial]]:
    """Return the trials by estimator, from `jobs` processes.

    Args:
        job: inputs of the trials.
        trials: their number.
        jobs: number of processes.
        progress: called with the number of finished trials.

    """
    results: dict[str, list[Trial]] = {name: [] for name in job.estimators}
    for done, trial in enumerate(shared_work(_trials_of, job, range(trials), jobs), start=1):
        for name, outcome in trial.items():
            results[name].append(outcome)
        progress(done)
    return results


@dataclass(frozen=True)
class TruthCheck:
    """Measures of the true motion of a case, before the first firing.

    Attributes:
        momentum: largest deviation of the total momentum, from the sums over all bodies, from its
            given value [N·m·s, N·s].
        rates: largest deviation of the base's velocity and angular velocity from differences of
            its poses [m/s, rad/s].
        error: largest error of least squares on exact states, relative to m, 0.5 m, trace of I.
        known: number of entries that least squares determines.

    """

    momentum: float
    rates: float
    error: float
    known: int


def check_truth(case: Case, spacecraft: Spacecraft) -> TruthCheck:
    """Compare the true motion with routes that are independent of its propagation."""
    step = 1e-3
    end = min([case.duration, *(firing.time for firing in case.firings)]) - step
    middle = np.linspace(step, end - step, 200)
    times = np.concatenate([[0.0], np.stack([middle - step, middle, middle + step], 1).ravel()])
    times = np.unique(times)
    telemetry = base_trajectory(case, spacecraft.tree, times).to_telemetry(
        spacecraft.joint_names, times, case.motion
    )
    k = np.searchsorted(times, middle)
    before, after = telemetry.select(k - 1), telemetry.select(k + 1)
    span = (after.time - before.time)[:, None]
    turn = Rotation.from_matrix(after.R_WB @ np.swapaxes(before.R_WB, -1, -2)).as_rotvec()
    rates = np.hstack([turn / span, (after.p_WB - before.p_WB) / span])
    states = telemetry.select(k)
    P, L = total_momentum(spacecraft.tree, case.truth, states)
    unknown = TotalMomentum.unknown() if case.momentum_W.any() else TotalMomentum.zero()
    exact = identify(spacecraft, states, rows="standard", momentum=unknown)
    truth = case.truth.to_vector()
    error = np.abs(exact.parameters - truth) / parameter_scale(truth, SCALE_LENGTH)
    known = np.isfinite(error)
    return TruthCheck(
        momentum=float(np.abs(np.hstack([L, P]) - case.momentum_W).max()),
        rates=float(np.abs(rates - np.hstack([states.w_WB, states.v_WB])).max()),
        error=float(error[known].max(initial=0.0)),
        known=int(known.sum()),
    )


def _trials_of(job: Job) -> Callable[[int], dict[str, Trial]]:
    """Return the function that does the trial of a number."""
    return partial(_trial, job, job.case.spacecraft.make())


def _trial(job: Job, spacecraft: Spacecraft, number: int) -> dict[str, Trial]:
    """Return the results of one draw of noise, faults and spacecraft, by estimator."""
    case, measurements = job.case, job.ideal
    if not job.noiseless:
        measurements = draw(case, spacecraft, job.ideal, number)
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(number, 1)))
    for fault in job.faults:
        measurements = fault.apply(measurements, case.suite, rng)
    return {name: _estimate(case, spacecraft, measurements, name) for name in job.estimators}


def _estimate(case: Case, spacecraft: Spacecraft, measurements: Measurements, name: str) -> Trial:
    start = time.process_time()
    try:
        found = identify(
            spacecraft,
            measurements,
            estimator=name,
            sensors=case.suite,
            momentum=case.momentum,
            known_bodies=case.known_bodies,
            is_final=False,
        )
        seconds = time.process_time() - start
        return _outcome(found, case, seconds)
    except Exception as error:  # a failed trial is a result: it is counted, with its reason
        return Trial(problem=f"{type(error).__name__}: {error}")


def _outcome(found: Identification, case: Case, seconds: float) -> Trial:
    if not found.converged:
        return Trial(problem="did not converge", seconds=seconds)
    error = found.parameters - case.truth.to_vector()
    return Trial(error, found.covariance, "", found.momentum_changes, seconds)
